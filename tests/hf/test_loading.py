"""Folders that cannot be used: one message each, nothing random, nothing run, nothing downloaded."""

import json
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from dancedata.audio.hf import HuggingFace
from dancedata.audio.hf.encoder import HuggingFaceEncoder
from dancedata.audio.hf.model_folder import ENVIRONMENT, PROVENANCE, UNKNOWN, licence_of, open_model
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.files.regular_file import sha256_file
from tests.messages import raises_message

from .conftest import noise, settings


@pytest.fixture
def copy(model: Callable[[str], Path], tmp_path: Path) -> Callable[..., Path]:
    """A copy of a tiny model, its tensors changed by a function."""

    def made(kind: str, change: Callable[[dict[str, torch.Tensor]], object] | None = None) -> Path:
        folder = tmp_path / "copied"
        shutil.copytree(model(kind), folder)
        if change is not None:
            tensors = load_file(folder / "model.safetensors")
            change(tensors)
            save_file(tensors, folder / "model.safetensors", metadata={"format": "pt"})
        return folder

    return made


def _edit(folder: Path, **keys: Any) -> Path:
    config = json.loads((folder / "config.json").read_text()) | keys
    (folder / "config.json").write_text(json.dumps(config))
    return folder


def _load(folder: Path, **keys: Any) -> HuggingFaceEncoder:
    return HuggingFaceEncoder(settings(folder, **keys), device="cpu")


FINAL = "encoder.layers.2.final_layer_norm.weight"


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("hubert", lambda t: t.pop(FINAL), r"lack weights, which would be random.*1: encoder\.layers\.2\.final"),
        ("hubert", lambda t: t.update(extra=torch.ones(2)), r"have weights that the config has no place for.*extra"),
        ("hubert", lambda t: t.update({FINAL: torch.ones(7)}), r"cannot be loaded.*"),
        ("encodec24", lambda t: t.pop(next(k for k in t if k.startswith("encoder."))), "lack weights"),
        ("muq", lambda t: t.pop("model.conv.linear.bias"), r"lack weights.*conv\.linear\.bias"),
        ("muq", lambda t: t.update({"model.conv.linear.bias": torch.ones(3)}), "cannot be loaded"),
        ("muq", lambda t: t.update(odd=torch.ones(3)), "have weights that the config has no place for"),
    ],
)
def test_weights_that_do_not_fit(copy: Callable[..., Path], kind: str, change: Any, message: str) -> None:
    with pytest.raises(SourceError, match=message) as caught:
        _load(copy(kind, change))
    assert "copied" in str(caught.value)


def test_tensors_used_only_in_training_are_optional(copy: Callable[..., Path]) -> None:
    folder = copy(
        "hubert", lambda t: t.update({"lm_head.weight": torch.ones(2, 2), "masked_spec_embed": torch.ones(24)})
    )
    assert _load(folder).frames(noise(0.2, 16_000), 16_000).values.shape[1] == 24


def test_blocks_above_the_highest_layer_are_not_built(model, copy):
    whole, cut = _load(model("hubert")), _load(model("hubert"), layers=1)
    assert (len(whole._network.encoder.layers), len(cut._network.encoder.layers)) == (3, 1)
    # A hole there is of no concern, one below is.
    folder = copy("hubert", lambda t: t.pop(FINAL))
    assert _load(folder, layers=2).settings.layers == (2,)


def test_a_file_that_is_cut_off(copy: Callable[..., Path]) -> None:
    path = copy("hubert") / "model.safetensors"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with raises_message(SourceError, "cannot be loaded.*Compare", where="model.safetensors"):
        _load(path.parent)


class _Evil:
    def __init__(self, trap: Path) -> None:
        self.trap = trap

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.trap,))


@pytest.mark.parametrize("kind", ["mert", "muq"])
def test_pickles_hold_tensors_and_nothing_else(copy: Callable[..., Path], kind: str, tmp_path: Path) -> None:
    folder, trap = copy(kind), tmp_path / "ran"
    (folder / "model.safetensors").unlink(missing_ok=True)
    torch.save({"a": torch.ones(1), "b": _Evil(trap)}, folder / "pytorch_model.bin", pickle_module=pickle)
    with pytest.raises(SourceError, match=r"pytorch_model\.bin: hf: .* get its weights as safetensors") as caught:
        _load(folder)
    assert "weights_only" not in str(caught.value)  # torch advises to run the code
    assert not trap.exists()


def test_an_old_torch_reads_no_pickles(copy: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "__version__", "2.5.1+cpu")
    with raises_message(UsageError, r"copied/pytorch_model\.bin needs torch 2\.6"):
        _load(copy("mert"))


