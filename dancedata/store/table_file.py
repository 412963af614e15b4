"""Reads <split>-tables.h5 and <split>-segments.h5 of format 2: columns as arrays of the mapped file."""

from __future__ import annotations

import math
import mmap
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.store import hdf5
from dancedata.store.clip_columns import ALWAYS, CLIP_COLUMNS, FREE
from dancedata.store.dataset_json import Description, ShardEntry
from dancedata.store.listed_file import ListedFile
from dancedata.store.table_columns import type_of
from dancedata.store.tables import FieldSpans, Tables, broken, check_frames, check_spans, check_windows

#: Larger files are mapped; smaller ones are read whole, which costs less and cannot be truncated under a reader.
_READ_WHOLE = 1 << 24


@dataclass(frozen=True)
class TableFile:
    """An open file of tables, and its bytes."""

    file: Any
    where: str
    memory: bytes | mmap.mmap

    @classmethod
    @contextmanager
    def opened(cls, listed: ListedFile) -> Iterator[TableFile]:
        """Open a file that dataset.json lists."""
        listed.require_there()
        with hdf5.open_file(listed.path, listed.require) as file:
            yield cls(file, str(listed.path), _bytes(listed))

    def array(self, name: str, kinds: str) -> npt.NDArray[Any]:
        """Return a dataset of one of these numpy kinds, as a view of the file where it is one piece of it."""
        dataset = hdf5.find_dataset(self.file, name)
        shape, dtype, offset = dataset.shape, dataset.dtype, dataset.id.get_offset()
        if len(shape) not in (1, 2) or dtype.kind not in kinds:
            problem = "a column of a table has another shape or type"
            raise self.error(name, problem, f"{shape} {dtype}", f"(N,) of kind {' or '.join(kinds)}")
        size = math.prod(shape)
        if offset is None or not size:
            return np.asarray(dataset[...])
        return np.frombuffer(self.memory, dtype=dtype, count=size, offset=offset).reshape(shape)

    def error(self, name: str, problem: str, actual: object, allowed: object = None) -> StoreError:
        """Return an error that names the file and the dataset."""
        return broken(f"{self.where}, /{name}", problem, actual, allowed)

    def column(self, table: str, name: str, kind: str, n_rows: int) -> Any:
        """Read a column with this number of rows."""
        column = type_of(kind).read(self, f"{table}/{name}")
        if len(column) != n_rows:
            problem = "a column has another number of rows than its table"
            raise self.error(f"{table}/{name}", problem, len(column), n_rows)
        return column

    def table(self, table: str, description: Description, n_rows: int) -> dict[str, Any]:
        """Read all columns of a table that dataset.json names."""
        columns = description.tables.get(table, {})
        return {name: self.column(table, name, kind, n_rows) for name, kind in columns.items()}


def _bytes(listed: ListedFile) -> bytes | mmap.mmap:
    descriptor = listed.open()
    try:
        if os.fstat(descriptor).st_size > _READ_WHOLE:
            return mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
        with open(descriptor, "rb", closefd=False) as file:
            return file.read()
    finally:
        os.close(descriptor)


def read_tables(listed: ListedFile, description: Description, split: str) -> Tables:
    """Read the tables of a split.

    StoreError for columns that are missing or of another type, and clips whose rows lie outside their field.
    """
    rows = description.splits[split].rows
    shards = [shard for shard in description.shards if shard.split == split]
    shard_begin = np.concatenate([[0], np.cumsum([s.clips for s in shards])]).astype(np.int64)
    with TableFile.opened(listed) as source:
        if int(shard_begin[-1]) != rows["clips"]:
            raise source.error(
                "clips", "the shards hold another number of clips", int(shard_begin[-1]), rows["clips"]
            )
        missing = [name for name in ALWAYS if name not in description.tables["clips"]]
        if missing:
            raise source.error("clips", "a table lacks columns", ", ".join(missing))
        columns = source.table("clips", description, rows["clips"])
        check_frames(columns, source.where)
        spans = _spans(source, description, shard_begin, shards)
        windowed = description.scope == "window"
        known = {column.name for column in CLIP_COLUMNS}
        tables = Tables(
            split=split,
            columns={n: c for n, c in columns.items() if n in known or n.startswith(FREE)},
            types={n: kind for n, kind in description.tables["clips"].items() if n.startswith(FREE)},
            spans=spans,
            shard_begin=shard_begin,
            window_clip=source.column("windows", "clip", "row:clips", rows["windows"]),
            window_start=source.column("windows", "start", "int", rows["windows"]),
            window_length=description.length,
            window_rows={
                f.name: source.column("windows", f"rows/{f.name}", "int", rows["windows"])
                for f in description.fields if windowed
            },
            groups=source.table("groups", description, rows.get("groups", 0)) if "groups" in rows else {},
            songs=source.table("songs", description, rows.get("songs", 0)) if "songs" in rows else {},
            by_id=source.column("clips", "by_id", "row:clips", rows["clips"]),
        )  # fmt: skip
        _check_references(tables, source)
        return check_windows(tables, source.where)


