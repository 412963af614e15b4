"""Windows with a length and stride other than the stored ones, and windows of whole clips."""

import math
from collections.abc import Sequence

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.grid import WindowGrid
from dancedata.store.dataset_json import Description
from dancedata.store.schema import Field
from dancedata.store.tables import Tables
from dancedata.store.window_list import IntArray, WindowList


def list_windows(
    tables: Tables,
    split: str,
    description: Description,
    windows: WindowGrid,
    fields: Sequence[Field],
    trim: bool = False,
) -> WindowList:
    """Return windows of any length and stride within a clip and all of `fields`; `trim`: from its trim_start on."""
    for f in fields:
        for what, frames in (("length", windows.length), ("stride", windows.stride)):
            if not description.grid.is_whole(frames, of=f.grid):
                raise UsageError(f"the {what} of a window is not a whole number of rows of field {f.name}",
                                 found=f"{frames} frames",
                                 allowed=f"multiples of {description.grid.common_period(f.grid)[0]} frames",
                                 fix="choose another, or leave the field out of fields=")  # fmt: skip
    rows = tables.splits[split].clips
    begin, end = _spans(tables, description, fields, trim, rows)
    counts = np.maximum((end - begin - windows.length) // windows.stride + 1, 0)
    clip = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    index = np.arange(len(clip)) - np.repeat(np.cumsum(counts) - counts, counts)
    start = begin[clip] + index * windows.stride
    clip += rows.start
    return WindowList.equally_long(split, tables.ids, clip, start, windows.length)


def window_starts(
    tables: Tables, row: int, description: Description, windows: WindowGrid, fields: Sequence[Field], trim: bool
) -> range:
    """Return the first frames of a clip's windows; arguments as for `list_windows`, `row` is that of the clip."""
    begin, end = (int(frames[0]) for frames in _spans(tables, description, fields, trim, slice(row, row + 1)))
    count = max(windows.count(end - begin), 0)
    return range(begin, begin + count * windows.stride, windows.stride)


def whole_clips(
    tables: Tables, split: str, description: Description, fields: Sequence[Field], trim: bool = False
) -> WindowList:
    """Return one window per clip: all its frames that fill whole rows of every field; clips without any have none."""
    period, rows = whole_period(description, fields), tables.splits[split].clips
    begin, end = _spans(tables, description, fields, trim, rows)
    length = (end - begin) // period * period
    clip = np.flatnonzero(length > 0)
    return WindowList(split, tables.ids, clip + rows.start, begin[clip], length[clip])


def _spans(
    tables: Tables, description: Description, fields: Sequence[Field], trim: bool, rows: slice
) -> tuple[IntArray, IntArray]:
    """Return where some clips begin and end, in frames: with `trim` after their trim_start, and within all fields."""
    grid, period = description.grid, whole_period(description, fields)
    end = tables.n_frames[rows].astype(np.int64)
    begin = np.zeros_like(end)
    if trim and "trim_start" in tables.columns:
        begin = -(-np.asarray(tables.columns["trim_start"][rows], dtype=np.int64) // period) * period
    for f in fields:
        spans = tables.spans[f.name]
        end = np.minimum(end, f.grid.rows_of_all(spans.available[rows], of=grid)[0])
        if spans.leads and spans.offset is not None:
            frames = -f.grid.rows_of_all(np.minimum(spans.offset[rows], 0), of=grid)[0]  # rounded up
            begin = np.maximum(begin, -(-frames // period) * period)
    return begin, end


def whole_period(description: Description, fields: Sequence[Field]) -> int:
    """Return the least number of frames that is a whole number of rows of every field."""
    return math.lcm(*(description.grid.common_period(f.grid)[0] for f in fields))
