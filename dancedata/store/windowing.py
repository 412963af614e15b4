"""Windows of a split: the stored ones, or others of another length and stride."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.windows import window_starts
from dancedata.store.dataset_json import Description
from dancedata.store.schema import RowRate
from dancedata.store.shard_reader import ShardReader
from dancedata.store.window_list import IntArray, WindowList
from dancedata.store.window_order import window_order

Seconds = float | str | Fraction


@dataclass(frozen=True)
class Cut:
    """Length and stride of windows, in frames."""

    length: int
    stride: int


def wanted_cut(
    description: Description,
    length_s: Seconds | None,
    length_frames: int | None,
    stride_s: Seconds | None,
    stride_frames: int | None,
) -> Cut | None:
    """Find the length and stride that were asked for, or None if they are the stored ones."""
    length = _frames(description, "length", length_s, length_frames, description.length)
    stride = _frames(description, "stride", stride_s, stride_frames, description.stride)
    if (length, stride) == (description.length, description.stride):
        return None
    return Cut(length, stride)


def _frames(description: Description, what: str, seconds: Seconds | None, frames: int | None, stored: int) -> int:
    if seconds is not None and frames is not None:
        raise UsageError(f"both {what}_s and {what}_frames are given", fix="give one of them")
    if seconds is not None:
        frames = FrameGrid(description.fps).frames(seconds, what=f"{what}_s")
    if frames is None:
        return stored
    if frames < 1 or frames != int(frames):
        raise UsageError(f"a window's {what} is no positive number of frames", found=frames)
    return int(frames)


def stored_windows(split: str, shards: Sequence[ShardReader]) -> WindowList:
    """List the windows of a split as stored, shard by shard."""
    parts = [(s.windows.clip, s.windows.start, s.windows.length, s.windows.index) for s in shards]
    return _join(split, shards, parts)


def cut_windows(
    split: str,
    shards: Sequence[ShardReader],
    description: Description,
    cut: Cut,
    rates: Mapping[str, RowRate],
    trim: bool = False,
) -> WindowList:
    """Cut other windows of a split; they end where the clip ends, or the first of the fields in `rates`.

    With `trim` they begin at the clip's trim_start.
    """
    for name, rate in rates.items():
        for what, frames in (("length", cut.length), ("stride", cut.stride)):
            if not rate.is_whole(frames):
                raise UsageError(
                    f"a window's {what} is no whole number of rows of field {name}",
                    found=f"{frames} frames",
                    allowed=f"multiples of {rate.den} frames",
                    fix="choose another, or leave the field out of fields=",
                )
    parts = []
    for shard in shards:
        table = shard.clips
        starts: list[IntArray] = []
        for number, record in enumerate(table.records):
            usable = [rate.frames(int(table.available[name][number])) for name, rate in rates.items()]
            begin = _first_whole(record.trim_start, rates) if trim else 0
            frames = min([record.n_frames, *usable]) - begin
            starts.append(begin + window_starts(max(0, frames), cut.length, cut.stride))
        counts = [len(s) for s in starts]
        clip = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
        index = np.concatenate([*(np.arange(n, dtype=np.int64) for n in counts), np.empty(0, np.int64)])
        start = np.concatenate([*starts, np.empty(0, np.int64)])
        order = window_order([r.id for r in table.records], clip, index, description.order)
        parts.append((clip[order], start[order], np.full(len(clip), cut.length, np.int64), index[order]))
    return _join(split, shards, parts)


def _first_whole(frame: int, rates: Mapping[str, RowRate]) -> int:
    """Return the first frame from `frame` on that is a whole row of every field."""
    while not all(rate.is_whole(frame) for rate in rates.values()):
        frame += 1
    return frame


def _join(
    split: str,
    shards: Sequence[ShardReader],
    parts: Sequence[tuple[IntArray, IntArray, IntArray, IntArray]],
) -> WindowList:
    sizes = [len(s.clips.records) for s in shards]
    before = np.cumsum([0, *sizes])[:-1]
    clip = np.concatenate([p[0] + b for p, b in zip(parts, before, strict=True)])
    start, length, index = (np.concatenate([p[i] for p in parts]) for i in (1, 2, 3))
    ids = tuple(r.id for s in shards for r in s.clips.records)
    return WindowList(split, ids, clip.astype(np.int64), start, length, index)
