"""Assigns clips to shards and rows, before anything is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dancedata.core.clip import check_name
from dancedata.core.errors import StoreError
from dancedata.core.text import listed, shown
from dancedata.store.schema import Field, StoreHeader, shard_name, sort_splits
from dancedata.store.stored_clip import AudioBlock, LazyArray, StoredClip, check_clip
from dancedata.store.window_list import IntArray


@dataclass(frozen=True)
class Span:
    """Rows [start, start + length) of a field in a shard; `offset` is the clip's frame 0, from start, or below it."""

    start: int
    length: int
    offset: int = 0

    @property
    def from_frame_0(self) -> tuple[int, int, int]:
        """Row of the clip's frame 0, rows from there on, and offset: columns of the table of clips."""
        return self.start + self.offset, self.length - self.offset, self.offset


@dataclass
class ShardPlan:
    """One shard to be written: its clips, rows so far by field, spans of clips, and timelines, each stored once."""

    header: StoreHeader
    split: str
    file: str = ""
    clips: list[StoredClip] = field(default_factory=list)
    rows: dict[str, int] = field(default_factory=dict)
    spans: dict[str, list[Span]] = field(default_factory=dict)
    #: First row and array of each timeline, by field and key.
    blocks: dict[str, dict[str, tuple[int, LazyArray]]] = field(default_factory=dict)
    first_bytes: dict[str, int] = field(default_factory=dict)  # by field; `written_shard` fills them in

    def __post_init__(self) -> None:
        for f in self.header.fields:
            self.rows[f.name], self.spans[f.name], self.blocks[f.name] = 0, [], {}

    def bytes_with(self, unit: Sequence[StoredClip] = ()) -> int:
        """Count the bytes of the fields' rows, with the clips of `unit` added."""
        total = 0
        for f in self.header.fields:
            rows = self.rows[f.name]
            if f.per_clip:
                rows += sum(clip.motion[f.name].shape[0] for clip in unit)
            else:
                blocks = self.blocks[f.name]
                shared = {clip.audio[f.name].key: clip.audio[f.name].array.shape[0] for clip in unit}
                rows += sum(n for key, n in shared.items() if key not in blocks)
            total += rows * f.row_bytes
        return total

    def add(self, clip: StoredClip) -> None:
        """Add a clip, and assign its rows."""
        for f in self.header.fields:
            if f.per_clip:
                span = Span(self.rows[f.name], clip.motion[f.name].shape[0])
                self.rows[f.name] += span.length
            else:
                block = clip.audio[f.name]
                span = Span(self._add_block(f.name, block, clip.id), block.array.shape[0], block.offset)
            self.spans[f.name].append(span)
        self.clips.append(clip)

    def _add_block(self, name: str, block: AudioBlock, clip: str) -> int:
        stored_block = self.blocks[name].get(block.key)
        if stored_block is None:
            start = self.rows[name]
            self.blocks[name][block.key] = (start, block.array)
            self.rows[name] += block.array.shape[0]
            return start
        if stored_block[1].shape != block.array.shape:
            raise StoreError("two audio blocks with the same key have different shapes",
                             where=f"clip {clip}, field {name}, key {block.key}",
                             found=f"{stored_block[1].shape} and {block.array.shape}")  # fmt: skip
        return stored_block[0]

    @cached_property
    def windows(self) -> tuple[IntArray, IntArray]:
        """Clip and first frame of every window of the shard, (W,) each, by clip and start; once it is planned."""
        counts = [len(c.starts) for c in self.clips]
        clip = np.repeat(np.arange(len(self.clips), dtype=np.int64), counts)
        return clip, np.array([start for c in self.clips for start in c.starts], dtype=np.int64)

    def window_rows(self, f: Field) -> IntArray:
        """Return the first row of every window in a field, (W,)."""
        clip, start = self.windows
        first = np.asarray([s.start + s.offset for s in self.spans[f.name]], dtype=np.int64)
        return first[clip] + self.header.grid.rows_of_all(start, of=f.grid)[0]


