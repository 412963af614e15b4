"""Perception Encoder Audio: a codec's encoder and a transformer, 25 frames per second."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from dancedata.audio.hf.families.base import Family, NetworkSpec, Output, Prepared, Samples, Timing, uniform, waveform
from dancedata.core.typing import override

if TYPE_CHECKING:
    import torch

    from dancedata.audio.hf.families.base import Frames


@dataclass(frozen=True)
class PeAudio(Family):
    """The audio encoder of PE-AV (Meta 2025), aligned with text frame by frame; it needs transformers 5."""

    name: ClassVar[str] = "pe-audio"
    model_types: ClassVar[tuple[str, ...]] = ("pe_audio", "pe_audio_encoder")
    depth: ClassVar[tuple[str, int]] = ("num_hidden_layers", 6)
    size: ClassVar[tuple[str, int]] = ("hidden_size", 1792)

    @property
    def _hop(self) -> int:
        dac = self.encoder_config.get("dac_config")
        ratios = dac.get("downsampling_ratios") if isinstance(dac, Mapping) else None
        return math.prod(ratios or (2, 8, 10, 12))

    @property
    @override
    def timing(self) -> Timing:
        return uniform(self.sample_rate, self._hop, Fraction(self._hop, 2))

    @override
    def n_frames(self, n_samples: int) -> int:
        return -(-n_samples // self._hop)

    @override
    def prepared(self, samples: Samples, *, normalize: bool) -> Prepared:
        return waveform(np.pad(samples, (0, -len(samples) % self._hop), "reflect"))

    @override
    def network(self, top: int) -> NetworkSpec:
        other = r"(text_model|text_audio_head|audio_head|text_audio_logit_scale|text_audio_logit_bias)\b.*"
        return NetworkSpec(
            "PeAudioEncoder",
            ("PeAudioEncoderConfig", self.keys(num_hidden_layers=max(top, 1))),
            unexpected=(other, *self.above(top, r"(\w+\.)?layers")),
            renamed={r"^audio_encoder\.": ""},
        )

    @override
    def blocks(self, network: Any) -> Any:
        return network.layers

    @override
    def frames(self, network: Any, inputs: torch.Tensor, output: Output, layers: tuple[int, ...]) -> Frames:
        import torch

        missing = -inputs.shape[-1] % self._hop
        if missing:
            inputs = torch.nn.functional.pad(inputs[:, None], (0, missing), "reflect")[:, 0]

        states = super().frames(network, inputs[:, None], output, layers)
        # Blocks see a class token before the frames.
        return {k: v if k == self.n_layers else v[:, 1:] for k, v in states.items()}
