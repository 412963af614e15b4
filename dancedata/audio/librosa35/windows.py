"""Windows of one track at the features' rate, each with the edge effects of its resampling."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dancedata.audio.librosa35.arrays import Floats, cut, each_times
from dancedata.audio.librosa35.resample import filter_radius, head_matrix, period, reach_out, tail_matrix
from dancedata.core.audio_signal import resampled_length
from dancedata.kernel import resample

# Samples at each end of a window that differ from the track's, the same at every level of the pyramid: halving turns
# an end of one reach of the 2:1 filter into half a reach, and the filter itself adds half a reach.
END = filter_radius(2, 1)


@dataclass(frozen=True)
class Windows:
    """Windows of a track (m,), all of one length.

    `starts`: (W,) first sample of each.
    `heads`, `tails`: (W, e): replace the track's samples at the ends of the windows.
    """

    track: Floats
    starts: NDArray[np.int64]
    length: int
    heads: Floats
    tails: Floats

    @classmethod
    def whole(cls, track: Floats) -> Windows:
        """Return one window that is the whole track."""
        none = np.empty((1, 0), dtype=np.float32)
        return cls(track, np.zeros(1, dtype=np.int64), len(track), none, none)

    @property
    def is_whole(self) -> bool:
        """Whether there is one window: the whole track, so that no ends differ."""
        return self.length == len(self.track) and self.end == 0 and len(self.starts) == 1

    @property
    def end(self) -> int:
        """Samples at each end that differ from the track's."""
        return int(self.heads.shape[1])

    def some(self, part: slice | NDArray[np.int64]) -> Windows:
        """Return some of the windows."""
        return Windows(self.track, self.starts[part], self.length, self.heads[part], self.tails[part])

    def largest(self) -> Floats:
        """Return the largest magnitude of each window's samples, (W,)."""
        peaks = [np.abs(self.track[start : start + self.length]).max() for start in self.starts]
        return np.array(peaks, dtype=np.float32)

    def head(self, count: int) -> Floats:
        """Return the first samples of every window, (W, count); `end` <= count <= length - `end`."""
        samples = cut(self.track, self.starts, count)
        samples[:, : self.end] = self.heads
        return samples

    def tail(self, count: int) -> Floats:
        """Return the last samples of every window, (W, count); `end` <= count <= length - `end`."""
        samples = cut(self.track, self.starts + (self.length - count), count)
        samples[:, count - self.end :] = self.tails
        return samples


def resampled_windows(
    samples: Floats, starts: NDArray[np.int64], length: int, from_rate: int, to_rate: int
) -> Windows:
    """Resample windows of a signal at `starts` (W,), each as if it were cut out first."""
    new_starts = starts * to_rate // from_rate
    new_length = resampled_length(length, from_rate, to_rate)
    if from_rate == to_rate:
        none = np.empty((len(starts), 0), dtype=np.float32)
        return Windows(samples, new_starts, new_length, none, none)
    end = max(END, reach_out(from_rate, to_rate))
    n_head = filter_radius(from_rate, to_rate) + math.ceil(end * from_rate / to_rate)
    # The input of the tail must begin at an instant with a sample at both rates, as the windows do.
    step = period(from_rate, to_rate)
    n_tail = length - (length - n_head) // step * step
    heads = each_times(cut(samples, starts, n_head), head_matrix(from_rate, to_rate, n_head, end))
    tails = each_times(cut(samples, starts + (length - n_tail), n_tail), tail_matrix(from_rate, to_rate, n_tail, end))
    return Windows(resample(samples, from_rate, to_rate), new_starts, new_length, heads, tails)


def shortest(from_rate: int, to_rate: int, halvings: int, half: int) -> int:
    """Return the least length of windows, in samples at `from_rate`, whose ends do not meet at any level."""
    # At the last level the first frames, which reach half a frame beyond the head, must not meet the tail; at the
    # level before it, a head of three ends must not.
    longest = max((2 * END + 2 * half) << halvings, (4 * END + 2) << max(0, halvings - 1))
    return math.ceil(longest * max(1.0, from_rate / to_rate)) + period(from_rate, to_rate)


def halved_windows(windows: Windows, track: Floats) -> Windows:
    """Halve the rate of windows, each by itself; `track` is their track at half the rate."""
    n_head = 3 * END
    # It begins at an even sample, as the windows do: one more sample if their length is odd.
    n_tail = n_head + windows.length % 2
    heads = each_times(windows.head(n_head), head_matrix(2, 1, n_head, END)) / np.sqrt(np.float32(0.5))
    tails = each_times(windows.tail(n_tail), tail_matrix(2, 1, n_tail, END)) / np.sqrt(np.float32(0.5))
    return Windows(track, windows.starts // 2, (windows.length + 1) // 2, heads, tails)
