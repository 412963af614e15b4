"""MuQ: a conformer over a log-mel spectrogram, 25 frames per second.

Zhu et al. 2025, "MuQ: Self-Supervised Music Representation Learning with Mel Residual Vector Quantization". The
package ``muq`` needs torchaudio, einops, nnAudio, easydict and x_clip; this needs what transformers needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

from dancedata.audio.hf.families.base import Family, NetworkSpec, Timing, uniform
from dancedata.core.typing import override

SAMPLE_RATE, N_FFT = 24_000, 2048


@dataclass(frozen=True)
class MuQ(Family):
    """MuQ (Zhu et al. 2025), MuQ-large-msd-iter among others."""

    name: ClassVar[str] = "muq"
    model_types: ClassVar[tuple[str, ...]] = ("muq",)
    depth: ClassVar[tuple[str, int]] = ("encoder_depth", 12)
    size: ClassVar[tuple[str, int]] = ("encoder_dim", 1024)

    @property
    @override
    def sample_rate(self) -> int:
        return SAMPLE_RATE

    @property
    def mel_hop(self) -> int:
        """Samples from one log-mel frame to the next."""
        return self.number("hop_length", default=240)

    @property
    @override
    def max_rate(self) -> Fraction:
        return Fraction(SAMPLE_RATE, self.mel_hop)

    @property
    def strides(self) -> tuple[int, int]:
        """Strides in time of the two convolutional modules: 25 or 50 frames per second."""
        return (2, 2) if self.number("label_rate", default=25) <= 25 else (2, 1)

    @property
    @override
    def timing(self) -> Timing:
        first, second = self.strides
        return uniform(SAMPLE_RATE, self.mel_hop * first * second, 0)

    @property
    @override
    def min_samples(self) -> int:
        return max(N_FFT // 2 + 1, int(self.timing.hop))

    @override
    def n_frames(self, n_samples: int) -> int:
        n = n_samples // self.mel_hop
        for stride in self.strides:
            n = -(-n // stride)
        return n

    @override
    def network(self, top: int) -> NetworkSpec:
        parts = r"(linear|cls_token|recon_proj|rvq|quantizer_\w+|preprocessor_\w+)\b.*"
        return NetworkSpec(
            "MuQ",
            ("", self.keys(encoder_depth=max(top, 1))),
            unexpected=(parts, r".*num_batches_tracked", *self.above(top, r"conformer\.layers")),
            renamed={r"^model\.": ""},
        )

    @override
    def blocks(self, network: Any) -> Any:
        return network.conformer.layers