@pytest.mark.parametrize(
    "keys",
    [{"model_type": "mert2", "auto_map": {"AutoModel": "x.Y"}}, {"model_type": ["hubert"]},
     {"model_type": "mert_model", "deepnorm": True}, {"model_type": "mert_model", "feature_extractor_cqt": True},
     {"quantization_config": {"bits": 4}}, {"hidden_size": "wide"}, {"conv_kernel": [10, 0]},
     {"num_hidden_layers": -1}, {"hidden_size": 10**9}, {"num_lstm_layers": 10**9},
     {"conv_kernel": [10**9, 10], "conv_stride": [1, 1]}],
)  # fmt: skip
def test_unusable_configs(copy: Callable[..., Path], keys: dict[str, Any]) -> None:
    folder = _edit(copy("hubert"), **keys)
    with raises_message(SourceError, r"config|plug-ins\.md|quantised"):
        assert settings(folder).columns.width


@pytest.mark.parametrize(
    ("keys", "minversion"),
    [({"hidden_act": "no such function"}, "4.0"), ({"vocab_size": None, "num_feat_extract_layers": 3}, "5.0")],
)
def test_a_config_that_transformers_refuses(copy, keys, minversion):
    pytest.importorskip("transformers", minversion=minversion)
    with raises_message(SourceError, "cannot be loaded"):
        _load(_edit(copy("hubert"), **keys))


@pytest.mark.parametrize("keys", [{"return_dict": False}, {"output_hidden_states": "yes"}, {"torchscript": True}])
def test_keys_of_the_result_of_a_call_change_nothing(copy, model, keys):
    samples = noise(0.3, 16_000)
    wanted = _load(model("hubert")).frames(samples, 16_000)
    found = _load(_edit(copy("hubert"), **keys)).frames(samples, 16_000)
    np.testing.assert_array_equal(found.values, wanted.values)


def test_weights_that_change_during_a_build_are_an_error(copy: Callable[..., Path]) -> None:
    folder = copy("hubert")
    resolved = HuggingFace(model=str(folder), device="cpu").resolved(sha256_file)
    tensors = load_file(folder / "model.safetensors")
    tensors[FINAL] = tensors[FINAL] + 1
    save_file(tensors, folder / "model.safetensors", metadata={"format": "pt"})
    signal = AudioSignal(noise(0.5, 16_000), 16_000)
    sha256 = "[0-9a-f]{64}"  # of weights that versions of transformers and torch draw differently
    with pytest.raises(SourceError, match=f"hf: the weights have changed; found {sha256}; allowed: {sha256}$"):
        resolved.extract(signal, FrameGrid.of(30))


def test_layers_out_of_range(model: Callable[[str], Path]) -> None:
    for layers in (4, -1, (1, 9), "2..7", (1, 1), "first", (), 1.5, (0, True)):
        with raises_message(UsageError, "layers", where="hubert") as caught:
            settings(model("hubert"), layers=layers)
        assert str(model("hubert")) in str(caught.value)  # of several encoders in a recipe
    assert settings(model("hubert"), layers="1..2").layers == (1, 2)
    assert settings(model("hubert"), layers="all").layers == (0, 1, 2, 3)
    assert settings(model("hubert"), layers="mean").columns.width == 24
    for kind, keys, word in (
        ("clap", {"layers": 1}, "layers"),
        ("dac", {"layers": 1}, "embedding"),
        ("hubert", {"output": "codes"}, "wav2vec2-like"),
        ("whisper", {"chunk_s": 10}, "chunk_s"),
        ("encodec48", {"chunk_s": 2}, "chunk_s"),
        ("hubert", {"chunk_s": 2, "overlap_s": 2}, "overlap_s"),
    ):
        with raises_message(UsageError, word):
            settings(model(kind), **keys)


