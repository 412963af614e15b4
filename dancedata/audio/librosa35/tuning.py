"""Deviation of a window's pitches from concert pitch: librosa's `estimate_tuning`, from peaks found once per row.

The median and the histogram are those of the peaks in the window's rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.librosa35.arrays import Floats

# The resolution of the estimate: steps of a hundredth of a bin, 36 bins per octave.
N_TUNINGS = 100
BINS_PER_OCTAVE = 36
_MIN_HZ, _MAX_HZ = 150.0, 4000.0
# Peaks below this part of the row's largest magnitude do not count.
_THRESHOLD = np.float32(0.1)
_A4_HZ = 440.0
# Bound on the float32 rounding of a magnitude, as a part of the row's largest.
_ROUNDING = np.float32(3e-6)


@dataclass(frozen=True)
class Peaks:
    """Spectral peaks of rows, row by row.

    `first`: (R + 1,) peaks first[r] .. first[r + 1] - 1 are those of row r.
    `magnitude`: (P,), interpolated.
    `tuning`: (P,) index of the deviation from the nearest bin, of `N_TUNINGS`.
    `is_vague`: (P,) whether rounding may decide that it is a peak: it barely stands out, as in the flat spectrum of a
        click.
    """

    first: NDArray[np.int64]
    magnitude: Floats
    tuning: NDArray[np.int64]
    is_vague: NDArray[np.bool_]

    @classmethod
    def concatenated(cls, parts: Sequence[Peaks]) -> Peaks:
        """Concatenate the rows of the parts."""
        counts = np.concatenate([np.diff(part.first) for part in parts])
        return cls(
            np.concatenate([[0], np.cumsum(counts)]),
            np.concatenate([part.magnitude for part in parts]),
            np.concatenate([part.tuning for part in parts]),
            np.concatenate([part.is_vague for part in parts]),
        )


def find_peaks(spectrum: Floats, rate: int, *, is_power: bool) -> Peaks:
    """Find the local maxima of rows of a spectrum (R, n_fft / 2 + 1) between 150 and 4,000 Hz."""
    n_fft = 2 * (spectrum.shape[1] - 1)
    frequencies = np.fft.rfftfreq(n_fft, 1.0 / rate)
    in_range = np.flatnonzero((frequencies >= _MIN_HZ) & (frequencies < min(_MAX_HZ, rate / 2)))
    low, high = int(in_range[0]), int(in_range[-1]) + 1
    largest = spectrum.max(axis=1)
    middle = spectrum[:, low:high]
    is_peak = middle > (_THRESHOLD**2 if is_power else _THRESHOLD) * largest[:, np.newaxis]
    is_peak &= middle > spectrum[:, low - 1 : high - 1]
    is_peak &= middle >= spectrum[:, low + 1 : high + 1]
    row, column = np.divmod(np.flatnonzero(is_peak), high - low)
    column += low
    at, flat = row * spectrum.shape[1] + column, spectrum.reshape(-1)
    below, peak, above, top = flat[at - 1], flat[at], flat[at + 1], largest[row]
    if is_power:
        below, peak, above, top = np.sqrt(below), np.sqrt(peak), np.sqrt(above), np.sqrt(top)
    shift = _parabola_shift(below, peak, above)
    pitch = ((column + shift) * float(rate) / n_fft).astype(np.float32)
    first = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=len(spectrum)))])
    return Peaks(
        first=first,
        magnitude=peak + np.float32(0.5) * ((above - below) / np.float32(2)) * shift,
        tuning=_deviation(pitch),
        is_vague=peak - np.maximum(below, above) < _ROUNDING * top,
    )


def window_tuning(peaks: Peaks, rows: NDArray[np.int64]) -> tuple[int, bool]:
    """Return the most frequent deviation among the louder half of peaks of `rows` (T,), and whether it is certain."""
    magnitude, tuning, n_vague = _of_rows(peaks, rows)
    count = len(magnitude)
    if not count:
        return N_TUNINGS // 2, True
    low, high = (count - 1) // 2, count // 2
    ordered = np.partition(magnitude, (low, high))
    median = (ordered[low] + ordered[high]) / np.float32(2)
    bars = np.bincount(tuning[magnitude >= median], minlength=N_TUNINGS)
    second, highest = np.partition(bars, (-2, -1))[-2:]
    return int(bars.argmax()), bool(n_vague == 0 or n_vague < highest - second)


def _of_rows(peaks: Peaks, rows: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64], int]:
    """Return magnitudes and tunings of the rows' peaks, and the number of vague ones."""
    # Rows of a window form a few runs of consecutive rows: head, middle, tail.
    breaks = (np.flatnonzero(rows[1:] - rows[:-1] != 1) + 1).tolist()
    runs = zip([0, *breaks], [*breaks, len(rows)], strict=True)
    parts = [slice(peaks.first[rows[start]], peaks.first[rows[stop - 1] + 1]) for start, stop in runs]
    magnitude = np.concatenate([peaks.magnitude[part] for part in parts])
    tuning = np.concatenate([peaks.tuning[part] for part in parts])
    return magnitude, tuning, sum(int(np.count_nonzero(peaks.is_vague[part])) for part in parts)


@lru_cache(maxsize=1)
def tuning_edges() -> NDArray[np.float64]:
    """Return the edges (101,) of the histogram in bins; the estimate is the lower edge of a histogram's bar."""
    return np.linspace(-0.5, 0.5, N_TUNINGS + 1)


def _parabola_shift(below: Floats, peak: Floats, above: Floats) -> Floats:
    """Return the distance of a parabola's vertex from the middle one of three points, at most 1."""
    curvature = (above + below) - 2.0 * peak.astype(np.float64)
    slope = (above - below) / 2.0
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(np.abs(slope) >= np.abs(curvature), 0.0, -slope / curvature)
    return shift.astype(np.float32)


def _deviation(pitch: Floats) -> NDArray[np.int64]:
    """Return the histogram bar of each frequency (librosa's `pitch_tuning`)."""
    octaves = np.log2(pitch / np.float32(_A4_HZ / 16))
    deviation = np.mod(np.float32(BINS_PER_OCTAVE) * octaves, np.float32(1.0))
    deviation[deviation >= 0.5] -= np.float32(1.0)
    bar = np.searchsorted(tuning_edges(), deviation.astype(np.float64), side="right") - 1
    return np.asarray(np.minimum(bar, N_TUNINGS - 1))
