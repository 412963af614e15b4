"""Tiny random models in the real layout of every family of `hf`, for tests and benchmarks."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from dancedata.core.errors import UsageError, did_you_mean

_CONV = {"conv_dim": [16] * 7, "num_conv_pos_embeddings": 16, "num_conv_pos_embedding_groups": 4}
_BLOCKS = {"hidden_size": 24, "num_hidden_layers": 3, "num_attention_heads": 4, "intermediate_size": 32}
_SPEECH = {"sampling_rate": 16_000, "do_normalize": True, "feature_size": 1, "padding_value": 0.0}


def write_random_model(kind: str, folder: Path, *, seed: int = 0, **changes: Any) -> None:
    """Write a random model, one of `KINDS`; `changes` are keys of the config that differ from the tiny ones."""
    if kind not in _MAKERS:
        raise UsageError(f"no random model {kind!r}", fix=did_you_mean(kind, KINDS))
    folder.mkdir(parents=True, exist_ok=True)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        _MAKERS[kind](folder, changes)
    (folder / "README.md").write_text(
        "---\nlicense: cc0-1.0\n---\nRandom numbers, for tests.\n", encoding="utf-8", newline="\n"
    )


def _native(
    folder: Path, model: str, config: str, keys: dict[str, Any], extractor: dict[str, Any] | None
) -> torch.nn.Module:
    """Make a model of transformers, and save it as transformers does."""
    import transformers

    network: Any = getattr(transformers, model)(getattr(transformers, config)(**keys))
    _rescale_weights(network)
    network.save_pretrained(folder)
    if extractor is not None:
        (folder / "preprocessor_config.json").write_text(json.dumps(extractor), encoding="utf-8", newline="\n")
    native: torch.nn.Module = network
    return native


def _rescale_weights(network: torch.nn.Module) -> None:
    """Redraw the weights so that activations are about 1: the initial ones of some classes give almost nothing."""
    for name, parameter in network.named_parameters():
        if parameter.dim() >= 2 and "original" not in name:
            fan_in = math.prod(parameter.shape[1:])
            torch.nn.init.normal_(parameter, std=1 / math.sqrt(fan_in))
    for name, buffer in network.named_buffers():
        # Code vectors that are averages of training: all 0 before it.
        if name.endswith(("codebook.embed", "codebook.embed_sum")):
            buffer.normal_(std=0.3)


def _speech(model: str, **settings: Any) -> Callable[[Path, dict[str, Any]], None]:
    def write(folder: Path, changes: dict[str, Any]) -> None:
        keys = {**_BLOCKS, **_CONV, **settings, **changes}
        _native(folder, f"{model}Model", f"{model}Config", keys, _SPEECH)

    return write


def _mert(folder: Path, changes: dict[str, Any]) -> None:
    """Write MERT v1's published layout: pickled weights with the names of old torch, and a new model type."""
    import transformers

    keys = {**_BLOCKS, **_CONV, **changes}
    network = transformers.HubertModel(transformers.HubertConfig(**keys))
    _rescale_weights(network)
    old = {"parametrizations.weight.original0": "weight_g", "parametrizations.weight.original1": "weight_v"}
    tensors = {}
    for name, tensor in network.state_dict().items():
        for new, former in old.items():
            name = name.replace(new, former)
        tensors[name] = tensor
    torch.save(tensors, folder / "pytorch_model.bin")
    config = network.config.to_dict() | {
        "model_type": "mert_model",
        "architectures": ["MERTModel"],
        "auto_map": {"AutoConfig": "configuration_MERT.MERTConfig", "AutoModel": "modeling_MERT.MERTModel"},
        "feature_extractor_cqt": False,
        "feature_extractor_cqt_bins": 336,
        "deepnorm": False,
        "attention_relax": -1.0,
        "tokenizer_class": "Wav2Vec2CTCTokenizer",
    }
    (folder / "config.json").write_text(json.dumps(config), encoding="utf-8", newline="\n")
    (folder / "preprocessor_config.json").write_text(
        json.dumps(_SPEECH | {"sampling_rate": 24_000}), encoding="utf-8", newline="\n"
    )


