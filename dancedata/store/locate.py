"""Finds the rows of windows: of one window, and of many at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.store.schema import Field
from dancedata.store.shard_reader import ShardReader
from dancedata.store.window_list import IntArray, WindowList

#: A clip's shard, and its row in /clips there.
ClipPlace = tuple[ShardReader, int]


@dataclass(frozen=True)
class RowSpan:
    """Rows [first, first + length) of a field in a shard, for readers that map the file themselves."""

    shard: ShardReader
    first: int
    length: int


def locate_view(shard: ShardReader, number: int, window: Window, f: Field, grid: FrameGrid) -> RowSpan:
    """Find a window's rows in track scope, where any window within its clip is allowed.

    `number` is the clip's row in /clips of the shard, `grid` that of the store's frames. UsageError for a window that
    extends beyond its clip or the field's rows, or is not a whole number of rows.
    """
    table = shard.clips
    n_frames = table.records[number].n_frames
    if window.start < 0 or window.length < 1 or window.start + window.length > n_frames:
        raise UsageError(
            "a window extends beyond its clip",
            where=f"clip {window.clip}",
            found=f"frames {window.start} to {window.start + window.length}",
            allowed=f"0 to {n_frames}",
        )
    if not (grid.is_whole(window.start, of=f.grid) and grid.is_whole(window.length, of=f.grid)):
        raise UsageError(
            f"a window is not a whole number of rows of field {f.name}",
            where=f"clip {window.clip}",
            found=f"start {window.start}, length {window.length} frames",
            allowed=f"multiples of {grid.common_period(f.grid)[0]} frames (rows at {f.rate} per second)",
        )
    first, length = grid.rows_down(window.start, of=f.grid), grid.rows_down(window.length, of=f.grid)
    available = int(table.available[f.name][number])
    if first + length > available:
        raise UsageError(
            f"a window ends after the last row of field {f.name}",
            where=f"clip {window.clip}",
            found=f"row {first + length}",
            allowed=f"up to {available}",
        )
    return RowSpan(shard, int(table.first[f.name][number]) + first, length)


def locate_stored(shard: ShardReader, number: int, window: Window, f: Field, grid: FrameGrid) -> RowSpan:
    """Find a window's rows in window scope, where each has its own rows; StoreError for one that is not stored."""
    windows = shard.windows
    position = windows.find(number, window.start)
    if position is None or window.length != windows.length[position]:
        starts = windows.start[windows.positions_of(number)].tolist()
        raise StoreError(
            "a store of window scope does not hold this window",
            where=f"clip {window.clip}",
            found=f"start {window.start}, length {window.length}",
            allowed=f"the {len(starts)} stored windows" + (f", starts {starts[0]} to {starts[-1]}" if starts else ""),
            fix="take windows from windows(split), or build with scope: track",
        )
    return RowSpan(shard, int(windows.rows[f.name][position]), grid.rows_down(window.length, of=f.grid))


def locate_windows(
    windows: WindowList, places: Sequence[ClipPlace], f: Field, grid: FrameGrid, scope: str
) -> tuple[tuple[ShardReader, ...], IntArray, IntArray, npt.NDArray[np.bool_]]:
    """Find shard and first row of many windows, as `locate_view` and `locate_stored` do for one.

    Parameters
    ----------
    windows
        All of one length.
    places
        Where each of ``windows.clip_ids`` is; those without windows are not read.

    Returns
    -------
    shards, shard, first, bad
        The shards with one of the windows; (W,) each window's number in `shards`, its first row, and whether the
        store does not have it.
    """
    if len(windows) and (windows.length != windows.length[0]).any():
        lengths = sorted({int(n) for n in windows.length})
        raise StoreError(
            "the windows of a split differ in length",
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
        in_shard = np.flatnonzero(shard == number)
        first[in_shard], bad[in_shard] = find(
            reader, row[in_shard], windows.start[in_shard], windows.length[in_shard], f, grid
        )
    return shards, shard, first, bad


def _views(
    reader: ShardReader, row: IntArray, start: IntArray, length: IntArray, f: Field, grid: FrameGrid
) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """Find windows of clips that are stored whole."""
    table = reader.clips
    n_frames = np.array([record.n_frames for record in table.records], dtype=np.int64)
    begin, begins_whole = grid.rows_of_all(start, of=f.grid)
    n_rows, is_whole = grid.rows_of_all(length, of=f.grid)
    bad = (start < 0) | (length < 1) | (start + length > n_frames[row])
    bad |= ~begins_whole | ~is_whole
    bad |= begin + n_rows > table.available[f.name][row]
    return table.first[f.name][row] + begin, bad


def _stored(
    reader: ShardReader, row: IntArray, start: IntArray, length: IntArray, f: Field, grid: FrameGrid
) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """Find windows that have their own rows."""
    table = reader.windows
    if not len(table.clip):
        return np.zeros_like(start), np.ones(len(start), dtype=np.bool_)
    # (clip, start) as one ascending number, so that one search finds all of them.
    step = int(table.start.max(initial=0)) + 1
    stored_starts = (table.clip * step + table.start)[table.by_start]
    searched = row * step + start
    place = table.by_start[np.searchsorted(stored_starts, searched).clip(max=len(stored_starts) - 1)]
    bad = (start < 0) | (start >= step) | (table.clip[place] != row) | (table.start[place] != start)
    return table.rows[f.name][place], bad | (table.length[place] != length)