def _spans(
    source: TableFile, description: Description, shard_begin: npt.NDArray[np.int64], shards: Sequence[ShardEntry]
) -> dict[str, FieldSpans]:
    n, counts = int(shard_begin[-1]), np.diff(shard_begin)
    spans = {}
    for f in description.fields:
        if not f.per_clip and description.scope == "window":
            continue
        start, length, *offset = (
            np.asarray(source.column("clips", f"{f.path}/{name}", "int", n), dtype=np.int64)
            for name in f.span_columns
        )
        in_shard = np.repeat([shard.fields[f.name][1] for shard in shards], counts).astype(np.int64)
        spans[f.name] = check_spans(f, start, length, offset[0] if offset else None, in_shard, source.where)
    return spans


def _check_references(tables: Tables, source: TableFile) -> None:
    """Check that rows of other tables exist, and that `by_id` can be searched."""
    for name, table in (("group", tables.groups), ("song", tables.songs)):
        rows = tables.columns.get(name)
        n = len(table["id"]) if "id" in table else 0
        if rows is not None and len(rows) and not (int(rows.min()) >= -1 and int(rows.max()) < n):
            raise source.error(
                f"clips/{name}", "rows of another table that do not exist", int(rows.max()), f"-1 to {n - 1}"
            )
    by_id = tables.by_id
    if by_id is not None and len(by_id) and (int(by_id.min()) < 0 or int(by_id.max()) >= tables.n_clips):
        raise source.error("clips/by_id", "rows of clips that do not exist", int(by_id.max()), tables.n_clips - 1)


@dataclass(frozen=True)
class SegmentTable:
    """Segments of a split: columns, and the rows [first[k], first[k + 1]) of clip k."""

    columns: dict[str, Any]
    first: npt.NDArray[np.int64]

    def rows_of(self, clip: int) -> range:
        """Return the rows of a clip."""
        return range(int(self.first[clip]), int(self.first[clip + 1]))

    def overlapping(self, clip: int, start: int, length: int, layers: npt.NDArray[np.bool_]) -> list[int]:
        """Return the rows of a clip, of the layers that are chosen, that cover a frame of [start, start + length)."""
        rows = slice(int(self.first[clip]), int(self.first[clip + 1]))
        begins, ends, layer = (np.asarray(self.columns[name][rows]) for name in ("start", "end", "layer"))
        covers = (begins < start + length) & (ends > start) & layers[layer]
        return (np.flatnonzero(covers) + rows.start).tolist()


def read_segments(listed: ListedFile, description: Description, split: str) -> SegmentTable:
    """Read the segments of a split; StoreError for a table that does not fit the clips."""
    n_clips, n = (description.splits[split].rows[name] for name in ("clips", "segments"))
    with TableFile.opened(listed) as source:
        first = np.asarray(source.column("segments", "first", "int", n_clips + 1), dtype=np.int64)
        if int(first[0]) != 0 or int(first[-1]) != n or (np.diff(first) < 0).any():
            raise source.error(
                "segments/first", "rows of clips that do not ascend from 0 to the last", f"{first[:3]}"
            )
        columns = source.table("segments", description, n)
    return SegmentTable(columns, first)


#: Columns of segments, with their types in dataset.json, in this order.
SEGMENT_COLUMNS = {
    "clip": "row:clips", "whole": "bool", "start": "int", "end": "int", "start_t": "time", "end_t": "time",
    "layer": "int", "label": "text", "texts": "texts", "texts_mirrored": "texts", "tokens": "texts",
    "value": "float", "other": "row:clips", "joint": "int", "data": "text",
}  # fmt: skip