def _w2v_bert(folder: Path, changes: dict[str, Any]) -> None:
    keys = {**_BLOCKS, "feature_projection_input_dim": 160, "output_hidden_size": 24, **changes}
    extractor = {"feature_size": 80, "num_mel_bins": 80, "sampling_rate": 16_000, "stride": 2, "padding_value": 1}
    _native(folder, "Wav2Vec2BertModel", "Wav2Vec2BertConfig", keys, extractor)


def _encodec(**settings: Any) -> Callable[[Path, dict[str, Any]], None]:
    def write(folder: Path, changes: dict[str, Any]) -> None:
        keys = {"num_filters": 4, "hidden_size": 16, "num_lstm_layers": 1, "codebook_dim": 16, **settings, **changes}
        extractor = {"sampling_rate": keys["sampling_rate"], "feature_size": keys.get("audio_channels", 1)}
        _native(folder, "EncodecModel", "EncodecConfig", keys, extractor)

    return write


def _dac(folder: Path, changes: dict[str, Any]) -> None:
    keys = {"encoder_hidden_size": 4, "decoder_hidden_size": 64, "sampling_rate": 44_100, **changes}
    _native(folder, "DacModel", "DacConfig", keys, {"sampling_rate": 44_100, "hop_length": 512, "feature_size": 1})


def _mimi(folder: Path, changes: dict[str, Any]) -> None:
    keys = {
        "num_filters": 4, "hidden_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2,
        "num_key_value_heads": 2, "head_dim": 16, "intermediate_size": 32, "codebook_dim": 32,
        "vector_quantization_hidden_dimension": 32, "num_quantizers": 8, "upsample_groups": 32, **changes,
    }  # fmt: skip
    _native(folder, "MimiModel", "MimiConfig", keys, {"sampling_rate": 24_000, "feature_size": 1})


def _whisper(folder: Path, changes: dict[str, Any]) -> None:
    keys = {
        "d_model": 24, "encoder_layers": 3, "encoder_attention_heads": 4, "encoder_ffn_dim": 32, "decoder_layers": 1,
        "decoder_attention_heads": 4, "decoder_ffn_dim": 32, "vocab_size": 20, "num_mel_bins": 80,
        "max_source_positions": 100, "max_target_positions": 8, "pad_token_id": 0, "bos_token_id": 1,
        "eos_token_id": 2, "decoder_start_token_id": 3, "suppress_tokens": None, "begin_suppress_tokens": None,
        **changes,
    }  # fmt: skip
    extractor = {"sampling_rate": 16_000, "feature_size": 80, "hop_length": 160, "n_fft": 400, "chunk_length": 2}
    _native(folder, "WhisperForConditionalGeneration", "WhisperConfig", keys, extractor)


def _ast(folder: Path, changes: dict[str, Any]) -> None:
    keys = {**_BLOCKS, "max_length": 128, "num_mel_bins": 32, **changes}
    extractor = {
        "sampling_rate": 16_000, "num_mel_bins": keys["num_mel_bins"], "max_length": keys["max_length"],
        "mean": -4.2677393, "std": 4.5689974, "do_normalize": True,
    }  # fmt: skip
    _native(folder, "ASTModel", "ASTConfig", keys, extractor)


