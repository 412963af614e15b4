"""Lists the windows of a split: the stored ones, or windows of another length and stride."""

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.grid import WindowGrid
from dancedata.store.dataset_json import Description
from dancedata.store.schema import Field
from dancedata.store.shard_reader import ShardReader
from dancedata.store.shard_tables import ClipTable
from dancedata.store.window_list import IntArray, WindowList, window_order

Seconds = float | str | Fraction


def requested_windows(
    description: Description,
    length_s: Seconds | None,
    length_frames: int | None,
    stride_s: Seconds | None,
    stride_frames: int | None,
) -> WindowGrid:
    """Return the length and stride that a caller asks for; the stored ones by default."""
    length = _frames(description, "length", length_s, length_frames, description.length)
    stride = _frames(description, "stride", stride_s, stride_frames, description.stride)
    return WindowGrid(length, stride)


def _frames(description: Description, what: str, seconds: Seconds | None, frames: int | None, stored: int) -> int:
    if seconds is not None and frames is not None:
        raise UsageError(f"both {what}_s and {what}_frames are given", fix="give one of them")
    if seconds is not None:
        frames = description.grid.frames(seconds, what=f"{what}_s")
    if frames is None:
        return stored
    if frames < 1 or frames != int(frames):
        raise UsageError(f"the {what} of a window is not a positive number of frames", found=frames)
    return int(frames)


def stored_windows(split: str, shards: Sequence[ShardReader]) -> WindowList:
    """Return the windows of a split as stored, shard by shard."""
    parts = [(s.windows.clip, s.windows.start, s.windows.length, s.windows.index) for s in shards]
    return _join(split, shards, parts)


def cut_windows(
    split: str,
    shards: Sequence[ShardReader],
    description: Description,
    windows: WindowGrid,
    fields: Sequence[Field],
    trim: bool = False,
) -> WindowList:
    """Return windows of any length and stride, which end where the clip ends, or the first of `fields`.

    With `trim` they begin at the clip's trim_start, or at the next frame that is a whole row of every field.
    UsageError if length or stride is not a whole number of rows of a field.
    """
    for f in fields:
        for what, frames in (("length", windows.length), ("stride", windows.stride)):
            if not description.grid.is_whole(frames, of=f.grid):
                raise UsageError(
                    f"the {what} of a window is not a whole number of rows of field {f.name}",
                    found=f"{frames} frames",
                    allowed=f"multiples of {description.grid.common_period(f.grid)[0]} frames",
                    fix="choose another, or leave the field out of fields=",
                )
    parts = []
    for shard in shards:
        table = shard.clips
        starts: list[IntArray] = []
        for number in range(len(table.records)):
            begins = window_starts(table, number, description, windows, fields, trim)
            starts.append(np.arange(begins.start, begins.stop, begins.step, dtype=np.int64))
        counts = [len(s) for s in starts]
        clip = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
        index = np.concatenate([*(np.arange(n, dtype=np.int64) for n in counts), np.empty(0, np.int64)])
        start = np.concatenate([*starts, np.empty(0, np.int64)])
        order = window_order([r.id for r in table.records], clip, index, description.order)
        parts.append((clip[order], start[order], np.full(len(clip), windows.length, np.int64), index[order]))
    return _join(split, shards, parts)


def window_starts(
    table: ClipTable, number: int, description: Description, windows: WindowGrid, fields: Sequence[Field], trim: bool
) -> range:
    """Return the first frames of a clip's windows; arguments as for `cut_windows`, `number` is that of the clip."""
    begin, end = _span(table, number, description, fields, trim)
    count = max(windows.count(end - begin), 0)
    return range(begin, begin + count * windows.stride, windows.stride)


def whole_clips(
    split: str, shards: Sequence[ShardReader], description: Description, fields: Sequence[Field], trim: bool = False
) -> WindowList:
    """Return one window per clip: all its frames that are whole rows of every one of `fields`; none without such."""
    period = whole_period(description, fields)
    parts = []
    for shard in shards:
        numbers = range(len(shard.clips.records))
        spans = [_span(shard.clips, number, description, fields, trim) for number in numbers]
        begin, end = np.array(spans, dtype=np.int64).reshape(-1, 2).T
        length = (end - begin) // period * period
        clip = np.flatnonzero(length > 0)
        parts.append((clip, begin[clip], length[clip], np.zeros(len(clip), np.int64)))
    return _join(split, shards, parts)


def _span(
    table: ClipTable, number: int, description: Description, fields: Sequence[Field], trim: bool
) -> tuple[int, int]:
    """Return where a clip begins and ends, in frames: with `trim` after its trim_start, and within all fields."""
    record, period = table.records[number], whole_period(description, fields)
    ends = [f.grid.rows_down(int(table.available[f.name][number]), of=description.grid) for f in fields]
    begin = -(-record.trim_start // period) * period if trim else 0
    return begin, min([record.n_frames, *ends])


def whole_period(description: Description, fields: Sequence[Field]) -> int:
    """Return the least number of frames that is a whole number of rows of every field."""
    return math.lcm(*(description.grid.common_period(f.grid)[0] for f in fields))


def _join(
    split: str, shards: Sequence[ShardReader], parts: Sequence[tuple[IntArray, IntArray, IntArray, IntArray]]
) -> WindowList:
    sizes = [len(s.clips.records) for s in shards]
    before = np.cumsum([0, *sizes])[:-1]
    clip = np.concatenate([p[0] + b for p, b in zip(parts, before, strict=True)])
    start, length, index = (np.concatenate([p[i] for p in parts]) for i in (1, 2, 3))
    ids = tuple(r.id for s in shards for r in s.clips.records)
    return WindowList(split, ids, clip.astype(np.int64), start, length, index)
