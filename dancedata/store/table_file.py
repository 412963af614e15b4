"""Reads tables.h5 and segments.h5: columns as arrays of the mapped file."""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from dancedata.store import hdf5
from dancedata.store.clip_columns import ALWAYS, CLIP_COLUMNS, FREE
from dancedata.store.columns import Column, Lists, Texts, broken, kind_of
from dancedata.store.dataset_json import Description
from dancedata.store.listed_file import ListedFile
from dancedata.store.tables import Tables, check_references, check_spans

#: Larger files are mapped; smaller ones are read whole, which costs less and cannot be truncated under a reader.
_READ_WHOLE = 1 << 24
#: Numbers that columns do not have, by kind and bytes.
_UNUSED = {("u", 2), ("u", 4), ("u", 8), ("i", 1), ("i", 2), ("f", 2), ("f", 4), ("f", 16)}


@dataclass(frozen=True)
class TableFile:
    """An open file of tables, and its bytes."""

    file: Any
    listed: ListedFile
    memory: bytes | mmap.mmap
    opened_objects: dict[str, Any] = field(default_factory=dict)

    @classmethod
    @contextmanager
    def opened(cls, listed: ListedFile) -> Iterator[TableFile]:
        """Open a file that dataset.json lists."""
        listed.ensure_local()
        with hdf5.open_file(listed.path, listed.require) as file:
            yield cls(file, listed, _bytes(listed))

    def array(self, name: str, kinds: str) -> npt.NDArray[Any]:
        """Return a dataset of one of these numpy kinds, as a view of the file where it is one piece of it."""
        dataset = hdf5.find_dataset(self.file, name, self.opened_objects)
        shape, dtype, offset = dataset.shape, dataset.dtype, dataset.id.get_offset()
        if len(shape) != 1 or dtype.kind not in kinds or (dtype.kind, dtype.itemsize) in _UNUSED:
            problem = "a column of a table has another shape or type"
            raise broken(self.where(name), problem, f"{shape} {dtype}", f"(N,) of kind {' or '.join(kinds)}")
        stored = dataset.id.get_type()
        if dtype.kind == "S":
            is_plain = stored.get_strpad() == h5py.h5t.STR_NULLPAD
        else:
            is_plain = stored == h5py.h5t.py_create(dtype)
        if offset is None or not shape[0] or not is_plain:  # HDF5 converts it
            return np.asarray(dataset[...])
        return np.frombuffer(self.memory, dtype=dtype, count=shape[0], offset=offset)

    def is_group(self, name: str) -> bool:
        """Return whether there is a group of this name."""
        return isinstance(hdf5.find_object(self.file, name, self.opened_objects), h5py.h5g.GroupID)

    def names(self, group: str) -> list[str]:
        """Return the names in a group; none without it."""
        return sorted(self.file[group]) if self.is_group(group) else []

    def where(self, name: str) -> str:
        """Return file and name, for errors."""
        return f"{self.listed.path}, /{name}"

    def column(self, name: str, n_rows: int | None, *kinds: str) -> Any:
        """Read a column with this number of rows, of one of these kinds."""
        column = self._column(name)
        if kinds and kind_of(column) not in kinds:
            raise broken(
                self.where(name), "a column of a table has another type", kind_of(column), " or ".join(kinds)
            )
        if n_rows is not None and len(column) != n_rows:
            problem = "a column has another number of rows than its table"
            raise broken(self.where(name), problem, len(column), n_rows)
        return column

    def _column(self, name: str) -> Column:
        """Read a column, whatever it holds; StoreError for anything that is not one."""
        if not self.is_group(name):
            return self._values(name)
        offset = self.array(f"{name}/offset", "i")
        is_text = self.is_group(f"{name}/values")
        values = self._texts(f"{name}/values") if is_text else self._values(f"{name}/values")
        if isinstance(values, np.ndarray) and values.dtype.kind == "u":
            return self._texts(name)
        return Lists(self._ending(name, offset, len(values)), values, self.where(name))

    def _values(self, name: str) -> npt.NDArray[Any] | Texts:
        column = self.array(name, "iufS")
        return Texts(column, None, self.where(name)) if column.dtype.kind == "S" else column

    def _texts(self, name: str) -> Texts:
        offset, raw = self.array(f"{name}/offset", "i"), self.array(f"{name}/values", "u")
        return Texts(raw, self._ending(name, offset, len(raw)), self.where(name))

    def _ending(self, name: str, offset: npt.NDArray[Any], n: int) -> npt.NDArray[Any]:
        """Check the first and last offset; the others are checked where a row is read, and by `check`."""
        if not len(offset) or offset[0] != 0 or offset[-1] != n:
            ends, where = offset[[0, -1]].tolist() if len(offset) else "none", self.where(f"{name}/offset")
            raise broken(where, "offsets do not begin at 0 and end at the last entry", ends, f"0 to {n}")
        return offset

    def table(self, name: str, **kinds: str) -> dict[str, Any]:
        """Read columns of a table by name, of these kinds and of one length; none without the table."""
        columns: dict[str, Any] = {}
        for column, kind in kinds.items() if hdf5.find_object(self.file, name) is not None else ():
            n_rows = len(next(iter(columns.values()))) if columns else None
            columns[column] = self.column(f"{name}/{column}", n_rows, kind)
        return columns


