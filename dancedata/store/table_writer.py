"""Writes tables.h5, /clips, /windows, /groups and /songs of all splits, and segments.h5: one dataset a column."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.clip import check_name
from dancedata.core.errors import StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.licence import Licence
from dancedata.core.segments import Layer, layer_json
from dancedata.files.atomic import atomic_file
from dancedata.store import hdf5
from dancedata.store.clip_columns import ALWAYS, CLIP_COLUMNS, FREE, ClipColumn
from dancedata.store.columns import MAX_ROWS, MISSING, checked, free_kind, write_column
from dancedata.store.hdf5 import SparseFile
from dancedata.store.schema import FORMAT, SEGMENTS_FILE, TABLES_FILE, StoreHeader
from dancedata.store.segments import SegmentedClip, SegmentRow, segment_rows
from dancedata.store.shard_plan import ShardPlan
from dancedata.store.stored_clip import StoredClip
from dancedata.store.table_file import SEGMENT_COLUMNS


@dataclass(frozen=True)
class TablePlan:
    """What all clips have in common: columns, free ones with their kinds, layers of segments, terms."""

    header: StoreHeader
    columns: tuple[ClipColumn, ...]
    free: Mapping[str, str]
    layers: tuple[Layer, ...]
    licences: tuple[Licence, ...]

    @classmethod
    def of(cls, header: StoreHeader, clips: Sequence[StoredClip]) -> TablePlan:
        """Choose the columns: those that a clip has a value for."""
        return cls(
            header,
            tuple(c for c in CLIP_COLUMNS if c.name in ALWAYS or any(_is_set(c, clip) for clip in clips)),
            {name: _free_kind(name, clips) for name in sorted({name for clip in clips for name in clip.columns})},
            tuple(sorted({s.layer for clip in clips for s in clip.segments}, key=repr)),
            tuple(sorted({clip.terms for clip in clips if clip.terms is not None})),
        )


def _is_set(column: ClipColumn, clip: StoredClip) -> bool:
    if column.name == "licence":
        return clip.terms is not None
    stored = _stored(column, clip)
    return bool(stored != column.default and stored == stored)


def _stored(column: ClipColumn, clip: StoredClip) -> Any:
    return "" if column.name == "song" and clip.signal is None else column.encode(getattr(clip, column.name))


def _free_kind(name: str, clips: Sequence[StoredClip]) -> str:
    check_name(name, "column")
    try:
        return free_kind([clip.columns[name] for clip in clips if name in clip.columns])
    except StoreError as error:
        raise StoreError(error.problem, where=f"{FREE}{name}", found=error.found, allowed=error.allowed) from error


def write_tables(out: Path, plan: TablePlan, shards: Sequence[ShardPlan]) -> list[dict[str, Any]]:
    """Write tables.h5, and segments.h5 if there are segments; returns their layers as `write_segments` does."""
    clips = [clip for shard in shards for clip in shard.clips]
    if max(len(clips), sum(len(clip.starts) for clip in clips)) > MAX_ROWS:
        raise StoreError("a table has too many rows", found=len(clips), allowed=MAX_ROWS)
    with _written(out / TABLES_FILE, plan.header.grid) as file:
        _write_clips(file.create_group("clips"), plan, shards, clips)
        windows = file.create_group("windows")
        before = np.cumsum([0, *(len(shard.clips) for shard in shards)])
        clip = np.concatenate([shard.windows[0] + first for shard, first in zip(shards, before, strict=False)])
        hdf5.write_array(windows, "clip", clip.astype(np.int32))
        hdf5.write_array(windows, "start", np.concatenate([s.windows[1] for s in shards]).astype(np.int32))
        hdf5.write_attributes(windows, length=plan.header.length)
        groups = [list(unit) for name, unit in groupby(clips, lambda clip: clip.group) if name]
        if groups:
            first = {clip.id: row for row, clip in enumerate(clips)}
            group = file.create_group("groups")
            write_column(group, "id", "text", [unit[0].group for unit in groups])
            write_column(group, "first", "int32", [first[unit[0].id] for unit in groups])
            write_column(group, "count", "int32", [len(unit) for unit in groups])
            sizes = [max(clip.group_size for clip in unit) or len(unit) for unit in groups]
            write_column(group, "n_source", "int32", sizes)
        _write_songs(file, clips)
    splits = [
        [SegmentedClip(clip.id, clip.n_frames, clip.segments) for clip in of_split]
        for _, of_split in groupby(clips, lambda clip: clip.split)
    ]
    return write_segments(out / SEGMENTS_FILE, plan.header.grid, splits, plan.layers)


@contextmanager
def _written(path: Path, grid: FrameGrid) -> Iterator[Any]:
    layout = SparseFile()
    with hdf5.create_file(layout) as file:
        hdf5.write_attributes(file, format=FORMAT, fps=str(grid.rate))
        yield file
    with atomic_file(path) as temporary, open(temporary, "wb") as target:
        layout.copy_to(target)


def _write_clips(group: Any, plan: TablePlan, shards: Sequence[ShardPlan], clips: Sequence[StoredClip]) -> None:
    for column in plan.columns:
        values = [_stored(column, clip) for clip in clips]
        if column.name == "licence":
            values = [-1 if clip.terms is None else plan.licences.index(clip.terms) for clip in clips]
        write_column(group, column.name, column.kind, values)
    for name, kind in plan.free.items():
        values = [clip.columns.get(name, MISSING[kind]) for clip in clips]
        write_column(group, FREE + name, kind, checked(FREE + name, kind, values), nullable=kind in ("int", "bool"))
    for name in ("split", "file"):
        write_column(group, name, "text", [getattr(shard, name) for shard in shards for _ in shard.clips])
    for f in plan.header.fields:
        spans = [s.from_frame_0 for shard in shards for s in shard.spans[f.name]]
        for k, name in enumerate(f.span_columns):
            dtype = np.int32 if name == "length" else np.int64
            hdf5.write_array(group, f"{f.path}/{name}", np.asarray([span[k] for span in spans], dtype=dtype))


def _write_songs(file: Any, clips: Sequence[StoredClip]) -> None:
    songs = sorted({(clip.song, clip.signal) for clip in clips if clip.signal is not None})
    if songs:
        group = file.create_group("songs")
        write_column(group, "id", "text", [name for name, _ in songs])
        for name, kind in (("sha256", "text"), ("sample_rate", "int"), ("n_samples", "int"), ("fingerprint", "ints")):
            values = checked(name, kind, [getattr(signal, name) for _, signal in songs])
            write_column(group, name, kind, values)


def write_segments(
    path: Path, grid: FrameGrid, splits: Sequence[Sequence[SegmentedClip]], layers: Sequence[Layer]
) -> list[dict[str, Any]]:
    """Write segments.h5 if a segment covers a frame; returns the entries of the layers in dataset.json."""
    numbers, n_clips = {layer: k for k, layer in enumerate(layers)}, 0
    rows, empty = list[SegmentRow](), Counter[int]()
    for clips in splits:
        of_split, without_frame = segment_rows(clips, n_clips, numbers, grid)
        rows, empty, n_clips = rows + of_split, empty + without_frame, n_clips + len(clips)
    if rows:
        with _written(path, grid) as file:
            group = file.create_group("segments")
            columns = dict(zip(SegmentRow._fields, zip(*rows, strict=True), strict=True))
            for name, kind in SEGMENT_COLUMNS.items():
                write_column(group, name, kind, checked(name, kind, columns[name]))
            first = np.searchsorted(np.asarray(columns["clip"]), np.arange(n_clips + 1))
            hdf5.write_array(group, "first", first.astype(np.int64))
    of_layer = Counter(row.layer for row in rows)
    return [layer_json(layer, of_layer[number], empty[number]) for number, layer in enumerate(layers)]
