"""Encoders of spectrograms, in windows of their own length: Whisper, AST, the audio tower of CLAP."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.audio.hf.families.base import Family, NetworkSpec, Output, Prepared, Samples, Timing, uniform
from dancedata.core.typing import override

if TYPE_CHECKING:
    import torch

    from dancedata.audio.hf.families.base import Frames


@dataclass(frozen=True)
class SpectrogramEncoder(Family):
    """An encoder that takes spectrograms of one length."""

    overlap_s: ClassVar[float] = 2.0

    @property
    def mel_hop(self) -> int:
        """Samples from one log-mel frame to the next."""
        return 160

    @property
    @override
    def max_rate(self) -> Fraction:
        return Fraction(self.sample_rate, self.mel_hop)

    @property
    @override
    def fixed_chunk(self) -> int | None:
        return self.window

    @property
    def window(self) -> int:
        """Samples of a window."""
        raise NotImplementedError

    def spectrogram(self, samples: Samples, *, normalize: bool) -> npt.NDArray[np.float32]:
        """Return what the network is given of at most `window` samples."""
        raise NotImplementedError

    @override
    def prepared(self, samples: Samples, *, normalize: bool) -> Prepared:
        # Each window is normalised by itself, as in the networks' training.
        return lambda start, n_samples: self.spectrogram(samples[start : start + n_samples], normalize=normalize)


@dataclass(frozen=True)
class Whisper(SpectrogramEncoder):
    """The encoder of Whisper (Radford et al. 2022): windows of 30 s, 50 frames per second."""

    name: ClassVar[str] = "whisper"
    model_types: ClassVar[tuple[str, ...]] = ("whisper",)
    depth: ClassVar[tuple[str, int]] = ("encoder_layers", 4)
    size: ClassVar[tuple[str, int]] = ("d_model", 384)

    @property
    @override
    def mel_hop(self) -> int:
        return self.number("hop_length", of=self.extractor, default=160)

    @property
    @override
    def window(self) -> int:
        return 2 * self.mel_hop * self.number("max_source_positions", default=1500)

    @property
    @override
    def timing(self) -> Timing:
        return uniform(self.sample_rate, 2 * self.mel_hop, 0)

    @override
    def n_frames(self, n_samples: int) -> int:
        return self.number("max_source_positions", default=1500)

    @override
    def spectrogram(self, samples: Samples, *, normalize: bool) -> npt.NDArray[np.float32]:
        from transformers import WhisperFeatureExtractor

        n_fft = self.number("n_fft", of=self.extractor, default=400)
        extractor = WhisperFeatureExtractor(
            feature_size=self.number("num_mel_bins", default=80),
            sampling_rate=self.sample_rate,
            hop_length=self.mel_hop,
            n_fft=n_fft,
            chunk_length=1,
        )
        # Its own lengths are whole seconds.
        filled = np.pad(samples, (0, self.window - len(samples)))
        inputs = extractor(
            filled, sampling_rate=self.sample_rate, return_tensors="np", padding=False, do_normalize=False,
            truncation=False,
        )  # fmt: skip
        return np.asarray(inputs.input_features[0], dtype=np.float32)

    @override
    def network(self, top: int) -> NetworkSpec:
        config = self.keys(encoder_layers=max(top, 1), decoder_layers=0)
        decoder = r"(model\.)?decoder\..*"
        heads = r"(proj_out|classifier|projector|layer_weights)\b.*"
        unexpected = (decoder, heads, *self.above(top, r"(\w+\.)?encoder\.layers"))
        return NetworkSpec("WhisperModel", ("WhisperConfig", config), missing=(decoder,), unexpected=unexpected)

    @override
    def slimmed(self, network: Any, output: Output) -> Any:
        return network.encoder

    @override
    def blocks(self, network: Any) -> Any:
        return network.layers


@dataclass(frozen=True)
class Ast(SpectrogramEncoder):
    """The audio spectrogram transformer (Gong et al. 2021): windows of 10.24 s, patches every 100 ms.

    A frame is the mean of the patches of all frequencies at one time.
    """

    name: ClassVar[str] = "ast"
    model_types: ClassVar[tuple[str, ...]] = ("audio-spectrogram-transformer",)

    @property
    def _patch(self) -> int:
        return self.number("patch_size", default=16)

    @property
    def _step(self) -> int:
        return self.number("time_stride", default=10)

    @property
    def _mel_frames(self) -> int:
        return self.number("max_length", default=1024)

    @property
    @override
    def window(self) -> int:
        return (self._mel_frames - 1) * self.mel_hop + 400

    @property
    @override
    def timing(self) -> Timing:
        seen = (self._patch - 1) * self.mel_hop + 400
        return uniform(self.sample_rate, self._step * self.mel_hop, Fraction(seen, 2))

    @override
    def n_frames(self, n_samples: int) -> int:
        return (self._mel_frames - self._patch) // self._step + 1

    @override
    def spectrogram(self, samples: Samples, *, normalize: bool) -> npt.NDArray[np.float32]:
        from dancedata.audio.hf.mel import kaldi_log_mel

        bins = self.number("num_mel_bins", default=128)
        mel = np.zeros((self._mel_frames, bins), np.float32)
        log_mel = kaldi_log_mel(samples, self.sample_rate, n_bins=bins, window="hann")
        mel[: len(log_mel)] = log_mel
        if normalize and self.extractor.get("do_normalize", True):
            mean, std = self.extractor.get("mean", -4.2677393), self.extractor.get("std", 4.5689974)
            mel = (mel - np.float32(mean)) / np.float32(2 * std)
        return mel

    @override
    def network(self, top: int) -> NetworkSpec:
        unexpected = (r"classifier\..*", *self.above(top, r"(\w+\.)?(encoder\.)?layers?"))
        return NetworkSpec("ASTModel", ("ASTConfig", self.keys(num_hidden_layers=max(top, 1))), unexpected=unexpected)

    @override
    def blocks(self, network: Any) -> Any:
        # transformers 4 has them in an encoder.
        return network.layers if hasattr(network, "layers") else network.encoder.layer

    @override
    def frames(self, network: Any, inputs: torch.Tensor, output: Output, layers: tuple[int, ...]) -> Frames:
        states, times = super().frames(network, inputs, output, layers), self.n_frames(0)
        # The first two tokens belong to no patch.
        return {k: v[:, 2:].reshape(len(v), -1, times, v.shape[-1]).mean(dim=1) for k, v in states.items()}


@dataclass(frozen=True)
class Clap(SpectrogramEncoder):
    """The audio tower of CLAP (Wu et al. 2023): windows of 10 s, 3.2 frames per second.

    A frame is the mean over frequency of the last stage's map. Earlier stages have other rates and are not offered.
    """

    name: ClassVar[str] = "clap"
    model_types: ClassVar[tuple[str, ...]] = ("clap", "clap_audio_model")

    @property
    @override
    def mel_hop(self) -> int:
        return self.number("hop_length", of=self.extractor, default=480)

    @property
    def _stages(self) -> int:
        return len(self.encoder_config.get("depths", (2, 2, 6, 2)))

    @property
    def _image(self) -> tuple[int, int]:
        """Log-mel frames of the image that the network sees, and of one frame of its last stage."""
        size = self.number("spec_size", of=self.encoder_config, default=256)
        ratio = size // self.number("num_mel_bins", of=self.encoder_config, default=64)
        stride = self.encoder_config.get("patch_stride", (4, 4))
        step = stride[1] if isinstance(stride, list | tuple) else int(stride)
        return size * ratio, step * 2 ** (self._stages - 1)

    @property
    @override
    def window(self) -> int:
        return self.number("max_length_s", of=self.extractor, default=10) * self.sample_rate

    @property
    @override
    def timing(self) -> Timing:
        width, span = self._image
        n_mel = self.window // self.mel_hop + 1
        scale = Fraction((n_mel - 1) * self.mel_hop, width - 1) if n_mel < width else Fraction(self.mel_hop)
        return Timing(self.sample_rate, span * scale, Fraction(span - 1, 2) * scale)

    @property
    @override
    def n_layers(self) -> int:
        return self._stages

    @property
    @override
    def layers(self) -> range:
        return range(self._stages, self._stages + 1)

    @override
    def n_frames(self, n_samples: int) -> int:
        width, span = self._image
        return width // span

    @override
    def width(self, output: Output) -> int:
        first = self.number("patch_embeds_hidden_size", of=self.encoder_config, default=96)
        return int(first * 2 ** (self._stages - 1))

    @override
    def spectrogram(self, samples: Samples, *, normalize: bool) -> npt.NDArray[np.float32]:
        from transformers import ClapFeatureExtractor

        settings = {k: v for k, v in self.extractor.items() if k in _CLAP_KEYS}
        extractor = ClapFeatureExtractor(**settings)
        inputs = extractor(samples, sampling_rate=self.sample_rate, return_tensors="np")
        return np.asarray(inputs["input_features"][0], dtype=np.float32)

    @override
    def network(self, top: int) -> NetworkSpec:
        other = r"(text_model|text_projection|logit_scale_a|logit_scale_t|audio_projection)\b.*"
        # Buffers of batch normalisation in training, and of attention: integers that are computed.
        counted = r".*(num_batches_tracked|relative_position_index)"
        return NetworkSpec(
            "ClapAudioModelWithProjection",
            ("ClapAudioConfig", self.keys()),
            missing=(r"audio_projection\..*", counted),
            unexpected=(other, counted),
        )

    @override
    def slimmed(self, network: Any, output: Output) -> Any:
        return network.audio_model

    @override
    def frames(self, network: Any, inputs: torch.Tensor, output: Output, layers: tuple[int, ...]) -> Frames:
        import torch

        # The extractor marks a single song as longer than a window in every case.
        longer = torch.ones((len(inputs), 1), dtype=torch.bool, device=inputs.device)
        states = network(input_features=inputs, is_longer=longer).last_hidden_state
        return {self.n_layers: states.mean(dim=2).transpose(1, 2)}


_CLAP_KEYS = (
    "feature_size", "sampling_rate", "hop_length", "max_length_s", "fft_window_size", "padding_value",
    "frequency_min", "frequency_max", "top_db", "truncation", "padding",
)  # fmt: skip
