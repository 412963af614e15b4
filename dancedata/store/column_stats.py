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
    else:
        column = _sorted_with(column, weights)
    n = len(column)
    low, high = float(column[0]), float(column[-1])
    piece = np.empty(min(n, _PIECE))

    def total(change: Callable[[Float64Array], None]) -> float:
        def of_piece(begin: int, end: int) -> float:
            values = piece[: end - begin]
            values[...] = column[begin:end]
            change(values)
            return float(np.add.reduce(values))

        return _pairwise(0, n, of_piece)

    mean = low if low == high else total(lambda values: None) / n

    def square(values: Float64Array) -> None:
        np.subtract(values, mean, out=values)
        np.multiply(values, values, out=values)

    std = float(np.sqrt(total(square) / n))
    return ColumnStats(mean, std, low, high, tuple(_quantile(column, q) for q in QUANTILES))


def _sorted_with(column: npt.NDArray[np.float32], weights: npt.NDArray[np.integer[Any]]) -> npt.NDArray[np.float32]:
    """Return the values in order, each as often as it counts.

    A float32 leaves the last 29 bits of a float64 free. A value is sorted with its weight there, which changes only
    the order of equal values.
    """
    values = column.astype(np.float64)
    bits = values.view(np.int64)
    bits |= weights
    values.sort()
    counts = bits & _WEIGHT
    bits &= ~_WEIGHT
    return np.repeat(values.astype(np.float32), counts)


def _pairwise(begin: int, end: int, of_piece: Callable[[int, int], float]) -> float:
    """Sum as `numpy.sum` does, which halves an array at a multiple of 8 until a piece is left."""
    n = end - begin
    if n <= _PIECE:
        return of_piece(begin, end)
    half = n // 2
    middle = begin + half - half % 8
    return _pairwise(begin, middle, of_piece) + _pairwise(middle, end, of_piece)


def _quantile(column: npt.NDArray[np.float32], q: float) -> float:
    position = q * (len(column) - 1)
    below = int(position)
    above = min(below + 1, len(column) - 1)
    low, high = float(column[below]), float(column[above])
    return low + (high - low) * (position - below)