def _clap(folder: Path, changes: dict[str, Any]) -> None:
    audio = {
        "spec_size": 64, "num_mel_bins": 16, "window_size": 4, "depths": [1, 1], "num_attention_heads": [2, 2],
        "patch_embeds_hidden_size": 12, "hidden_size": 24, "projection_dim": 8, **changes,
    }  # fmt: skip
    text = {"hidden_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 16}
    keys = {"audio_config": audio, "text_config": {**text, "vocab_size": 20}, "projection_dim": 8}
    extractor = {
        "sampling_rate": 48_000, "feature_size": 16, "hop_length": 480, "fft_window_size": 1024, "max_length_s": 2,
        "frequency_min": 50, "frequency_max": 14_000, "truncation": "rand_trunc", "padding": "repeatpad",
    }  # fmt: skip
    _native(folder, "ClapModel", "ClapConfig", keys, extractor)


def _pe_audio(folder: Path, changes: dict[str, Any]) -> None:
    audio = {
        "hidden_size": 24, "intermediate_size": 32, "num_hidden_layers": 3, "num_attention_heads": 2, "head_dim": 12,
        "dac_config": {"encoder_hidden_size": 4, "downsampling_ratios": [2, 8, 10, 12], "codebook_dim": 8,
                       "hidden_size": 64},
        **changes,
    }  # fmt: skip
    text = {
        "hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2,
        "vocab_size": 20, "pad_token_id": 0, "bos_token_id": 1, "eos_token_id": 2, "cls_token_id": 1,
        "sep_token_id": 2,
    }  # fmt: skip
    keys = {"audio_config": audio, "text_config": text}
    extractor = {"sampling_rate": 48_000, "feature_size": 1, "hop_length": 1920}
    _native(folder, "PeAudioModel", "PeAudioConfig", keys, extractor)


def _muq(folder: Path, changes: dict[str, Any]) -> None:
    """Write MuQ's published layout: the names of the package muq, and a config without a model type."""
    from safetensors.torch import save_file

    from dancedata.audio.hf.families.muq import MuQ
    from dancedata.audio.hf.families.muq_network import MuQNetwork

    config = {
        "label_rate": 25, "hop_length": 240, "n_mels": 128, "conv_dim": 8, "encoder_dim": 24, "encoder_depth": 3,
        "stat": {"melspec_2048_mean": 6.77, "melspec_2048_std": 18.4}, "features": ["melspec_2048"],
        "w2v2_config": {"num_attention_heads": 4, "intermediate_size": 32, "hidden_act": "swish",
                        "position_embeddings_type": "rotary", "conv_depthwise_kernel_size": 31,
                        "hidden_dropout": 0.1, "attention_dropout": 0.1, "num_conv_pos_embeddings": 16,
                        "num_conv_pos_embedding_groups": 4, "model_type": "wav2vec2-conformer"},
        **changes,
    }  # fmt: skip
    network = MuQNetwork(config, MuQ(config, {}).strides)
    _rescale_weights(network)
    tensors = {f"model.{name}": tensor.contiguous() for name, tensor in network.state_dict().items()}
    tensors["model.cls_token"] = torch.randn(int(config["encoder_dim"]))
    tensors["model.linear.weight"] = torch.randn(8, int(config["encoder_dim"]))
    save_file(tensors, folder / "model.safetensors")
    (folder / "config.json").write_text(json.dumps(config), encoding="utf-8", newline="\n")


_MAKERS: dict[str, Callable[[Path, dict[str, Any]], None]] = {
    "wav2vec2": _speech("Wav2Vec2"),
    "wav2vec2-large": _speech("Wav2Vec2", feat_extract_norm="layer", do_stable_layer_norm=True, conv_bias=True),
    "wav2vec2-conformer": _speech("Wav2Vec2Conformer", position_embeddings_type="rotary"),
    "hubert": _speech("Hubert"),
    "hubert-large": _speech("Hubert", feat_extract_norm="layer", do_stable_layer_norm=True, conv_bias=True),
    "wavlm": _speech("WavLM"),
    "data2vec-audio": _speech("Data2VecAudio", conv_pos_kernel_size=5, num_conv_pos_embeddings=2),
    "mert": _mert,
    "w2v-bert": _w2v_bert,
    "encodec24": _encodec(sampling_rate=24_000, norm_type="weight_norm", upsampling_ratios=[8, 5, 4, 2]),
    "encodec32": _encodec(
        sampling_rate=32_000,
        use_causal_conv=False,
        upsampling_ratios=[8, 5, 4, 4],
        target_bandwidths=[2.2],
        codebook_size=2048,
    ),
    "encodec48": _encodec(
        sampling_rate=48_000,
        audio_channels=2,
        normalize=True,
        chunk_length_s=1.0,
        overlap=0.01,
        norm_type="time_group_norm",
        use_causal_conv=False,
        upsampling_ratios=[8, 5, 4, 2],
    ),
    "dac": _dac,
    "mimi": _mimi,
    "whisper": _whisper,
    "ast": _ast,
    "clap": _clap,
    "pe-audio": _pe_audio,
    "muq": _muq,
}
#: The models that `write_random_model` can write.
KINDS = tuple(_MAKERS)
