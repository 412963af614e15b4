"""template_name: columns of music."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import AudioFeature, Float32Array
from dancedata.core.registry import FEATURES


@FEATURES.register("template_name")
@dataclass(frozen=True)
class TemplateName(AudioFeature):
    """Peak of the signal between one frame and the next.

    Attributes
    ----------
    scale
        Factor of the values.
    """

    version: ClassVar[int] = 1  # raise it whenever the numbers change: it is part of the cache key
    packages: ClassVar[tuple[str, ...]] = ("numpy",)  # their versions are part of it too

    scale: float = 1.0

    def __post_init__(self) -> None:
        """Check the parameters; an error here is a problem of the recipe."""
        if not self.scale > 0:
            raise UsageError("scale must be above 0", found=self.scale)

    @property
    def columns(self) -> Columns:
        """The columns; music has no mirror image."""
        return Columns((Group("peak", 1, "1"),))

    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Count the rows of `extract`: instants 0, 1 / fps, ... within the signal."""
        return FrameGrid.of(sample_rate).resampled_length(n_samples, grid)

    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> Float32Array:
        """Return (T, 1) of a whole signal; row t belongs to t / fps seconds."""
        self.require_samples(signal)
        rows = np.arange(self.n_rows(signal.n_samples, signal.sample_rate, grid))
        # Whole numbers: exact at rates such as 30000/1001 too.
        first = rows * signal.sample_rate * grid.rate.denominator // grid.rate.numerator
        peaks = np.maximum.reduceat(np.abs(signal.samples), first)
        return (self.scale * peaks).astype(np.float32)[:, None]
