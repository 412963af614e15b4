"""Chroma CENS of windows: the constant-Q pyramid, its magnitudes, and the smoothing.

Müller and Ewert (ISMIR 2011), as librosa computes it: the magnitudes of 36 filters per octave, seven octaves,
summed to 12 chroma; each frame scaled to a sum of 1, quantised to quarters, smoothed over 41 frames and scaled
to unit length.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.audio._settings import HOP
from dancedata.audio.librosa35.arrays import Floats, strided, times_on_grid
from dancedata.audio.librosa35.filters import N_OCTAVES, FilterBank, filter_bank
from dancedata.audio.librosa35.resample import halved
from dancedata.audio.librosa35.tuning import BINS_PER_OCTAVE
from dancedata.audio.librosa35.windows import Windows, halved_windows

N_CHROMA = 12
STEPS = (0.4, 0.2, 0.1, 0.05)
_SMOOTHING_FRAMES = 41
_WINDOWS_AT_ONCE = 16
_FRAMES_AT_ONCE = 256


def window_chroma(windows: Windows, tunings: Sequence[int], rate: int) -> Floats:
    """Return the chroma (W, T, 12) of windows with their `tunings`, before any scaling."""
    n_frames = 1 + windows.length // HOP
    pitches = np.zeros((len(windows.starts), n_frames, BINS_PER_OCTAVE), dtype=np.float32)
    level = windows
    for octave in range(N_OCTAVES):
        if octave:
            track = halved(level.track)
            level = Windows.whole(track) if level.is_whole else halved_windows(level, track)
        _add_octave(level, HOP >> octave, tunings, rate, pitches)
    # The three bins around each semitone: 35 + 0 + 1, 2 + 3 + 4, ...
    thirds = np.roll(pitches, 1, axis=2).reshape(*pitches.shape[:2], N_CHROMA, 3)
    chroma: Floats = thirds[..., 0] + thirds[..., 1] + thirds[..., 2]
    return chroma


def _add_octave(windows: Windows, hop: int, tunings: Sequence[int], rate: int, pitches: Floats) -> None:
    """Add the magnitudes of one octave to pitches (W, T, 36)."""
    if windows.is_whole:
        _add_track_pitches(windows.track, hop, filter_bank(tunings[0], rate), pitches[0])
        return
    # At some rates, such as 20 and 40 frames per second, filters are half as long for some tunings as for others.
    for half, alike in _runs([len(filter_bank(tuning, rate).even) for tuning in tunings]):
        for first in range(alike.start, alike.stop, _WINDOWS_AT_ONCE):
            part = slice(first, min(first + _WINDOWS_AT_ONCE, alike.stop))
            octave = _Octave(windows.some(part), hop, half, pitches.shape[1])
            for tuning, run in _runs(tunings[part]):
                octave.add_magnitudes(run, filter_bank(tuning, rate), pitches[part][run])


def _add_track_pitches(track: Floats, hop: int, bank: FilterBank, pitches: Floats) -> None:
    """Add the magnitudes of one octave of a track to pitches (T, 36)."""
    half = len(bank.even)
    frames = Frames(track[np.newaxis], half, half, hop, len(pitches))
    for first in range(0, len(pitches), _FRAMES_AT_ONCE):
        part = slice(first, first + _FRAMES_AT_ONCE)
        even, odd = frames.folded(np.add, part), frames.folded(np.subtract, part)
        pitches[part] += _magnitudes(times_on_grid(even, bank.even, first), times_on_grid(odd, bank.odd, first))


class _Octave:
    """Frames of windows at one level of the pyramid, folded.

    The first and last `n_end` frames belong to each window. The frames between belong to the track: folded once for
    all windows, and filtered once for adjacent windows of the same tuning.
    """

    def __init__(self, windows: Windows, hop: int, half: int, n_frames: int) -> None:
        # They hold all samples that are the window's own, also where frames are shorter than that.
        self.n_end = max(-(-(windows.end + half) // hop), 1 - (half - windows.end) // hop)
        self.n_frames = n_frames
        self.first = windows.starts // hop + self.n_end
        n_middle = n_frames - 2 * self.n_end
        start = int(self.first[0]) * hop - half
        count = int(self.first[-1] - self.first[0]) + n_middle
        samples = windows.track[np.newaxis, start : start + (count - 1) * hop + 2 * half]
        middle = Frames(samples, 0, half, hop, count)
        heads = Frames(windows.head((self.n_end - 1) * hop + half), half, half, hop, self.n_end)
        last = (n_frames - self.n_end) * hop - half
        tails = Frames(windows.tail(windows.length - last), 0, half, hop, self.n_end)
        everything = slice(None)
        self.middle = [middle.folded(combine, everything) for combine in (np.add, np.subtract)]
        # The ends of a window are adjacent in memory, so that those of adjacent windows need no copy.
        self.ends = [np.empty((len(windows.starts), 2, self.n_end, half), dtype=np.float32) for _ in range(2)]
        for folded, combine in zip(self.ends, (np.add, np.subtract), strict=True):
            heads.fold_into(combine, folded[:, 0])
            tails.fold_into(combine, folded[:, 1])

    def add_magnitudes(self, run: slice, bank: FilterBank, pitches: Floats) -> None:
        """Add the magnitudes of a run of adjacent windows to their pitches (W, T, 36)."""
        n_windows, half = len(pitches), len(bank.even)
        n_middle = self.n_frames - 2 * self.n_end
        # Frames count from the beginning of the track: the grid of the products' rows.
        first = int(self.first[run][0])
        offsets = self.first[run] - first
        begin = first - int(self.first[0])
        rows = slice(begin, begin + int(offsets[-1]) + n_middle)
        even, odd = (folded[rows] for folded in self.middle)
        middle = _magnitudes(times_on_grid(even, bank.even, first), times_on_grid(odd, bank.odd, first))
        for k in range(n_windows):
            pitches[k, self.n_end : self.n_frames - self.n_end] += middle[offsets[k] : offsets[k] + n_middle]
        # The ends belong to each window, and so does their product.
        even, odd = (folded[run].reshape(n_windows, -1, half) for folded in self.ends)
        ends = _magnitudes(np.matmul(even, bank.even), np.matmul(odd, bank.odd))
        pitches[:, : self.n_end] += ends[:, : self.n_end]
        pitches[:, self.n_frames - self.n_end :] += ends[:, self.n_end :]


def _runs(values: Sequence[int]) -> Iterator[tuple[int, slice]]:
    """Yield runs of adjacent equal values, such as tunings."""
    start = 0
    for value, run in groupby(values):
        stop = start + len(list(run))
        yield value, slice(start, stop)
        start = stop


def _magnitudes(real: Floats, imaginary: Floats) -> Floats:
    """Return the magnitudes of responses, given their real and imaginary parts, which are overwritten."""
    np.square(real, out=real)
    real += np.square(imaginary, out=imaginary)
    return np.sqrt(real, out=real)


def cens(chroma: Floats) -> Floats:
    """Quantise, smooth and scale chroma (W, T, 12), each window by itself."""
    shares = shares_of(chroma)
    quantised = np.zeros(chroma.shape, dtype=np.float64)
    for step in STEPS:
        quantised += 0.25 * (shares > np.float32(step))
    smoothed = _smoothed(quantised).astype(np.float32)
    return _scaled(smoothed, np.sqrt(np.square(smoothed, dtype=np.float64).sum(axis=2)))


def shares_of(chroma: Floats) -> Floats:
    """Divide chroma (W, T, 12) by each frame's sum."""
    return _scaled(chroma, chroma.sum(axis=2, dtype=np.float64))


