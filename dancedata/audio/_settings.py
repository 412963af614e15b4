"""Sizes, settings and the base of features that librosa computes."""

import logging
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

from dancedata.core.audio_signal import resampled_length
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import AudioFeature
from dancedata.core.typing import override

#: Samples per frame at the features' sample rate.
HOP = 512
N_COLUMNS = 35
#: The tempo is estimated from the audio as `librosa.load` gives it by default.
TEMPO_SAMPLE_RATE = 22050


@dataclass(frozen=True)
class Settings:
    """Parameters of the analysis of a signal; rates in Hz.

    `rate`: At which features are computed: `HOP` times the frame rate.
    `start_bpm`: Where the search for the tempo starts, in beats per minute; None: at an estimate from the signal.
    `tightness`: How closely beats keep to the tempo (librosa's `beat_track`).
    """

    sample_rate: int
    rate: int
    start_bpm: float | None
    tightness: float


@lru_cache(maxsize=64)
def log_once(message: str, reason: str) -> None:
    """Log a warning, once per process and reason."""
    logging.getLogger(__name__).warning(message, reason)


class HopFeature(AudioFeature):
    """Base of features of librosa with a hop of 512 samples, at a sample rate of 512 times the rows per second."""

    packages: ClassVar[tuple[str, ...]] = ("librosa", "numpy", "scipy", "soxr")
    min_sample_rate: ClassVar[int] = 1
    usual_rates: ClassVar[str]

    @override
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        return 1 + resampled_length(n_samples, sample_rate, self.feature_rate(grid)) // HOP

    def feature_rate(self, grid: FrameGrid) -> int:
        """Return the sample rate for the rows of a grid, Hz; UsageError unless it is possible."""
        rate = grid.divided(HOP).rate
        if rate.denominator != 1 or rate < self.min_sample_rate:
            raise UsageError(
                f"{self.name} cannot be computed at this frame rate",
                found=f"{grid.rate} rows per second, so a sample rate of {float(rate):g} Hz",
                allowed=f"a rate that makes 512 x rate a whole number of at least {self.min_sample_rate} Hz",
                fix=self.usual_rates,
            )
        return int(rate)
