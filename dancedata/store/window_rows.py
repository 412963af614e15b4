"""WindowRows: the rows of one field for every window of a list, from mapped files.

Where each window begins is worked out once for all of them, so that a window costs two lookups and a copy.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.store.schema import Field, RowRate
from dancedata.store.shard_reader import ShardReader
from dancedata.store.window_list import IntArray, WindowList

#: Where a clip is: its shard, and its row in /clips there.
ClipPlace = tuple[ShardReader, int]


class WindowRows:
    """Rows of a field for the windows of a list; any number of threads may read. Made by `Store.window_rows`.

    Attributes
    ----------
    shape, dtype
        (rows, D) of each window, and its type.
    unmapped
        Why shards are read by position instead of from memory, "" if all are mapped.
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
        self._refuse_outside([layout.n_rows for layout in layouts])
        self.shape = n_rows, layouts[0].width
        self.dtype = layouts[0].dtype.newbyteorder("=")
        found = [reader.mapped_rows(field) if mapped else "mapped=False" for reader in shards]
        self._maps = [None if isinstance(rows, str) else rows for rows in found]
        self.unmapped = "; ".join(dict.fromkeys(reason for reason in found if isinstance(reason, str)))
        # What fits into memory is read from the disk once; what does not, again and again.
        n_bytes = sum(layout.n_rows * layout.row_bytes for layout in layouts)
        self._fits = n_bytes < os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
        self._seen = np.zeros(len(shard), dtype=np.bool_)

    def _refuse_outside(self, shard_rows: Sequence[int]) -> None:
        """Raise StoreError if a table says that a window lies where its shard has no rows."""
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

    def view(self, place: int) -> npt.NDArray[Any] | None:
        """Return a window's rows in the mapped file, which cannot be written to; None where nothing is mapped."""
        rows = self._maps[self._shard[place]]
        if rows is None:
            return None
        first = self._first[place]
        found: npt.NDArray[Any] = rows[first : first + self._n_rows]
        return found

    def read_into(self, place: int, out: npt.NDArray[Any]) -> None:
        """Copy a window's rows into `out`, (rows, D), converting to its dtype."""
        rows = self.view(place)
        if rows is None:
            self._shards[self._shard[place]].read_rows(self._field, int(self._first[place]), out)
        else:
            np.copyto(out, rows, casting="same_kind")

    def read_ahead(self, places: Sequence[int]) -> None:
        """Have the disk fetch windows that will be read next, all at once instead of page by page.

        Windows that this process has seen before are left out if the field fits into memory twice.
        """
        for place in places:
            number = self._shard[place]
            if self._maps[number] is None or (self._fits and self._seen[place]):
                continue
            self._seen[place] = True
            self._shards[number].read_ahead(self._field, int(self._first[place]), self._n_rows)


def locate_windows(
    windows: WindowList, places: Sequence[ClipPlace], f: Field, rate: RowRate, scope: str
) -> tuple[tuple[ShardReader, ...], IntArray, IntArray, npt.NDArray[np.bool_]]:
    """Find shard and first row of many windows, as `dancedata.store.locate` does for one.

    Parameters
    ----------
    windows
        All of one length.
    places
        Where each of ``windows.clip_ids`` is; those without windows are not looked at.
    f, rate
        The field, and its rows a frame.

    Returns
    -------
    shards
        Those that hold a window.
    shard, first
        (W,) number in `shards` and first row of each window.
    bad
        (W,) windows that the store does not have; their first row means nothing.
    """
    if len(windows) and (windows.length != windows.length[0]).any():
        lengths = sorted({int(n) for n in windows.length})
        raise StoreError(
            "windows of one split have several lengths",
            where=str(places[int(windows.clip[0])][0].path.parent),
            found=lengths,
            fix="run dancedata check on the dataset",
        )
    used = np.unique(windows.clip).tolist()
    shards = tuple(dict.fromkeys(places[k][0] for k in used))
    numbers = {id(shard): number for number, shard in enumerate(shards)}
    shard_of, row_of = np.zeros((2, len(places)), dtype=np.int64)
    for k in used:
        shard_of[k], row_of[k] = numbers[id(places[k][0])], places[k][1]
    shard, row = shard_of[windows.clip], row_of[windows.clip]
    first, bad = np.zeros(len(windows), dtype=np.int64), np.zeros(len(windows), dtype=np.bool_)
    find: Callable[..., tuple[IntArray, npt.NDArray[np.bool_]]] = _stored if scope == "window" else _views
    for number, reader in enumerate(shards):
        mine = np.flatnonzero(shard == number)
        first[mine], bad[mine] = find(reader, row[mine], windows.start[mine], windows.length[mine], f, rate)
    return shards, shard, first, bad


def _views(
    reader: ShardReader, row: IntArray, start: IntArray, length: IntArray, f: Field, rate: RowRate
) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """Find windows of clips that are stored whole."""
    table = reader.clips
    n_frames = np.array([record.n_frames for record in table.records], dtype=np.int64)
    begin, n_rows = start * rate.num // rate.den, length * rate.num // rate.den
    bad = (start < 0) | (length < 1) | (start + length > n_frames[row])
    bad |= (start * rate.num % rate.den != 0) | (length * rate.num % rate.den != 0)
    bad |= begin + n_rows > table.available[f.name][row]
    return table.first[f.name][row] + begin, bad


def _stored(
    reader: ShardReader, row: IntArray, start: IntArray, length: IntArray, f: Field, rate: RowRate
) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """Find windows that have rows of their own."""
    table = reader.windows
    if not len(table.clip):
        return np.zeros_like(start), np.ones(len(start), dtype=np.bool_)
    # (clip, start) as one ascending number, so that one search finds all.
    step = int(table.start.max(initial=0)) + 1
    known = (table.clip * step + table.start)[table.by_start]
    wanted = row * step + start
    place = table.by_start[np.searchsorted(known, wanted).clip(max=len(known) - 1)]
    bad = (start < 0) | (start >= step) | (table.clip[place] != row) | (table.start[place] != start)
    return table.rows[f.name][place], bad | (table.length[place] != length)
