"""Writes the tables of a split: /clips, /windows, /songs, /groups, and /segments in a file of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dancedata.core.errors import StoreError
from dancedata.core.licence import Licence
from dancedata.core.segments import Layer
from dancedata.core.text import quoted
from dancedata.files.atomic import atomic_file
from dancedata.store import hdf5
from dancedata.store.clip_columns import ALWAYS, CLIP_COLUMNS, FREE, ClipColumn
from dancedata.store.hdf5 import SparseFile
from dancedata.store.schema import FORMAT, StoreHeader, check_name, segments_name, tables_name
from dancedata.store.segments import SegmentRow, segment_rows
from dancedata.store.shard_plan import ShardPlan
from dancedata.store.stored_clip import StoredClip
from dancedata.store.table_columns import MISSING, TextColumn, free_type, type_of
from dancedata.store.table_file import SEGMENT_COLUMNS

#: Most rows of a table.
MAX_ROWS = 2**31 - 1


class Header(Protocol):
    """Attributes of the files of a dataset."""

    @property
    def scope(self) -> str:
        """Whether windows are views of clips."""
        ...

    @property
    def fps(self) -> Fraction | int:
        """Frames per second."""
        ...


@dataclass(frozen=True)
class TablePlan:
    """What the tables of all splits have in common: columns with their types, layers of segments, terms of clips."""

    clips: tuple[ClipColumn, ...]
    free: Mapping[str, str]
    layers: tuple[Layer, ...]
    licences: tuple[Licence, ...]
    header: StoreHeader
    has_groups: bool
    has_songs: bool

    @classmethod
    def of(cls, header: StoreHeader, clips: Sequence[StoredClip]) -> TablePlan:
        """Choose the columns: those that a clip has a value for."""
        columns = tuple(
            column for column in CLIP_COLUMNS
            if column.name in ALWAYS or any(_is_set(column, clip) for clip in clips)
        )  # fmt: skip
        names = sorted({name for clip in clips for name in clip.columns})
        free = {name: _free_type(name, clips) for name in names}
        layers = sorted({s.layer for clip in clips for s in clip.segments}, key=lambda layer: repr(layer))
        has_songs = any(clip.signal is not None for clip in clips)
        licences = sorted({clip.terms for clip in clips if clip.terms is not None})
        has_groups = any(clip.group for clip in clips)
        return cls(columns, free, tuple(layers), tuple(licences), header, has_groups, has_songs)

    @property
    def types(self) -> dict[str, dict[str, str]]:
        """Types of the columns by table, in the order of dataset.json."""
        clips = {column.name: column.stated_type for column in self.clips}
        clips |= {FREE + name: kind for name, kind in self.free.items()}
        windows = {"clip": "row:clips", "start": "int"}
        for f in self.header.fields:
            if f.per_clip or self.header.scope == "track":
                clips |= {f"{f.path}/{name}": "int" for name in f.span_columns}
            if self.header.scope == "window":
                windows[f"rows/{f.name}"] = "int"
        tables = {"clips": clips, "windows": windows}
        if self.has_groups:
            tables["groups"] = {"id": "text", "first": "row:clips", "count": "int", "n_source": "int"}
        if self.has_songs:
            tables["songs"] = {
                "id": "text", "sha256": "hash:32", "sample_rate": "int", "n_samples": "int", "fingerprint": "ints",
            }  # fmt: skip
        if self.layers:
            tables["segments"] = dict(SEGMENT_COLUMNS)
        return tables


def _is_set(column: ClipColumn, clip: StoredClip) -> bool:
    value = getattr(clip, column.name)
    if column.name == "song":
        return clip.signal is not None
    if column.name == "licence":
        return clip.terms is not None
    if column.type.startswith("row:") or column.name == "made_of":
        return bool(value)
    stored = column.encode(value)
    return bool(stored != column.default and stored == stored)


def _free_type(name: str, clips: Sequence[StoredClip]) -> str:
    check_name(name, "column")
    try:
        return free_type([clip.columns[name] for clip in clips if name in clip.columns])
    except StoreError as error:
        raise StoreError(error.problem, where=f"{FREE}{name}", found=error.found, allowed=error.allowed) from error


def write_tables(out: Path, plan: TablePlan, split: str, shards: Sequence[ShardPlan]) -> dict[str, Any]:
    """Write the tables of a split, and its segments; returns the numbers of rows, and the names of the files."""
    clips = [clip for shard in shards for clip in shard.clips]
    groups = _groups(clips)
    songs = _songs(clips)
    rows = {"clips": len(clips), "windows": sum(len(clip.starts) for clip in clips)}
    layout = SparseFile()
    with hdf5.create_file(layout) as file:
        _write_attributes(file, plan.header, split)
        group_rows = {group[0].group: row for row, group in enumerate(groups)}
        song_rows = {song: row for row, song in enumerate(songs)}
        _write_clips(file.create_group("clips"), plan, shards, group_rows, song_rows)
        _write_windows(file.create_group("windows"), plan, shards)
        if plan.has_groups:
            first = {clip.id: row for row, clip in enumerate(clips)}
            _write(
                file.create_group("groups"), plan.types["groups"],
                id=[group[0].group for group in groups],
                first=[first[group[0].id] for group in groups],
                count=[len(group) for group in groups],
                n_source=[max(clip.group_size for clip in group) or len(group) for group in groups],
            )  # fmt: skip
            rows["groups"] = len(groups)
        if plan.has_songs:
            signals = [signal for _, signal in songs]
            columns = {name: [getattr(s, name) for s in signals] for name in ("sha256", "sample_rate", "n_samples")}
            fingerprints = [signal.fingerprint for signal in signals]
            types = plan.types["songs"]
            _write(file.create_group("songs"), types, id=[i for i, _ in songs], fingerprint=fingerprints, **columns)
            rows["songs"] = len(songs)
    _publish(out / tables_name(split), layout)
    files = {"tables": tables_name(split)}
    segments, empty = segment_rows(clips, {layer: k for k, layer in enumerate(plan.layers)}, plan.header.grid)
    if segments:
        rows["segments"] = len(segments)
        files["segments"] = segments_name(split)
        write_segments(out / files["segments"], plan.header, split, segments, len(clips))
    if max(rows.values()) > MAX_ROWS:
        raise StoreError("a table has too many rows", where=split, found=max(rows.values()), allowed=MAX_ROWS)
    return {"rows": rows, "files": files, "layers": [row.layer for row in segments], "empty_segments": empty}


def _write_attributes(file: Any, header: Header, split: str) -> None:
    file.attrs.create("format", np.int64(FORMAT), dtype="<i8")
    for name, text in (("split", split), ("scope", header.scope), ("fps", str(header.fps))):
        hdf5.write_text_attribute(file, name, text)


def _publish(path: Path, layout: SparseFile) -> None:
    with atomic_file(path) as temporary, open(temporary, "wb") as target:
        layout.copy_to(target)


def _groups(clips: Sequence[StoredClip]) -> list[list[StoredClip]]:
    """Return the clips of each group, in stored order."""
    groups: dict[str, list[StoredClip]] = {}
    for clip in clips:
        if clip.group:
            groups.setdefault(clip.group, []).append(clip)
    return list(groups.values())


def _songs(clips: Sequence[StoredClip]) -> list[tuple[str, Any]]:
    """Return the songs of clips, (id, signal), by id and hash."""
    songs = {(clip.song, clip.signal) for clip in clips if clip.signal is not None}
    return sorted(songs, key=lambda song: (song[0], song[1]))


def _write_clips(
    group: Any, plan: TablePlan, shards: Sequence[ShardPlan], groups: Mapping[str, int], songs: Mapping[Any, int]
) -> None:
    clips = [clip for shard in shards for clip in shard.clips]
    for column in plan.clips:
        if column.name == "group":
            values: list[Any] = [groups.get(clip.group, -1) for clip in clips]
        elif column.name == "song":
            values = [songs.get((clip.song, clip.signal), -1) for clip in clips]
        elif column.name == "licence":
            values = [-1 if clip.terms is None else plan.licences.index(clip.terms) for clip in clips]
        else:
            values = [column.encode(getattr(clip, column.name)) for clip in clips]
        type_of(column.type).write(group, column.name, values)
    for name, kind in plan.free.items():
        column_type, missing = type_of(kind), MISSING[kind]
        values = [clip.columns.get(name, missing) for clip in clips]
        problem = next(filter(None, map(column_type.problem, values)), "")
        if problem:
            raise StoreError(f"a value of a free column cannot be stored: {problem}", where=f"{FREE}{name}")
        column_type.write(group, FREE + name, values)
    hdf5.write_array(group, "by_id", TextColumn.of([clip.id for clip in clips]).sorted_rows())
    for f in plan.header.fields:
        spans = [span for shard in shards for span in (shard.motion if f.per_clip else shard.audio)[f.name]]
        for name in f.span_columns if f.per_clip or plan.header.scope == "track" else ():
            dtype = np.int32 if name == "length" else np.int64
            hdf5.write_array(group, f"{f.path}/{name}", np.asarray([getattr(s, name) for s in spans], dtype=dtype))


def _write_windows(group: Any, plan: TablePlan, shards: Sequence[ShardPlan]) -> None:
    tables = [shard.window_table() for shard in shards]
    before = np.cumsum([0, *(len(shard.clips) for shard in shards)])
    clip = np.concatenate([table.clip + first for table, first in zip(tables, before, strict=False)])
    hdf5.write_array(group, "clip", clip.astype(np.int32))
    hdf5.write_array(group, "start", np.concatenate([table.start for table in tables]).astype(np.int32))
    for f in plan.header.fields if plan.header.scope == "window" else ():
        hdf5.write_array(group, f"rows/{f.name}", np.concatenate([table.rows[f.name] for table in tables]))
    group.attrs.create("length", np.int64(plan.header.length), dtype="<i8")


def _write(group: Any, types: Mapping[str, str], **columns: Sequence[Any]) -> None:
    for name, kind in types.items():
        problem = next(filter(None, map(type_of(kind).problem, columns[name])), "")
        if problem:
            raise StoreError(
                f"a value of a table cannot be stored: {problem}", where=name, found=quoted(columns[name][0])
            )
        type_of(kind).write(group, name, columns[name])


def write_segments(path: Path, header: Header, split: str, rows: Sequence[SegmentRow], n_clips: int) -> None:
    """Write <split>-segments.h5."""
    layout = SparseFile()
    with hdf5.create_file(layout) as file:
        _write_attributes(file, header, split)
        group = file.create_group("segments")
        columns = dict(zip(SegmentRow._fields, zip(*rows, strict=True), strict=True))
        narrow = {"start": "int32", "end": "int32", "layer": "int32", "joint": "int32"}
        _write(group, {**SEGMENT_COLUMNS, **narrow}, **columns)
        first = np.searchsorted(np.asarray(columns["clip"]), np.arange(n_clips + 1))
        hdf5.write_array(group, "first", first.astype(np.int64))
    _publish(path, layout)
