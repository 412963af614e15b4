"""CountedRows: some columns of those rows of a field in a shard that count."""

from __future__ import annotations

import mmap
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dancedata.store import hdf5

Counts = npt.NDArray[np.int32]

#: Bytes of a shard that are mapped at a time. What is mapped counts as memory of the process.
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
            found = file[dataset]
            offset = int(found.id.get_offset() or 0)
            return cls(path, offset, found.dtype, found.shape[1], counts)

    @property
    def weights(self) -> Counts:
        """How many times each row counts that counts at all; (n,)."""
        return self.counts[self.counts > 0]

    def read_into(self, columns: slice, out: npt.NDArray[np.float32]) -> None:
        """Read some columns of all rows that count, each once, into `out`, (columns, n), in the order of the rows.

        Reads from mapped pieces of the file, so that each of many passes, for a few columns each, reads the bytes of
        its columns instead of whole rows.
        """
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

    @property
    def _row_bytes(self) -> int:
        return self.width * self.dtype.itemsize

    def _mapped(self, descriptor: int, first: int, n_rows: int) -> npt.NDArray[Any]:
        """Return a view of rows of the file, (n_rows, width); it is unmapped with its last reference."""
        begin = self.offset + first * self._row_bytes
        page = begin - begin % mmap.ALLOCATIONGRANULARITY
        end = begin + n_rows * self._row_bytes
        flags = mmap.MAP_PRIVATE | mmap.MAP_POPULATE
        memory = mmap.mmap(descriptor, end - page, flags=flags, prot=mmap.PROT_READ, offset=page)
        rows = np.frombuffer(memory, self.dtype, n_rows * self.width, begin - page)
        return rows.reshape(n_rows, self.width)


def _gather(rows: npt.NDArray[Any], counted: npt.NDArray[np.bool_], out: npt.NDArray[np.float32]) -> None:
    """Copy those rows (R, columns) that count into `out`, (columns, n)."""
    filled = 0
    for begin in range(0, len(rows), _GATHERED_ROWS):
        some = rows[begin : begin + _GATHERED_ROWS]
        chosen = counted[begin : begin + _GATHERED_ROWS]
        if not chosen.all():
            some = some[chosen]
        out[:, filled : filled + len(some)] = some.T
        filled += len(some)