@lru_cache(maxsize=1)
def _smoothing() -> NDArray[np.float64]:
    """Hann window (43,), symmetric, with a zero at either end."""
    size = _SMOOTHING_FRAMES + 2
    window = 0.5 + 0.5 * np.cos(np.linspace(-np.pi, np.pi, size))
    smoothing: NDArray[np.float64] = window / window.sum()
    return smoothing


def _smoothed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convolve (W, T, 12) along T, with zeros beyond the ends."""
    weights = _smoothing()
    reach = len(weights) // 2
    n_windows, n_frames, n_chroma = values.shape
    padded = np.zeros((n_windows, n_frames + 2 * reach, n_chroma))
    padded[:, reach : reach + n_frames] = values
    smoothed = weights[reach] * values
    for k in range(1, reach):
        # Symmetric: two frames at a time. The first and last weights are zero.
        pair = padded[:, reach - k : reach - k + n_frames] + padded[:, reach + k : reach + k + n_frames]
        pair *= weights[reach + k]
        smoothed += pair
    return np.asarray(smoothed)


def _scaled(values: Floats, lengths: NDArray[np.float64]) -> Floats:
    """Divide each frame by its length; frames of silence stay zero (librosa's `normalize`)."""
    safe = np.where(lengths < np.finfo(np.float32).tiny, 1.0, lengths)
    scaled: Floats = (values / safe[..., np.newaxis]).astype(np.float32)
    return scaled


class Frames:
    """Frames of 2 `half` samples of signals (W, n), `hop` apart; frame 0 begins `lead` samples before the signal."""

    def __init__(self, samples: Floats, lead: int, half: int, hop: int, n_frames: int) -> None:
        n_signals, n_samples = samples.shape
        needed = max(lead + n_samples, (n_frames - 1) * hop + 2 * half + 1)
        padded = np.zeros((n_signals, needed), dtype=np.float32)
        padded[:, lead : lead + n_samples] = samples
        mirrored = np.ascontiguousarray(padded[:, ::-1])
        shape = (n_signals, n_frames, half)
        # From one sample after the middle on, and from the middle backwards: m + 1 + j and m - j.
        self._after = strided(padded, shape, (needed, hop, 1), half + 1)
        self._before = strided(mirrored, shape, (needed, -hop, 1), needed - 1 - half)
        self._ends = strided(padded, (n_signals, n_frames, 2), (needed, hop, 1))

    def folded(self, combine: Any, part: slice) -> Floats:
        """Return sums (`np.add`) or differences (`np.subtract`) of samples at equal distances; (W F, half)."""
        after = self._after[:, part]
        folded: Floats = np.empty(after.shape, dtype=np.float32)
        self._fold(combine, part, folded)
        return folded.reshape(-1, after.shape[2])

    def fold_into(self, combine: Any, out: Floats) -> None:
        """Write the sums or differences of all frames into an array (W, n_frames, half)."""
        self._fold(combine, slice(None), out)

    def _fold(self, combine: Any, part: slice, out: Floats) -> None:
        ends = self._ends[:, part]
        combine(self._after[:, part], self._before[:, part], out=out)
        combine(ends[..., 0], ends[..., 1], out=out[..., -1])
