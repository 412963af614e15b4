"""Frames of an encoder become rows of a recipe, in exact time.

Frame k of a chunk that begins at sample s has the stamp s + first_centre + k hop, and represents the hop around it.
Row j has the stamp j / fps, and represents the 1 / fps around it. All times are whole numbers of one small unit, so
nothing drifts, however long the signal is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import sparse

from dancedata.audio.hf.families.base import Chunk, Timing
from dancedata.core.grid import FrameGrid

_Method = Literal["area", "linear", "nearest"]
Ints = npt.NDArray[Any]

#: Times beyond this are computed with Python's whole numbers, which have no limit.
_MAX_INT64 = 1 << 61


@dataclass(frozen=True)
class Frames:
    """Frames of all chunks of a signal, in order, (K,) each, in whole numbers of a unit of time.

    `ticks`: Units per second.
    `chunk`, `number`: Chunk of each frame, and its number there.
    `begin`, `end`: The stretch that a frame represents: its hop, within what its chunk keeps.
    `row_half`: Half of the time from one row to the next.
    """

    ticks: int
    chunk: Ints
    number: Ints
    stamp: Ints
    begin: Ints
    end: Ints
    row_half: int


@dataclass(frozen=True)
class RowMap:
    """Each row as a weighted sum of frames: entries (E,) of frame, row and weight, by frame."""

    frame: npt.NDArray[np.int64]
    row: npt.NDArray[np.int64]
    weight: npt.NDArray[np.float64]
    frames: Frames
    n_rows: int

    def of_chunk(self, chunk: int, n_frames: int) -> tuple[int, sparse.csr_array]:
        """Return the first row that a chunk contributes to, and its contributions (rows, n_frames)."""
        first, last = np.searchsorted(self.frames.chunk, [chunk, chunk + 1])
        begin, end = np.searchsorted(self.frame, [first, last])
        row, frame = self.row[begin:end], self.frames.number[self.frame[begin:end]].astype(np.int64)
        low, high = (int(row.min()), int(row.max()) + 1) if len(row) else (0, 0)
        entries = (self.weight[begin:end].astype(np.float32), (row - low, frame))
        return low, sparse.csr_array(entries, shape=(high - low, n_frames))


def frames_of(chunks: Sequence[Chunk], counts: Sequence[int], timing: Timing, grid: FrameGrid) -> Frames:
    """Return the frames that chunks keep; `counts` says how many each chunk has."""
    step, centre = timing.hop, timing.first_centre
    limits = [limit for c in chunks for limit in (c.keep_from, c.keep_to) if limit is not None]
    # The unit: samples, hops, borders and rows are whole numbers of it.
    parts = math.lcm(*(f.denominator for f in (step / 2, centre, *limits)))
    ticks = math.lcm(timing.sample_rate * parts, 2 * grid.rate.numerator)
    sample = ticks // timing.sample_rate
    longest = max((c.start + c.n_samples for c in chunks), default=0) * sample
    dtype = np.int64 if longest < _MAX_INT64 else object
    frames = []
    for index, (chunk, count) in enumerate(zip(chunks, counts, strict=True)):
        number = np.arange(count)
        stamp = number.astype(dtype) * int(step * sample) + int((chunk.start + centre) * sample)
        begin, end = stamp - int(step / 2 * sample), stamp + int(step / 2 * sample)
        if chunk.keep_from is not None:
            begin = np.maximum(begin, int(chunk.keep_from * sample))
        if chunk.keep_to is not None:
            end = np.minimum(end, int(chunk.keep_to * sample))
        kept = (end > begin).astype(bool)
        frames.append([a[kept] for a in (np.full(count, index), number, stamp, begin, end)])
    of_chunk, number, stamp, begin, end = (np.concatenate(column) for column in zip(*frames, strict=True))
    row_half = ticks * grid.rate.denominator // (2 * grid.rate.numerator)
    return Frames(ticks, of_chunk, number, stamp, begin, end, row_half)


def area_overlaps(frames: Frames, n_rows: int) -> tuple[Ints, Ints, Ints]:
    """Return for how long frames and rows overlap: (E,) frame, row, and time, sorted by frame."""
    half = frames.row_half
    first = np.maximum((frames.begin + half) // (2 * half), 0)
    last = np.minimum((frames.end - 1 + half) // (2 * half), n_rows - 1)
    count = np.maximum(last - first + 1, 0).astype(np.int64)
    frame = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(frame)) - np.repeat(np.cumsum(count) - count, count)
    row = first[frame] + within
    begin = np.maximum(frames.begin[frame], (2 * row - 1) * half)
    end = np.minimum(frames.end[frame], (2 * row + 1) * half)
    return frame, row.astype(np.int64), end - begin


def row_map(frames: Frames, n_rows: int, method: _Method) -> RowMap:
    """Return how frames become rows.

    "area": each frame counts for as long as its stretch overlaps with the row's, 2 `row_half` long. "linear": between
    the two frames around the row's stamp. "nearest": the frame that is nearest to it, the earlier one of two. Rows
    before the first frame and after the last one are that frame.
    """
    row = np.arange(n_rows)
    right = np.clip(np.searchsorted(frames.stamp, row * 2 * frames.row_half), 1, max(1, len(frames.stamp) - 1))
    if len(frames.stamp) == 1:
        return _sorted(np.zeros(n_rows, np.int64), row, np.ones(n_rows), frames, n_rows)
    left = right - 1
    after = np.clip(row * 2 * frames.row_half - frames.stamp[left], 0, frames.stamp[right] - frames.stamp[left])
    share = (after / (frames.stamp[right] - frames.stamp[left])).astype(np.float64)
    if method == "linear":
        both = np.concatenate([left, right]), np.concatenate([row, row]), np.concatenate([1 - share, share])
        used = both[2] > 0
        return _sorted(both[0][used], both[1][used], both[2][used], frames, n_rows)
    nearest = np.where(share > 0.5, right, left)
    if method == "nearest":
        return _sorted(nearest, row, np.ones(n_rows), frames, n_rows)
    frame, of, time = area_overlaps(frames, n_rows)
    covered = np.bincount(of, weights=time.astype(np.float64), minlength=n_rows)
    empty = np.flatnonzero(covered == 0)
    weight = time.astype(np.float64) / covered[of]
    return _sorted(
        np.concatenate([frame, nearest[empty]]),
        np.concatenate([of, empty]),
        np.concatenate([weight, np.ones(len(empty))]),
        frames,
        n_rows,
    )


def _sorted(frame: Ints, row: Ints, weight: npt.NDArray[np.float64], frames: Frames, n_rows: int) -> RowMap:
    order = np.argsort(frame, kind="stable")
    return RowMap(frame[order].astype(np.int64), row[order].astype(np.int64), weight[order], frames, n_rows)


class RowSum:
    """Rows that are added up chunk by chunk; those that are complete take the type that they are stored in."""

    def __init__(self, rows: RowMap, width: int, finish: Any) -> None:
        self._map = rows
        self._finish = finish
        self._open = np.zeros((0, width), np.float32)
        self._first_open = 0
        self._done: list[npt.NDArray[Any]] = []

    def add(self, chunk: int, frames: npt.NDArray[np.float32]) -> None:
        """Add the frames (K, D) of the next chunk."""
        first, weights = self._map.of_chunk(chunk, len(frames))
        if not weights.shape[0]:
            return
        self._close(first)
        needed = first + weights.shape[0] - self._first_open
        if needed > len(self._open):
            self._open = np.concatenate(
                [self._open, np.zeros((needed - len(self._open), self._open.shape[1]), np.float32)]
            )
        begin = first - self._first_open
        self._open[begin : begin + weights.shape[0]] += weights @ frames

    def _close(self, first: int) -> None:
        """Finish rows before `first`: later chunks do not contribute to them."""
        n = first - self._first_open
        if n > 0:
            self._done.append(self._finish(self._open[:n]))
            self._open, self._first_open = self._open[n:], first

    def result(self) -> npt.NDArray[Any]:
        """Return (T, D)."""
        self._close(self._map.n_rows)
        return np.concatenate(self._done)


def method_of(method: str, timing: Timing, grid: FrameGrid, *, codes: bool) -> _Method:
    """Return the method for a value of the key `resample`."""
    if method != "auto":
        return method  # type: ignore[return-value]  # one of _Method: the recipe's type
    if codes:
        return "nearest"
    return "area" if timing.rate > Fraction(grid.rate) else "linear"
