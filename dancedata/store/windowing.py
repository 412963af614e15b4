"""Lists the stored windows of a split, and finds the rows of any windows."""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import whole
from dancedata.core.clip import Window
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.store.columns import MAX_ROWS
from dancedata.store.schema import Field
from dancedata.store.tables import Tables
from dancedata.store.window_list import Ints, WindowList

Seconds = float | str | Fraction
#: Windows that are located at a time.
_PART = 1 << 16


def window_frames(grid: FrameGrid, what: str, seconds: Seconds | None, frames: int | None, stored: int) -> int:
    """Return the length or stride of windows in frames, of two ways to state it; by default as stored."""
    if seconds is not None and frames is not None:
        raise UsageError(f"both {what}_s and {what} are given", fix="give one of them")
    if isinstance(seconds, bool):
        raise UsageError(f"{what}_s is not a number of seconds", found=seconds)
    if seconds is not None:
        frames = grid.frames(seconds, what=f"{what}_s")
    return stored if frames is None else whole(f"the {what} of a window", frames, 1, MAX_ROWS)


def stored_windows(tables: Tables, split: str, fields: Sequence[Field]) -> WindowList:
    """Return the windows of a split as stored, of the clips that have all of `fields`."""
    rows = tables.splits[split].windows
    clip, start = tables.window_clip[rows], tables.window_start[rows]
    windows = WindowList.equally_long(split, tables.ids, clip, start, tables.window_length)
    for f in fields:
        if f.optional:
            windows = windows.take(tables.has_rows(f)[windows.clip])
    return windows


def require_field(tables: Tables, row: int, f: Field) -> None:
    """Raise UsageError for a clip that does not have an optional field."""
    if f.optional and not tables.spans[f.name].available[row]:
        raise UsageError(
            f"the clip has no rows of field {f.name}",
            where=f"clip {tables.ids[row]}",
            found="a clip that was kept without it; rejects.jsonl says why",
            fix=f"take clips with {f.name!r} in clip, or windows(split, fields=({f.name!r},))",
        )


def locate_window(tables: Tables, row: int, window: Window, f: Field, grid: FrameGrid) -> tuple[int, int]:
    """Return first row and number of rows of any window within its clip, which is in a row of the table of clips."""
    n_frames = int(tables.n_frames[row])
    if window.start < 0 or window.length < 1 or window.start + window.length > n_frames:
        raise UsageError("a window extends beyond its clip", where=f"clip {window.clip}",
                         found=f"frames {window.start} to {window.start + window.length}",
                         allowed=f"0 to {n_frames}")  # fmt: skip
    frames, rows = grid.common_period(f.grid)
    if window.start % frames or window.length % frames:
        raise UsageError(f"a window is not a whole number of rows of field {f.name}", where=f"clip {window.clip}",
                         found=f"start {window.start}, length {window.length} frames",
                         allowed=f"multiples of {frames} frames (rows at {f.rate} per second)")  # fmt: skip
    require_field(tables, row, f)
    first, length = int(window.start) // frames * rows, int(window.length) // frames * rows
    spans = tables.spans[f.name]
    available, lead = int(spans.available[row]), spans.delay(row)
    if first + length > available:
        raise UsageError(f"a window ends after the last row of field {f.name}", where=f"clip {window.clip}",
                         found=f"row {first + length}", allowed=f"up to {available}")  # fmt: skip
    if first < lead:
        raise UsageError(f"a window begins before the first row of field {f.name}", where=f"clip {window.clip}",
                         found=f"row {first}",
                         allowed=f"from {lead} on: the music begins after the clip")  # fmt: skip
    return int(spans.first[row]) + first, length


def locate_windows(
    tables: Tables, row: Ints, windows: WindowList, f: Field, grid: FrameGrid
) -> tuple[Ints, npt.NDArray[np.bool_]]:
    """Return the first row of each window in its clip's shard, (W,), and whether the store does not have it."""
    length, spans, n_frames = int(windows.length[0]), tables.spans[f.name], tables.n_frames
    is_small = (spans.first + spans.available).max(initial=0) < 2**31  # half the memory of a million clips
    first: Ints = np.empty(len(row), dtype=np.int32) if is_small else np.empty(len(row), dtype=np.int64)
    bad = np.empty(len(row), dtype=np.bool_)
    is_part, n_rows = length < 1 or not grid.is_whole(length, of=f.grid), grid.rows_down(length, of=f.grid)
    # A part at a time: arrays of millions of windows are made slower than they are computed.
    for part in (slice(k, k + _PART) for k in range(0, len(row), _PART)):
        clip, start = row[part], windows.start[part].astype(np.int64)
        begin, begins_whole = grid.rows_of_all(start, of=f.grid)
        bad[part] = (start < 0) | (start + length > n_frames[clip]) | ~begins_whole | is_part
        bad[part] |= begin + n_rows > spans.available[clip]
        if spans.leads and spans.offset is not None:
            bad[part] |= begin + spans.offset[clip] < 0
        first[part] = begin + spans.first[clip]
    return first, bad
