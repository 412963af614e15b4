"""Statistics of the values of one column, in little memory beside the column.

Values are sorted first, so that every number is independent of the order in which rows were stored. Sums are numpy's
to the last bit, but computed by pieces that fit into a core's cache.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
#: Most values of a piece, which is summed at a time, and of a part, whose values are repeated at a time.
_PIECE, _PART = 1 << 15, 1 << 22
#: The bits of a float64 that no float32 uses.
_WEIGHT = (1 << 29) - 1

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ColumnStats:
    """Numbers of a column: `std` with ddof 0, `quantiles` at QUANTILES with linear interpolation."""

    mean: float
    std: float
    min: float
    max: float
    quantiles: tuple[float, ...]


def column_stats(column: Float32Array, weights: npt.NDArray[np.integer[Any]] | None = None) -> ColumnStats:
    """Return the statistics of a column.

    Parameters
    ----------
    column
        (n,) values, n > 0, without NaN and -0.0; sorted in place.
    weights
        (n,) how many times each value counts, from 1 to 2^29 - 1; None: once.
    """
    values = _Sorted.of(column) if weights is None else _Weighted.of(column, weights)
    n = len(values)
    low, high = values.at(0), values.at(n - 1)
    # Of a column of one part, the second sum takes what the first one has expanded.
    part = lru_cache(maxsize=1)(values.part)
    mean = low if low == high else _sum(n, part, lambda piece: piece) / n

    def squares(piece: Float64Array) -> Float64Array:
        np.subtract(piece, mean, out=piece)
        return np.multiply(piece, piece, out=piece)

    std = float(np.sqrt(_sum(n, part, squares) / n))
    return ColumnStats(mean, std, low, high, tuple(_quantile(values, q) for q in QUANTILES))


@dataclass(frozen=True)
class _Sorted:
    """Values in order, given out by parts."""

    values: Float32Array

    @classmethod
    def of(cls, column: Float32Array) -> _Sorted:
        """Sort in place."""
        column.sort()
        return cls(column)

    def __len__(self) -> int:
        return len(self.values)

    def at(self, place: int) -> float:
        return float(self.values[place])

    def part(self, begin: int, end: int) -> Float32Array:
        return self.values[begin:end]


@dataclass(frozen=True)
class _Weighted(_Sorted):
    """Values in order, each of which counts several times; `ends` are the places behind the last time."""

    ends: npt.NDArray[np.int64]

    @classmethod
    def of(cls, column: Float32Array, weights: npt.NDArray[np.integer[Any]]) -> _Weighted:
        """Sort into the column.

        A float32 leaves the last 29 bits of a float64 free. A value is sorted with its weight there, which changes
        only the order of equal values.
        """
        values = column.astype(np.float64)
        bits = values.view(np.int64)
        bits |= weights
        values.sort()
        ends = bits & _WEIGHT
        np.cumsum(ends, out=ends)
        bits &= ~_WEIGHT
        column[...] = values
        return cls(column, ends)

    def __len__(self) -> int:
        return int(self.ends[-1])

    def at(self, place: int) -> float:
        return float(self.values[np.searchsorted(self.ends, place, "right")])

    def part(self, begin: int, end: int) -> Float32Array:
        first, last = np.searchsorted(self.ends, (begin, end - 1), "right").tolist()
        times = np.diff(self.ends[first : last + 1], prepend=begin)
        times[-1] += end - self.ends[last]
        return np.repeat(self.values[first : last + 1], times)


def _sum(n: int, part: Callable[[int, int], Float32Array], terms: Callable[[Float64Array], Float64Array]) -> float:
    """Sum the terms of n values, which are given out by parts; `terms` may change the piece that it is given."""
    buffer = np.empty(min(n, _PIECE))

    def of_part(begin: int, end: int) -> float:
        values = part(begin, end)

        def of_piece(begin: int, end: int) -> float:
            piece = buffer[: end - begin]
            piece[...] = values[begin:end]
            return float(np.add.reduce(terms(piece)))

        return _pairwise(0, len(values), _PIECE, of_piece)

    return _pairwise(0, n, _PART, of_part)


def _pairwise(begin: int, end: int, most: int, of_piece: Callable[[int, int], float]) -> float:
    """Sum as `numpy.sum` does, which halves an array at a multiple of 8 until a piece of `most` values is left."""
    n = end - begin
    if n <= most:
        return of_piece(begin, end)
    half = n // 2
    middle = begin + half - half % 8
    return _pairwise(begin, middle, most, of_piece) + _pairwise(middle, end, most, of_piece)


def _quantile(values: _Sorted, q: float) -> float:
    position = q * (len(values) - 1)
    below = int(position)
    low, high = values.at(below), values.at(min(below + 1, len(values) - 1))
    return low + (high - low) * (position - below)