def test_where_models_are(model: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with raises_message(UsageError, "DANCEDATA_HF_MODEL"):
        HuggingFace().resolved(sha256_file)
    with raises_message(UsageError, "check", where="none"):
        open_model(str(tmp_path / "none"))
    with raises_message(SourceError, r"config\.json"):
        open_model(str(tmp_path))
    with raises_message(UsageError, "identified", where="hubert"):
        open_model(str(model("hubert")), "a" * 40)
    monkeypatch.setenv(ENVIRONMENT, str(model("hubert")))
    assert HuggingFace().columns.width == 24
    (tmp_path / "config.json").write_text("[]")
    with raises_message(SourceError, "object", where="config.json"):
        open_model(str(tmp_path))
    (tmp_path / "config.json").write_text('{"model_type": "hubert"}')
    with raises_message(SourceError, "sampling_rate"):
        assert settings(tmp_path).family.timing
    (tmp_path / "preprocessor_config.json").write_text('{"sampling_rate": 16000}')
    with raises_message(SourceError, r"pytorch_model\.bin"):
        open_model(str(tmp_path)).weight_files()
    index = tmp_path / "model.safetensors.index.json"
    index.write_text('{"weight_map": {"a": "../../secret.safetensors"}}')
    with raises_message(SourceError, "index", where="model.safetensors.index.json"):
        open_model(str(tmp_path)).weight_files()
    (tmp_path / "adapter_config.json").write_text("{}")
    with raises_message(SourceError, "adapter"):
        open_model(str(tmp_path)).weight_files()


def test_hub_ids_come_from_the_cache_of_this_machine(model, tmp_path, monkeypatch):
    from huggingface_hub import constants

    commit = "0123456789abcdef0123456789abcdef01234567"
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    with raises_message(UsageError, "builds", where="m-a-p/MERT-v9"):
        open_model("m-a-p/MERT-v9")
    with raises_message(UsageError, "builds", where="m-a-p/MERT-v9"):
        open_model("m-a-p/MERT-v9", commit)
    repository = tmp_path / "models--m-a-p--MERT-v9"
    shutil.copytree(model("mert"), repository / "snapshots" / commit)
    (repository / "refs").mkdir()
    (repository / "refs" / "main").write_text(commit)
    found = open_model("m-a-p/MERT-v9")
    assert (found.source, found.revision, found.from_hub) == ("m-a-p/MERT-v9", commit, True)
    with raises_message(UsageError, "branches", where="m-a-p/MERT-v9"):
        open_model("m-a-p/MERT-v9", "main")
    feature = HuggingFace(model="m-a-p/MERT-v9", device="cpu").resolved(sha256_file)
    assert (feature.model, feature.revision) == ("m-a-p/MERT-v9", commit)
    assert feature.about["revision"] == commit
    assert feature.model_sha256 == open_model(str(model("mert"))).sha256(sha256_file)


def test_licences(tmp_path: Path) -> None:
    assert licence_of(tmp_path) == UNKNOWN
    (tmp_path / PROVENANCE).write_text('{"id": "m-a-p/MERT-v1-95M", "revision": "%s", "licence": "cc0"}' % ("a" * 40))
    assert licence_of(tmp_path) == "cc0"
    for text, licence in (
        ("---\nlicense: cc-by-nc-4.0\ntags:\n- music\n---\nlicense: no\n", "cc-by-nc-4.0"),
        ("---\r\nlicense: 'mit'\r\n---\r\n", "mit"),
        ("---\nlicense: other\nlicense_name: own\nlicense_link: LICENSE\n---\n", "own LICENSE"),
        ("license: mit\n", "cc0"),
    ):
        (tmp_path / "README.md").write_bytes(text.encode())
        assert licence_of(tmp_path) == licence
    (tmp_path / "config.json").write_text('{"model_type": "hubert"}')
    assert open_model(str(tmp_path)).source == "m-a-p/MERT-v1-95M"


def test_numbers_that_are_not_finite(copy: Callable[..., Path]) -> None:
    def spoil(tensors: dict[str, torch.Tensor]) -> None:
        tensors[FINAL][0] = np.nan

    own = _load(copy("hubert", spoil))
    with raises_message(DanceDataError, "float32", reason="overflow"):
        own.frames(noise(0.3, 16_000), 16_000)


# ---- configs by which a song would be cut into far more frames than in any model

MERT_CONFIG = {"model_type": "mert_model", "sample_rate": 24_000, "num_hidden_layers": 2, "hidden_size": 24}
CLAP_CONFIG = {"model_type": "clap_audio_model"}


def configured(folder: Path, config: dict[str, Any], extractor: dict[str, Any]) -> Any:
    folder.mkdir(exist_ok=True)
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "preprocessor_config.json").write_text(json.dumps({"sampling_rate": 24_000, **extractor}))
    return settings(folder)


@pytest.mark.parametrize(
    ("config", "extractor", "found"),
    [
        ({"model_type": "whisper"}, {"sampling_rate": 16_000, "hop_length": 1}, "16,000 frames per second"),
        ({**MERT_CONFIG, "conv_stride": [1] * 7}, {}, "24,000 frames per second"),
        ({"model_type": "whisper", "max_source_positions": 1 << 20}, {"hop_length": 160}, "2,097,152 of them in a"),
        (CLAP_CONFIG, {"sampling_rate": 48_000, "hop_length": 1}, "48,000 frames per second"),
        (CLAP_CONFIG, {"sampling_rate": 48_000, "max_length_s": 10**6}, "of them in a window"),
        ({"model_type": "encodec", "upsampling_ratios": [1]}, {}, "24,000 frames per second"),
        ({"model_type": "muq", "hop_length": 1}, {}, "24,000 frames per second"),
    ],
)
def test_too_many_frames(tmp_path: Path, config: dict[str, Any], extractor: dict[str, Any], found: str) -> None:
    with raises_message(SourceError, "hop_length", where="model") as caught:
        configured(tmp_path / "model", config, extractor)
    assert found in str(caught.value)
    assert "at most 500 per second, and 30,000 in a window" in str(caught.value)


def test_published_rates_are_accepted(tmp_path: Path) -> None:
    for config, extractor, rate in (
        ({"model_type": "whisper"}, {"sampling_rate": 16_000}, 50),
        (MERT_CONFIG, {}, 75),
        (CLAP_CONFIG, {"sampling_rate": 48_000}, 3.2),
        ({"model_type": "encodec", "sampling_rate": 48_000}, {}, 150),
        ({"model_type": "audio-spectrogram-transformer"}, {"sampling_rate": 16_000}, 10),
    ):
        family = configured(tmp_path / "model", config, extractor).family
        assert float(family.timing.rate) == pytest.approx(rate, rel=0.01)
