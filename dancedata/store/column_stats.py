"""Statistics of the values of one column, in little memory beside the column.

Values are sorted first, so that every number is independent of the order in which rows were stored. Sums are numpy's
to the last bit, but computed by pieces that fit into a core's cache.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
#: Most values of a piece.
_PIECE = 1 << 15
#: The bits of a float64 that no float32 uses.
_WEIGHT = (1 << 29) - 1

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ColumnStats:
    """Numbers of a column: `std` with ddof 0, `quantiles` at QUANTILES with linear interpolation."""

    mean: float
    std: float
    min: float
    max: float
    quantiles: tuple[float, ...]


def column_stats(column: npt.NDArray[np.float32], weights: npt.NDArray[np.integer[Any]] | None = None) -> ColumnStats:
    """Return the statistics of a column.

    Parameters
    ----------
    column
        (n,) values, n > 0, without NaN and -0.0; sorted in place.
    weights
        (n,) how many times each value counts, from 1 to 2^29 - 1; None: once.
    """
    if weights is None:
        column.sort()
        values: _Sorted = _Sorted(column)
    else:
        values = _Weighted.of(column, weights)
    n = len(values)
    low, high = values.at(0), values.at(n - 1)
    mean = low if low == high else _pairwise(0, n, lambda *piece: float(np.add.reduce(values.piece(*piece)))) / n

    def squares(begin: int, end: int) -> float:
        piece = values.piece(begin, end)
        np.subtract(piece, mean, out=piece)
        np.multiply(piece, piece, out=piece)
        return float(np.add.reduce(piece))

    std = float(np.sqrt(_pairwise(0, n, squares) / n))
    return ColumnStats(mean, std, low, high, tuple(_quantile(values, q) for q in QUANTILES))


@dataclass(frozen=True)
class _Sorted:
    """Values in order, given out by pieces."""

    values: npt.NDArray[np.floating[Any]]

    def __len__(self) -> int:
        return len(self.values)

    def at(self, place: int) -> float:
        return float(self.values[place])

    def piece(self, begin: int, end: int) -> Float64Array:
        return self.values[begin:end].astype(np.float64)


@dataclass(frozen=True)
class _Weighted(_Sorted):
    """Values in order, each of which counts several times; `ends` are the places behind the last time."""

    ends: npt.NDArray[np.int64]

    @classmethod
    def of(cls, column: npt.NDArray[np.float32], weights: npt.NDArray[np.integer[Any]]) -> _Weighted:
        """Sort.

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
        return cls(values, ends)

    def __len__(self) -> int:
        return int(self.ends[-1])

    def at(self, place: int) -> float:
        return float(self.values[np.searchsorted(self.ends, place, "right")])

    def piece(self, begin: int, end: int) -> Float64Array:
        first, last = np.searchsorted(self.ends, (begin, end - 1), "right").tolist()
        ends = np.minimum(self.ends[first : last + 1], end)
        return np.repeat(self.values[first : last + 1], np.diff(ends, prepend=begin))


def _pairwise(begin: int, end: int, of_piece: Callable[[int, int], float]) -> float:
    """Sum as `numpy.sum` does, which halves an array at a multiple of 8 until a piece is left."""
    n = end - begin
    if n <= _PIECE:
        return of_piece(begin, end)
    half = n // 2
    middle = begin + half - half % 8
    return _pairwise(begin, middle, of_piece) + _pairwise(middle, end, of_piece)


def _quantile(values: _Sorted, q: float) -> float:
    position = q * (len(values) - 1)
    below = int(position)
    low, high = values.at(below), values.at(min(below + 1, len(values) - 1))
    return low + (high - low) * (position - below)