def _bytes(listed: ListedFile) -> bytes | mmap.mmap:
    descriptor = listed.open()
    try:
        if os.fstat(descriptor).st_size > _READ_WHOLE:
            return mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
        with open(descriptor, "rb", closefd=False) as file:
            return file.read()
    finally:
        os.close(descriptor)


#: Kinds of columns that are read, by those of `ClipColumn` and `SEGMENT_COLUMNS`.
KINDS = {"text": "text", "texts": "texts", "int32": "int", "float": "float", "bool": "bool"}


def read_tables(listed: ListedFile, description: Description) -> Tables:
    """Read the tables of a dataset; StoreError for missing columns, and clips whose rows lie outside their field."""
    shards, where = description.shards, str(listed.path)
    shard_begin = np.cumsum([0, *(shard.clips for shard in shards)]).astype(np.int64)
    n_clips, n_windows = int(shard_begin[-1]), sum(shard.windows for shard in shards)
    with TableFile.opened(listed) as source:
        stored = {*ALWAYS, *source.names("clips")}
        kinds = {c.name: KINDS[c.kind] for c in CLIP_COLUMNS if c.name in stored} | {"split": "text", "file": "text"}
        columns = {name: source.column(f"clips/{name}", n_clips, kind) for name, kind in kinds.items()}
        free = {FREE + name: source.column(f"clips/{FREE}{name}", n_clips) for name in source.names(f"clips/{FREE}")}
        spans = {}
        for f in description.fields:
            paths = [f"clips/{f.path}/{name}" for name in f.span_columns]
            values = [np.asarray(source.column(path, n_clips, "int"), dtype=np.int64) for path in paths]
            n_rows = np.repeat([shard.fields[f.name][1] for shard in shards], np.diff(shard_begin))
            spans[f.name] = check_spans(f, *values, n_rows=n_rows.astype(np.int64, copy=False), where=where)
        tables = Tables(
            splits=description.splits,
            columns=columns | free,
            types={name: kind_of(column) for name, column in free.items()},
            spans=spans,
            shard_begin=shard_begin,
            window_clip=source.column("windows/clip", n_windows, "int"),
            window_start=source.column("windows/start", n_windows, "int"),
            window_length=description.length,
            groups=source.table("groups", id="text", first="int", count="int", n_source="int"),
            songs=source.table(
                "songs", id="text", sha256="text", sample_rate="int", n_samples="int", fingerprint="ints"
            ),
        )  # fmt: skip
        return check_references(tables, len(description.meta.get("licences", ())), where)


#: Columns of segments.
SEGMENT_COLUMNS = {
    "clip": "int32", "whole": "bool", "start": "int32", "end": "int32", "start_s": "float", "end_s": "float",
    "layer": "int32", "label": "text", "texts": "texts", "texts_mirrored": "texts", "tokens": "texts",
    "value": "float", "other": "int32", "joint": "int32", "data": "text",
}  # fmt: skip
