"""WindowRows: the rows of one field for every window of a list, from mapped files.

The first row of each window is computed once for all of them, so that a window takes two lookups and a copy.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.store.shard_reader import ShardReader
from dancedata.store.window_list import IntArray


class WindowRows:
    """Rows of a field for the windows of a list; any number of threads may read. Made by `Store.window_rows`.

    Attributes
    ----------
    shape, dtype
        (rows, D) of each window, and its type.
    unmapped
        Why shards are read by position instead of from mapped files; "" if all are mapped.
    """

    def __init__(
        self, field: str, shards: Sequence[ShardReader], shard: IntArray, first: IntArray, n_rows: int, mapped: bool
    ) -> None:
        """Map the shards.

        Parameters
        ----------
        shard, first
            (W,) number of each window's shard in `shards`, and its first row there.
        mapped
            False: read by position.

        Raises
        ------
        StoreError
            If a window's rows lie outside its shard.
        """
        self._field, self._shards = field, shards
        self._shard, self._first, self._n_rows = shard, first, n_rows
        layouts = [reader.layout(field) for reader in shards]
        self._check_bounds([layout.n_rows for layout in layouts])
        self.shape = n_rows, layouts[0].width
        self.dtype = layouts[0].dtype.newbyteorder("=")
        found = [reader.mapped_rows(field) if mapped else "mapped=False" for reader in shards]
        self._maps = [None if isinstance(rows, str) else rows for rows in found]
        self.unmapped = "; ".join(dict.fromkeys(reason for reason in found if isinstance(reason, str)))
        # A field that fits into memory is read from the disk once, a larger one again and again.
        n_bytes = sum(layout.n_rows * layout.row_bytes for layout in layouts)
        self._fits = n_bytes < os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
        self._seen = np.zeros(len(shard), dtype=np.bool_)

    def _check_bounds(self, shard_rows: Sequence[int]) -> None:
        """Raise StoreError if a window lies outside the rows of its shard."""
        n_rows = np.array(shard_rows, dtype=np.int64)[self._shard]
        bad = np.flatnonzero((self._first < 0) | (self._first > n_rows - self._n_rows))
        if len(bad):
            first, place = int(self._first[bad[0]]), int(bad[0])
            raise StoreError(
                "rows lie outside the shard",
                where=f"{self._shards[self._shard[place]].path}, field {self._field}",
                found=f"rows {first} to {first + self._n_rows} of {n_rows[place]}",
                fix="run dancedata check on the dataset",
            )

    def view(self, place: int, shift: int = 0) -> npt.NDArray[Any] | None:
        """Return a window's rows in the mapped file, read-only; None if the shard is not mapped.

        `shift` moves the window by so many rows; the caller sees to it that the clip has them.
        """
        rows = self._maps[self._shard[place]]
        if rows is None:
            return None
        first = self._first[place] + shift
        found: npt.NDArray[Any] = rows[first : first + self._n_rows]
        return found

    def read_into(self, place: int, out: npt.NDArray[Any], shift: int = 0) -> None:
        """Copy a window's rows, moved by `shift` rows, into `out`, (rows, D), converting to its dtype."""
        rows = self.view(place, shift)
        if rows is None:
            self._shards[self._shard[place]].read_rows(self._field, int(self._first[place]) + shift, out)
        else:
            np.copyto(out, rows, casting="same_kind")

    def read_ahead(self, places: Sequence[int]) -> None:
        """Ask the system to read windows from the disk that will be used next, all at once instead of page by page.

        Windows that this process has read before are skipped if the field fits into memory twice.
        """
        for place in places:
            number = self._shard[place]
            if self._maps[number] is None or (self._fits and self._seen[place]):
                continue
            self._seen[place] = True
            self._shards[number].read_ahead(self._field, int(self._first[place]), self._n_rows)
