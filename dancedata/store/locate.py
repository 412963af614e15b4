"""Where the rows of a window lie."""

from __future__ import annotations

from dataclasses import dataclass

from dancedata.core.clip import Window
from dancedata.core.errors import StoreError, UsageError
from dancedata.store.schema import Field, RowRate
from dancedata.store.shard_reader import ShardReader


@dataclass(frozen=True)
class RowSpan:
    """Rows [first, first + length) of a field in a shard, for readers that map the file themselves."""

    shard: ShardReader
    first: int
    length: int


def locate_view(shard: ShardReader, number: int, window: Window, f: Field, rate: RowRate) -> RowSpan:
    """Find a window's rows in track scope, where any window within its clip will do.

    Parameters
    ----------
    shard, number
        Where the clip is: its shard and its row in /clips.
    f, rate
        The field, and its rows a frame.

    Raises
    ------
    UsageError
        For a window that leaves its clip or the field's rows, or is no whole number of rows.
    """
    table = shard.clips
    n_frames = table.records[number].n_frames
    if window.start < 0 or window.length < 1 or window.start + window.length > n_frames:
        raise UsageError(
            "a window leaves its clip",
            where=f"clip {window.clip}",
            found=f"frames {window.start} to {window.start + window.length}",
            allowed=f"0 to {n_frames}",
        )
    if not (rate.is_whole(window.start) and rate.is_whole(window.length)):
        raise UsageError(
            f"a window is no whole number of rows of field {f.name}",
            where=f"clip {window.clip}",
            found=f"start {window.start}, length {window.length} frames",
            allowed=f"multiples of {rate.den} frames (rows at {f.rate} a second)",
        )
    first, length = rate.rows(window.start), rate.rows(window.length)
    available = int(table.available[f.name][number])
    if first + length > available:
        raise UsageError(
            f"a window ends after the last row of field {f.name}",
            where=f"clip {window.clip}",
            found=f"row {first + length}",
            allowed=f"up to {available}",
        )
    return RowSpan(shard, int(table.first[f.name][number]) + first, length)


def locate_stored(shard: ShardReader, number: int, window: Window, f: Field, rate: RowRate) -> RowSpan:
    """Find a window's rows in window scope, where each stored window has rows of its own.

    Raises
    ------
    StoreError
        For a window that is not stored.
    """
    windows = shard.windows
    position = windows.find(number, window.start)
    if position is None or window.length != windows.length[position]:
        starts = windows.starts_of(number)
        raise StoreError(
            "a store of window scope has no such window",
            where=f"clip {window.clip}",
            found=f"start {window.start}, length {window.length}",
            allowed=f"the {len(starts)} stored ones" + (f", starts {starts[0]} to {starts[-1]}" if starts else ""),
            fix="take windows from windows(split), or build with scope: track",
        )
    return RowSpan(shard, int(windows.rows[f.name][position]), rate.rows(window.length))
