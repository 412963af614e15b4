"""The 35 librosa columns of EDGE, Lodge, FineDance and FACT.

Onset envelope, 20 MFCC, 12 chroma CENS, onset peaks and beats: librosa's defaults at a hop of 512 samples
and a sample rate of 512 times the frame rate. Sources: FACT (Li et al. 2021, the mint repository), whose
function EDGE (Tseng et al. 2023) and Lodge (Li et al. 2024) adopted. The numbers are librosa's own; versions 0.11
and 1.0 gave the same bits at 24 frames per second and above, at 20 the chroma differed by up to 0.03.

There are two versions with equal results: `reference` calls librosa, `fast` is thirty times as fast for windows and
eighty times for tracks; docs/archive/decisions.md explains why.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._settings import N_COLUMNS, HopFeature, Settings, log_once
from dancedata.core.audio_signal import AudioSignal, pcm16
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import FEATURES
from dancedata.core.typing import override

# The top chroma filter reaches 4,107 Hz, 4,147 with the tuning half a bin up: the Nyquist frequency must
# be higher.
MIN_SAMPLE_RATE = 8300

_GROUPS = (
    Group("onset_envelope", 1, "dB"),
    Group("mfcc", 20, "dB"),
    Group("chroma_cens", 12, "1"),
    Group("onset_peak", 1, "0/1"),
    Group("beat", 1, "0/1"),
)


@FEATURES.register("librosa35")
@dataclass(frozen=True)
class Librosa35(HopFeature):
    """Onset envelope 1, MFCC 20, chroma CENS 12, onset peaks 1, beats 1.

    Parameters
    ----------
    tightness
        How closely beats keep to the tempo (librosa's `beat_track`); 100 in all reference implementations.
    method
        "fast" computes what windows have in common once, without librosa. "librosa" makes one librosa call per
        column group and window, and takes thirty times as long (docs/reference/inside.md). The numbers are the same
        within 1e-4 dB (envelope), 1e-3 dB (MFCC) and 1e-6 (chroma), peaks and beats are equal;
        docs/archive/decisions.md explains why, and the limits. "fast" computes as "librosa" does, and logs why,
        for signals and windows of less than 17 rows, more than 64 frames per second, and tracks whose largest
        sample is above 1e6 or below 1e-6.
    """

    tightness: float = 100
    method: Literal["fast", "librosa"] = "fast"

    version: ClassVar[int] = 3
    columns: ClassVar[Columns] = Columns(_GROUPS, None)
    #: librosa's onset envelope is the rise from the row before, and a beat is the row that has risen.
    beat_rows_late: ClassVar[int] = 1
    min_sample_rate: ClassVar[int] = MIN_SAMPLE_RATE
    usual_rates: ClassVar[str] = "build at 30 (or 60) frames per second; motion at any other rate is resampled to it"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.tightness) and self.tightness > 0):
            raise UsageError(
                "librosa35: invalid value for tightness", found=str(self.tightness), allowed="a number above 0"
            )
        if self.method not in ("fast", "librosa"):
            raise UsageError("librosa35: unknown method", found=str(self.method), allowed="fast, librosa")

    @override
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> NDArray[np.float32]:
        """Features of a whole track, as Lodge, FineDance and FACT compute them; see `AudioFeature.extract`.

        Signals shorter than an STFT frame (2,048 samples at the feature's rate) are padded with zeros, as librosa
        pads the ends of every signal. 512 times the rate of `grid` is a whole number of at least 8,300 Hz. Without
        `start_bpm` the search for the tempo starts at librosa's estimate from the signal at 22,050 Hz.
        """
        rate = self.feature_rate(grid)
        _require_bpm(start_bpm)
        self.require_samples(signal)
        settings = Settings(signal.sample_rate, rate, start_bpm, self.tightness)
        version = self._version(lambda fast: fast.track_obstacle(signal.samples, signal.sample_rate, rate))
        features: NDArray[np.float32] = version.track_features(signal.samples, settings)
        return features

    @override
    def estimated_bpm(self, signal: AudioSignal, grid: FrameGrid) -> float:
        rate = self.feature_rate(grid)
        self.require_samples(signal)
        version = self._version(lambda fast: fast.track_obstacle(signal.samples, signal.sample_rate, rate))
        return float(version.estimated_bpm(signal.samples, signal.sample_rate))

    @override
    def estimated_window_bpms(
        self, signal: AudioSignal, starts: NDArray[np.int64], n_samples: int, grid: FrameGrid
    ) -> list[float]:
        rate = self.feature_rate(grid)
        self.require_samples(signal)
        self.require_windows(signal, starts, n_samples)
        version = self._version(lambda fast: fast.why_not_windows(n_samples, signal.sample_rate, rate))
        windows = (pcm16(signal.samples[int(start) : int(start) + n_samples]) for start in starts)
        return [version.estimated_bpm(window, signal.sample_rate) for window in windows]

    @override
    def extract_windows(
        self,
        signal: AudioSignal,
        starts: NDArray[np.int64],
        n_samples: int,
        grid: FrameGrid,
        n_rows: int,
        *,
        start_bpm: float | None = None,
    ) -> NDArray[np.float32]:
        """Features of windows, each one by itself from its own 16-bit wav, as EDGE computes them.

        Resampling, padding, the 80 dB floor, tuning, CENS smoothing, tempo and beats depend on the window alone. Pass
        all windows of a song at once: those that begin a whole number of frames after the song does (as windows in
        frames do, at the usual rates) share most of their work. See `AudioFeature.extract_windows`.
        """
        rate = self.feature_rate(grid)
        _require_bpm(start_bpm)
        self.require_samples(signal)
        self.require_windows(signal, starts, n_samples)
        self.require_rows(self.n_rows(n_samples, signal.sample_rate, grid), n_rows, grid)
        if len(starts) == 0:
            return np.empty((0, n_rows, N_COLUMNS), dtype=np.float32)
        settings = Settings(signal.sample_rate, rate, start_bpm, self.tightness)
        version = self._version(lambda fast: fast.why_not_windows(n_samples, signal.sample_rate, rate))
        features: NDArray[np.float32] = version.window_features(signal.samples, starts, n_samples, settings)
        return features[:, :n_rows]

    def _version(self, why_not: Callable[[Any], str]) -> Any:
        """Return the module that computes; log the reason if the fast one was chosen and cannot."""
        from dancedata.audio import _librosa as reference
        from dancedata.audio.librosa35 import fast

        if self.method == "librosa":
            return reference
        if reason := why_not(fast):
            log_once("librosa35: method fast computes as method librosa does, slowly: %s", reason)
        return reference if reason else fast


def _require_bpm(start_bpm: float | None) -> None:
    if start_bpm is not None and not (math.isfinite(start_bpm) and start_bpm > 0):
        raise UsageError("librosa35: invalid value for start_bpm", found=str(start_bpm),
                         allowed="beats per minute above 0, or None for an estimate")  # fmt: skip