def plan_shards(header: StoreHeader, clips: Sequence[StoredClip], shard_bytes: int) -> list[ShardPlan]:
    """Distribute clips among shards, groups undivided, each within `shard_bytes` or of one unit; loads no array."""
    header.check()
    if shard_bytes < 1:
        raise StoreError("the size of a shard is not a positive number of bytes", found=shard_bytes)
    seen: dict[str, str] = {}
    split_of: dict[str, str] = {}
    for clip in clips:
        if clip.id in seen:
            raise StoreError("two clips share an id", where=clip.id, found=f"splits {seen[clip.id]} and {clip.split}")
        seen[clip.id] = clip.split
        if clip.group and split_of.setdefault(clip.group, clip.split) != clip.split:
            splits = f"{split_of[clip.group]} and {clip.split}"
            raise StoreError("a group is in two splits", where=f"group {clip.group}", found=splits)
    for clip in clips:
        check_clip(header, clip)
    if not any(clip.starts for clip in clips):
        raise StoreError("there are no windows to store",
                         found=f"{len(clips)} clips, each shorter than a window of {header.length} frames",
                         fix="look at the rejects, or choose shorter windows")  # fmt: skip
    plans: list[ShardPlan] = []
    folded: dict[str, str] = {}
    for split in sort_splits({c.split for c in clips}):
        check_name(split, "split")
        if folded.setdefault(split.lower(), split) != split:
            raise StoreError(
                "two splits have names that differ in case only: macOS and Windows have one file for both",
                found=f"{folded[split.lower()]} and {split}",
                fix="give one of them another name",
            )
        plans += _plan_split(header, split, [c for c in clips if c.split == split], shard_bytes)
    return plans


def _plan_split(header: StoreHeader, split: str, clips: list[StoredClip], limit: int) -> list[ShardPlan]:
    units: dict[tuple[str, bool], list[StoredClip]] = {}
    for clip in clips:
        units.setdefault((clip.group or clip.id, not clip.group), []).append(clip)
    plans: list[ShardPlan] = []
    for name in sorted(units):
        unit = sorted(units[name], key=lambda clip: clip.member)
        _check_group(unit)
        if not plans or plans[-1].bytes_with(unit) > limit:
            plans.append(ShardPlan(header, split))
        for clip in unit:
            plans[-1].add(clip)
    for number, plan in enumerate(plans):
        plan.file = shard_name(split, number, len(plans))
    return plans


#: What the dancers of a group have in common, beside their windows.
SHARED = ("music", "song", "n_frames", "trim_start", "source_rate", "lists", "audio_start")


def _check_group(unit: Sequence[StoredClip]) -> None:
    """Raise StoreError for dancers of a group that do not move in one time, or share a number."""
    first = unit[0]
    where = f"group {first.group}"
    members = [clip.member for clip in unit]
    if first.group and (min(members) < 0 or len(set(members)) < len(members)):
        raise StoreError("the dancers of a group have no number of their own", where=where, found=listed(members))
    if not first.group and first.member != -1:
        raise StoreError("a dancer without a group has a number", where=f"clip {first.id}", found=first.member)
    for clip in unit[1:]:
        for name in (*SHARED, "starts"):
            one, two = getattr(first, name), getattr(clip, name)
            if one != two:
                raise StoreError(f"the dancers of a group differ in {name}", where=where,
                                 found=f"{shown(one, 60)} of {first.id}, {shown(two, 60)} of {clip.id}")  # fmt: skip
        for name, block in first.audio.items():
            if (block.key, block.offset) != (clip.audio[name].key, clip.audio[name].offset):
                found = f"{first.id}, {clip.id}"
                raise StoreError(f"the dancers of a group do not share the rows of {name}", where=where, found=found)
