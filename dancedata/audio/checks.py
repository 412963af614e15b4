"""What audio features require of the signals and windows that they are given."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid

#: Above it the squared spectrum might overflow float32; full scale is 1.
MAX_SAMPLE = 1e12


def require_samples(feature: str, signal: AudioSignal) -> None:
    """Raise DataError for a signal without samples, or with samples whose spectrum would overflow."""
    if len(signal.samples) == 0:
        raise DataError(f"{feature}: the signal has no samples", reason="empty_audio", found="0 samples")
    # Not "any > maximum": NaN fails every comparison.
    bad = np.flatnonzero(~(np.abs(signal.samples) <= MAX_SAMPLE))
    if bad.size:
        raise DataError(
            f"{feature}: the signal has samples that are NaN, infinite or too large",
            reason="nan",
            found=f"{bad.size} samples, the first is {signal.samples[bad[0]]} at sample {bad[0]}",
            allowed=f"finite samples up to {MAX_SAMPLE:g} (full scale is 1)",
            fix="export the file again, for example as 16-bit wav",
        )


def require_windows(feature: str, signal: AudioSignal, starts: NDArray[np.int64], n_samples: int) -> None:
    """Raise DataError if a window of `n_samples` samples is not within the signal."""
    if len(starts) == 0:
        return
    first, last = int(np.min(starts)), int(np.max(starts)) + n_samples
    if first < 0 or last > len(signal.samples):
        raise DataError(
            f"{feature}: a window reaches beyond the audio",
            reason="short_audio",
            found=f"windows from sample {first} to {last}",
            allowed=f"0 to {len(signal.samples)} (at {signal.sample_rate} Hz)",
        )


def require_rows(feature: str, available: int, n_rows: int, grid: FrameGrid) -> None:
    """Raise DataError if windows give fewer rows than are asked for."""
    if n_rows > available:
        raise DataError(
            f"{feature}: the windows are too short",
            reason="short_audio",
            found=f"windows of {available} rows",
            allowed=f"audio for {n_rows} rows at {grid.rate} frames per second",
        )
