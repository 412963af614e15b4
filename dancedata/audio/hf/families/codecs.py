"""Neural codecs: what enters the quantiser, or the codes that leave it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.audio.hf.families.base import Family, NetworkSpec, Output, Prepared, Samples, Timing, uniform, waveform
from dancedata.core.errors import SourceError
from dancedata.core.text import quoted
from dancedata.core.typing import override

if TYPE_CHECKING:
    import torch

    from dancedata.audio.hf.families.base import Frames


@dataclass(frozen=True)
class _Codec(Family):
    """A codec: one frame for each hop of samples, stamped with the middle of the hop that it rebuilds."""

    outputs: ClassVar[tuple[Output, ...]] = ("embedding", "codes")
    overlap_s: ClassVar[float] = 2.0
    #: Names of the model and config classes.
    classes: ClassVar[tuple[str, str]]
    #: Key of the config with the strides, whose product is a hop, and its default.
    strides: ClassVar[tuple[str, tuple[int, ...]]] = ("upsampling_ratios", (8, 5, 4, 2))
    usual_rate: ClassVar[int] = 24_000
    #: Parts of the network after the quantiser.
    unused: ClassVar[tuple[str, ...]] = ("decoder",)

    @property
    @override
    def sample_rate(self) -> int:
        return self.number("sampling_rate", default=self.usual_rate)

    @property
    def hop(self) -> int:
        """Samples of a frame."""
        return math.prod(self.sizes(*self.strides))

    @property
    @override
    def timing(self) -> Timing:
        return uniform(self.sample_rate, self.hop, Fraction(self.hop, 2))

    @property
    @override
    def n_layers(self) -> int:
        return 0

    @override
    def n_frames(self, n_samples: int) -> int:
        return -(-n_samples // self.hop)

    @override
    def network(self, top: int) -> NetworkSpec:
        model, config = self.classes
        return NetworkSpec(model, (config, self.keys()), missing=(rf"({'|'.join(self.unused)})\..*",))

    @override
    def slimmed(self, network: Any, output: Output) -> Any:
        for part in self.unused:
            if part in network._modules:
                setattr(network, part, None)
        return network


@dataclass(frozen=True)
class Encodec(_Codec):
    """EnCodec (Défossez et al. 2022) at 24, 32 and 48 kHz."""

    name: ClassVar[str] = "encodec"
    model_types: ClassVar[tuple[str, ...]] = ("encodec",)
    classes: ClassVar[tuple[str, str]] = ("EncodecModel", "EncodecConfig")

    @property
    @override
    def max_chunk(self) -> int | None:
        seconds = self.config.get("chunk_length_s")
        return None if not isinstance(seconds, int | float) else int(seconds * self.sample_rate)

    @override
    def width(self, output: Output) -> int:
        if output == "embedding":
            return self.number("hidden_size", default=128)
        bits = math.ceil(math.log2(self.number("codebook_size", default=1024)))
        return int(1000 * self._bandwidth // (math.ceil(self.sample_rate / self.hop) * bits))

    @override
    def prepared(self, samples: Samples, *, normalize: bool) -> Prepared:
        scale, channels = normalize and self.config.get("normalize", False), self.number("audio_channels", default=1)

        def inputs(start: int, n_samples: int) -> npt.NDArray[np.float32]:
            part = samples[start : start + n_samples]
            if scale:  # each chunk by its own level (EnCodec at 48 kHz)
                part = part / (np.sqrt(np.mean(part * part, dtype=np.float32)) + np.float32(1e-8))
            return np.repeat(part[None], channels, axis=0)

        return inputs

    @override
    def frames(self, network: Any, inputs: torch.Tensor, output: Output, layers: tuple[int, ...]) -> Frames:
        embedding = network.encoder(inputs)
        if output == "embedding":
            return {0: embedding.transpose(1, 2)}
        return {0: network.quantizer.encode(embedding, self._bandwidth).permute(1, 2, 0)}

    @property
    def _bandwidth(self) -> float:
        bandwidths = self.config.get("target_bandwidths", (1.5, 3.0, 6.0, 12.0, 24.0))
        return float(max(bandwidths))


@dataclass(frozen=True)
class Dac(_Codec):
    """The Descript audio codec (Kumar et al. 2023)."""

    name: ClassVar[str] = "dac"
    model_types: ClassVar[tuple[str, ...]] = ("dac",)
    classes: ClassVar[tuple[str, str]] = ("DacModel", "DacConfig")
    strides: ClassVar[tuple[str, tuple[int, ...]]] = ("downsampling_ratios", (2, 4, 8, 8))
    usual_rate: ClassVar[int] = 16_000

    @override
    def width(self, output: Output) -> int:
        if output == "codes":
            return self.number("n_codebooks", default=9)
        blocks = len(self.sizes(*self.strides))
        return self.number("hidden_size", default=self.number("encoder_hidden_size", default=64) * 2**blocks)

    @override
    def prepared(self, samples: Samples, *, normalize: bool) -> Prepared:
        return waveform(np.pad(samples, (0, -len(samples) % self.hop)))

    @override
    def frames(self, network: Any, inputs: torch.Tensor, output: Output, layers: tuple[int, ...]) -> Frames:
        from torch.nn.functional import pad

        filled = pad(inputs, (0, -inputs.shape[-1] % self.hop))
        if output == "embedding":
            return {0: network.encoder(filled[:, None]).transpose(1, 2)}
        return {0: network.encode(filled[:, None]).audio_codes.transpose(1, 2)}


@dataclass(frozen=True)
class Mimi(_Codec):
    """Mimi (Défossez et al. 2024)."""

    name: ClassVar[str] = "mimi"
    model_types: ClassVar[tuple[str, ...]] = ("mimi",)
    classes: ClassVar[tuple[str, str]] = ("MimiModel", "MimiConfig")
    strides: ClassVar[tuple[str, tuple[int, ...]]] = ("upsampling_ratios", (8, 6, 5, 4))
    unused: ClassVar[tuple[str, ...]] = ("decoder", "decoder_transformer", "upsample")

    @property
    @override
    def hop(self) -> int:
        stride = 2 * super().hop
        rate = self.config.get("frame_rate") or self.config.get("_frame_rate")
        if isinstance(rate, int | float) and rate * stride != self.sample_rate:
            raise SourceError("hf: the config of a mimi model has a frame_rate that differs from its strides",
                              found=quoted(rate), allowed=f"{self.sample_rate / stride:g}")  # fmt: skip
        return stride

    @override
    def width(self, output: Output) -> int:
        if output == "codes":
            return self.number("num_quantizers", default=32)
        return self.number("hidden_size", default=512)

    @override
    def frames(self, network: Any, inputs: torch.Tensor, output: Output, layers: tuple[int, ...]) -> Frames:
        frames = []
        quantizer = network.quantizer
        plain = quantizer.encode

        def watched(embedding: torch.Tensor, *rest: Any, **named: Any) -> torch.Tensor:
            frames.append(embedding)
            codes: torch.Tensor = plain(embedding, *rest, **named)
            return codes

        # The parts before the quantiser have other names and shapes in each version of transformers.
        quantizer.encode = watched
        try:
            codes = network.encode(inputs[:, None]).audio_codes
        finally:
            del quantizer.encode
        return {0: (frames[0] if output == "embedding" else codes).transpose(1, 2)}
