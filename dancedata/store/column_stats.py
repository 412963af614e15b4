"""Statistics of one column: independent of the order of its rows, and numpy's to the last bit, in little memory."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.system import map_now
from dancedata.store import hdf5

Counts = npt.NDArray[np.int32]

#: Bytes of a shard that are mapped at a time: mapped pages count as memory of the process.
_MAPPED_BYTES = 1 << 24
#: Rows whose columns are gathered at a time: the parts of them that are read fit into a core's cache.
_GATHERED_ROWS = 1 << 12


@dataclass(frozen=True)
class CountedRows:
    """Rows of a field in a shard, and how many times each of them counts.

    Attributes
    ----------
    path, offset
        The shard, and the first byte of the field in it.
    dtype, width
        Of the rows.
    counts
        (R,) one number per row of the field.
    """

    path: Path
    offset: int
    dtype: np.dtype[Any]
    width: int
    counts: Counts

    @classmethod
    def of(cls, path: Path, dataset: str, counts: Counts) -> Self:
        """Find the rows of a dataset in a shard that was written by `write_shard`."""
        with hdf5.open_file(path) as file:
            dataset_values = file[dataset]
            offset = int(dataset_values.id.get_offset() or 0)
            return cls(path, offset, dataset_values.dtype, dataset_values.shape[1], counts)

    @property
    def weights(self) -> Counts:
        """Counts above 0, in the order of the rows; (n,)."""
        return self.counts[self.counts > 0]

    def read_into(self, columns: slice, out: npt.NDArray[np.float32]) -> None:
        """Read some columns of all rows that count, each once, into `out`, (columns, n), in the order of the rows."""
        # From mapped pieces of the file: each of many passes then reads the bytes of its few columns, not whole rows.
        filled = 0
        step = max(1, _MAPPED_BYTES // self._row_bytes)
        with open(self.path, "rb") as file:
            for begin in range(0, len(self.counts), step):
                counted = self.counts[begin : begin + step] > 0
                total = int(counted.sum())
                if total:
                    rows = self._mapped(file.fileno(), begin, len(counted))[:, columns]
                    _gather(rows, counted, out[:, filled : filled + total])
                    filled += total
        # Turns -0.0 into 0.0: the two are equal, so a sort may put either one first.
        out += np.float32(0)

    def rows(self) -> Iterator[tuple[npt.NDArray[Any], Counts]]:
        """Yield the rows that count, some at a time, with their counts."""
        step = max(1, _MAPPED_BYTES // self._row_bytes)
        with open(self.path, "rb") as file:
            for begin in range(0, len(self.counts), step):
                counts = self.counts[begin : begin + step]
                rows = self._mapped(file.fileno(), begin, len(counts))
                yield rows[counts > 0], counts[counts > 0]

    @property
    def _row_bytes(self) -> int:
        return self.width * self.dtype.itemsize

    def _mapped(self, descriptor: int, first: int, n_rows: int) -> npt.NDArray[Any]:
        """Return a view of rows of the file, (n_rows, width); it is unmapped with its last reference."""
        begin = self.offset + first * self._row_bytes
        page = begin - begin % mmap.ALLOCATIONGRANULARITY
        end = begin + n_rows * self._row_bytes
        memory = map_now(descriptor, end - page, page)
        rows = np.frombuffer(memory, self.dtype, n_rows * self.width, begin - page)
        return rows.reshape(n_rows, self.width)


def _gather(rows: npt.NDArray[Any], counted: npt.NDArray[np.bool_], out: npt.NDArray[np.float32]) -> None:
    """Copy those rows (R, columns) that count into `out`, (columns, n)."""
    filled = 0
    for begin in range(0, len(rows), _GATHERED_ROWS):
        part = rows[begin : begin + _GATHERED_ROWS]
        counted_part = counted[begin : begin + _GATHERED_ROWS]
        if not counted_part.all():
            part = part[counted_part]
        out[:, filled : filled + len(part)] = part.T
        filled += len(part)


QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
#: Most values that are summed at a time, that are repeated at a time, and that are in memory after that.
_PIECE, _REPEATED, _PART = 1 << 15, 1 << 16, 1 << 22
#: The bits of a float64 that no float32 uses.
_WEIGHT = (1 << 29) - 1

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Weights = npt.NDArray[np.integer[Any]]


@dataclass(frozen=True)
class ColumnStats:
    """Numbers of a column: `std` with ddof 0, `quantiles` at QUANTILES with linear interpolation."""

    mean: float
    std: float
    min: float
    max: float
    quantiles: tuple[float, ...]


class Workspace:
    """Memory for one column after another: the system clears new memory, which takes as long as the sums.

    Parameters
    ----------
    weights
        (n,) how many times each value of a column counts, from 1 to 2^29 - 1; None: once.
    """

    def __init__(self, weights: Weights | None = None) -> None:
        n = 0 if weights is None else len(weights)
        self.weights = weights
        self.values = np.empty(n, np.float64)
        self.ends = np.empty(n, np.int64)
        self.part = np.empty(min(_PART, 0 if weights is None else int(weights.sum())), np.float32)
        self.piece = np.empty(_PIECE, np.float64)


def column_stats(column: Float32Array, space: Workspace) -> ColumnStats:
    """Return the statistics of a column (n,), n > 0, without NaN and -0.0, which is sorted in place."""
    values = _Sorted.of(column, space)
    n = len(values)
    low, high = values.at(0), values.at(n - 1)
    # Of a column of one part, the second sum takes what was repeated for the first.
    part = lru_cache(maxsize=1)(values.part)
    mean = low if low == high else _sum(n, part, space.piece, lambda piece: piece) / n

    def squares(piece: Float64Array) -> Float64Array:
        np.subtract(piece, mean, out=piece)
        return np.multiply(piece, piece, out=piece)

    std = float(np.sqrt(_sum(n, part, space.piece, squares) / n))
    return ColumnStats(mean, std, low, high, tuple(_quantile(values, q) for q in QUANTILES))


@dataclass(frozen=True)
class _Sorted:
    """Values in order, each of which may count several times, given out by parts.

    Attributes
    ----------
    ends
        (n,) places after the last occurrence of each value; None if each counts once.
    """

    values: Float32Array
    ends: npt.NDArray[np.int64] | None
    space: Workspace

    @classmethod
    def of(cls, column: Float32Array, space: Workspace) -> Self:
        """Sort a column."""
        # Each value as a float64, with its weight in the last 29 bits, which a float32 leaves free.
        if space.weights is None:
            column.sort()
            return cls(column, None, space)
        bits, ends = space.values.view(np.int64), space.ends
        space.values[...] = column
        bits |= space.weights
        space.values.sort()
        np.bitwise_and(bits, _WEIGHT, out=ends)
        np.cumsum(ends, out=ends)
        bits &= ~_WEIGHT
        column[...] = space.values
        return cls(column, ends, space)

    def __len__(self) -> int:
        return len(self.values) if self.ends is None else int(self.ends[-1])

    def at(self, place: int) -> float:
        return float(self.values[place if self.ends is None else np.searchsorted(self.ends, place, "right")])

    def part(self, begin: int, end: int) -> Float32Array:
        """Return the values from one place to another; repeated ones in the space's memory, until the next call."""
        if self.ends is None:
            return self.values[begin:end]
        first, last = np.searchsorted(self.ends, (begin, end - 1), "right").tolist()
        part = self.space.part[: end - begin]
        filled = 0
        for count in range(first, last + 1, _REPEATED):
            ends = np.minimum(self.ends[count : min(count + _REPEATED, last + 1)], end)
            times = np.diff(ends, prepend=begin + filled)
            repeated = np.repeat(self.values[count : count + len(ends)], times)
            part[filled : filled + len(repeated)] = repeated
            filled += len(repeated)
        return part


def _sum(
    n: int,
    part: Callable[[int, int], Float32Array],
    buffer: Float64Array,
    terms: Callable[[Float64Array], Float64Array],
) -> float:
    """Sum the terms of n values, which are given out by parts; `terms` may change the piece that it is given."""

    def of_part(begin: int, end: int) -> float:
        values = part(begin, end)

        def of_piece(begin: int, end: int) -> float:
            piece = buffer[: end - begin]
            piece[...] = values[begin:end]
            return float(np.add.reduce(terms(piece)))

        return _pairwise(0, len(values), len(buffer), of_piece)

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
