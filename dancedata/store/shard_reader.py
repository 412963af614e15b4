"""Reads one shard: its tables once, through h5py; its rows straight from the file, by their position in it.

Fields are contiguous and uncompressed, so rows [a, b) are one piece of the file. Reading that piece by
position, or from the mapped file, needs no HDF5 handle in the process, shares no file offset between
processes, and lets threads read at once. A field that another tool has chunked or compressed is read through
h5py, which opens the file for every read.
"""

from __future__ import annotations

import math
import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.store import hdf5
from dancedata.store.listed_file import ListedFile
from dancedata.store.schema import LIST_SEPARATOR, ClipRecord, Field

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class FieldLayout:
    """Where a field's rows lie in a shard: first byte, number of rows, columns, dtype, name in the file.

    The first byte is None where rows are not one piece of the file: chunked or compressed.
    """

    offset: int | None
    n_rows: int
    width: int
    dtype: np.dtype[Any]
    name: str

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self.width * self.dtype.itemsize


@dataclass(frozen=True)
class ClipTable:
    """The table /clips of a shard.

    Attributes
    ----------
    records
        One a clip, in stored order.
    first, available
        Per field: row in the shard of each clip's frame 0, and rows from there to the end of the clip or
        timeline. Audio fields of window scope have none.
    """

    records: tuple[ClipRecord, ...]
    first: dict[str, IntArray]
    available: dict[str, IntArray]


@dataclass(frozen=True)
class StoredWindows:
    """The table /windows of a shard, and a lookup by clip and start. Arrays (W,)."""

    clip: IntArray
    start: IntArray
    length: IntArray
    index: IntArray
    rows: dict[str, IntArray]
    by_start: IntArray
    clip_begin: IntArray

    def starts_of(self, clip: int) -> list[int]:
        """List the first frames of a clip's windows, ascending."""
        begin, end = self.clip_begin[clip : clip + 2]
        return [int(s) for s in self.start[self.by_start[begin:end]]]

    def find(self, clip: int, start: int) -> int | None:
        """Find the position in the table of the window of a clip that begins at a frame, or None."""
        begin, end = self.clip_begin[clip : clip + 2]
        positions = self.by_start[begin:end]
        place = int(np.searchsorted(self.start[positions], start))
        if place == len(positions) or self.start[positions[place]] != start:
            return None
        return int(positions[place])


class ShardReader:
    """One shard of a store, safe under threads and fork; holds at most one file descriptor, opened late.

    Every time that it is opened, it has to be the file that dataset.json described.
    """

    def __init__(self, file: ListedFile, split: str, fields: tuple[Field, ...], scope: str) -> None:
        """Remember where the shard is; nothing is opened."""
        self.path = file.path
        self._described = file
        self.split = split
        self._fields = fields
        self._scope = scope
        self._clips: ClipTable | None = None
        self._layout: dict[str, FieldLayout] = {}
        self._windows: StoredWindows | None = None
        self._file: _File | None = None
        self._map: _Map | None = None

    @property
    def clips(self) -> ClipTable:
        """The table of clips, read when first asked for."""
        if self._clips is None:
            with self._opened() as file:
                self._layout = {f.name: _field_layout(file, f, self.path) for f in self._fields}
                tables = _Tables(file, self.path)
                clips = _read_clips(tables, self.split, self._fields, self._scope)
                for name, first in clips.first.items():
                    _check_spans(tables, self._layout[name], first, clips.available[name])
                self._clips = clips
        return self._clips

    @property
    def windows(self) -> StoredWindows:
        """The table of windows, read when first asked for."""
        if self._windows is None:
            n_clips = len(self.clips.records)
            with self._opened() as file:
                self._windows = _read_windows(_Tables(file, self.path), self._fields, n_clips)
        return self._windows

    def layout(self, field: str) -> FieldLayout:
        """Tell where a field's rows lie in the file."""
        if not self._layout:
            _ = self.clips
        return self._layout[field]

    def read_rows(self, field: str, first: int, out: npt.NDArray[Any]) -> None:
        """Read rows [first, first + len(out)) of a field into `out`, (rows, D), converting to its dtype."""
        layout = self.layout(field)
        if first < 0 or first + len(out) > layout.n_rows:
            raise StoreError(
                "rows lie outside the shard",
                where=f"{self.path}, field {field}",
                found=f"rows {first} to {first + len(out)} of {layout.n_rows}",
                fix="run dancedata check on the dataset",
            )
        direct = out.dtype == layout.dtype and out.flags.c_contiguous and out.flags.writeable
        target = out if direct else np.empty((len(out), layout.width), dtype=layout.dtype)
        if target.size and layout.offset is None:
            with self._opened() as file:
                file[layout.name].read_direct(target, np.s_[first : first + len(target)])
        elif target.size and layout.offset is not None:
            self._open().read_into(memoryview(target.data).cast("B"), layout.offset + first * layout.row_bytes)
        if not direct:
            out[...] = target

    def mapped_rows(self, field: str) -> npt.NDArray[Any] | str:
        """Return all rows of a field, (n_rows, D), as a view of the mapped file that cannot be written to.

        Where that is impossible, return why: rows that are no one piece of the file, or a file system that maps
        no files. `read_rows` works all the same.
        """
        layout = self.layout(field)
        if layout.offset is None:
            return f"{layout.name} of {self.path.name} is chunked or compressed"
        if self._map is None:
            try:
                self._map = _Map(self._described)
            except (OSError, ValueError) as error:
                return f"{self.path.name} cannot be mapped: {error}"
        return self._map.rows(layout)

    def read_ahead(self, field: str, first: int, n_rows: int) -> None:
        """Tell the system that rows of a mapped field will be read soon; returns at once."""
        layout = self.layout(field)
        if self._map is not None and layout.offset is not None:
            self._map.read_ahead(layout.offset + first * layout.row_bytes, n_rows * layout.row_bytes)

    def close(self) -> None:
        """Give file descriptor and mapping back; a later read opens the file again."""
        self._file = None
        self._map = None

    def _open(self) -> _File:
        file = self._file
        # A forked child opens the file anew: what it inherited belongs to the parent.
        if file is None or file.pid != os.getpid():
            file = _File(self._described)
            self._file = file
        return file

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open the shard through h5py."""
        self._described.require_there()
        with hdf5.open_file(self.path, self._described.require) as file:
            yield file


class _File:
    """A file descriptor read by position."""

    def __init__(self, file: ListedFile) -> None:
        self.path = file.path
        self.pid = os.getpid()
        self._descriptor = -1
        self._descriptor = file.open()

    def read_into(self, view: memoryview, position: int) -> None:
        """BatchReader `view` with the bytes from `position` on."""
        while view.nbytes:
            n = os.preadv(self._descriptor, [view], position)
            if n == 0:
                raise StoreError(
                    "a shard ends too early",
                    where=str(self.path),
                    found=f"{view.nbytes} bytes missing at byte {position}",
                    fix="run dancedata check on the dataset",
                )
            view, position = view[n:], position + n

    def __del__(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)


class _Map:
    """A whole file mapped read-only. A forked child may go on using it; other processes share its memory."""

    def __init__(self, described: ListedFile) -> None:
        self.path = described.path
        descriptor = described.open()
        try:
            self._memory = mmap.mmap(descriptor, 0, flags=mmap.MAP_SHARED, prot=mmap.PROT_READ)
        finally:
            os.close(descriptor)

    def rows(self, layout: FieldLayout) -> npt.NDArray[Any]:
        offset, count = layout.offset or 0, layout.n_rows * layout.width
        missing = offset + layout.n_rows * layout.row_bytes - len(self._memory)
        if missing > 0:
            raise StoreError(
                "a shard ends too early",
                where=str(self.path),
                found=f"{missing} bytes missing at byte {len(self._memory)}",
                fix="run dancedata check on the dataset",
            )
        rows = np.frombuffer(self._memory, dtype=layout.dtype, count=count, offset=offset)
        return rows.reshape(layout.n_rows, layout.width)

    def read_ahead(self, position: int, n_bytes: int) -> None:
        page = position - position % mmap.PAGESIZE
        self._memory.madvise(mmap.MADV_WILLNEED, page, position + n_bytes - page)


def _field_layout(file: Any, f: Field, path: Path) -> FieldLayout:
    name = f"/{f.kind}/{f.name}"
    dataset = hdf5.find_dataset(file, name)
    if dataset.ndim != 2 or dataset.shape[1] != f.columns.width or dataset.dtype != f.disk_dtype:
        raise StoreError(
            "a field has another shape or dtype than dataset.json says",
            where=f"{path}, {name}",
            found=f"{dataset.shape} {dataset.dtype}",
            allowed=f"(rows, {f.columns.width}) {f.disk_dtype}",
        )
    offset = dataset.id.get_offset()
    if not math.prod(dataset.shape):
        offset = 0
    return FieldLayout(offset, int(dataset.shape[0]), int(dataset.shape[1]), f.disk_dtype, name)


class _Tables:
    """The columns of a shard's tables, which have to be one value a row, all of one length."""

    def __init__(self, file: Any, path: Path) -> None:
        self._file, self._path = file, path
        self._n_rows: dict[str, int] = {}

    def whole(self, name: str) -> IntArray:
        """Read a column of whole numbers."""
        return np.asarray(self._column(name, "iu")[...], dtype=np.int64)

    def numbers(self, name: str) -> list[float]:
        """Read a column of numbers."""
        found: list[float] = self._column(name, "f")[...].tolist()
        return found

    def texts(self, name: str) -> list[str]:
        """Read a column of texts."""
        return hdf5.read_strings(self._column(name, "S"))

    def _column(self, name: str, kinds: str) -> Any:
        column = hdf5.find_dataset(self._file, name)
        table = name.partition("/")[0]
        n_rows = self._n_rows.setdefault(table, column.shape[0] if column.ndim else 0)
        if column.shape != (n_rows,) or column.dtype.kind not in kinds:
            problem = "a column of a shard's table has another shape or type"
            raise self.broken(name, problem, f"{column.shape} {column.dtype}", f"({n_rows},), one value a row")
        return column

    def broken(self, name: str, problem: str, found: object = None, allowed: str | None = None) -> StoreError:
        """Return the error for a column."""
        fix = "run dancedata check on the dataset"
        return StoreError(problem, where=f"{self._path}, /{name}", found=found, allowed=allowed, fix=fix)


def _read_clips(tables: _Tables, split: str, fields: tuple[Field, ...], scope: str) -> ClipTable:
    names = ("id", "genre", "music", "dancer", "source", "source_rate", "lists")
    texts = {name: tables.texts(f"clips/{name}") for name in names}
    numbers = {name: tables.numbers(f"clips/{name}") for name in ("tempo_bpm", "height_m")}
    counts = {name: tables.whole(f"clips/{name}").tolist() for name in ("n_flags", "trim_start", "n_frames")}
    if min(counts["n_frames"], default=0) < 0:
        raise tables.broken("clips/n_frames", "a clip has a negative number of frames", min(counts["n_frames"]))
    records = tuple(
        ClipRecord(
            id=clip_id,
            split=split,
            genre=texts["genre"][i],
            music=texts["music"][i],
            dancer=texts["dancer"][i],
            tempo_bpm=None if math.isnan(numbers["tempo_bpm"][i]) else numbers["tempo_bpm"][i],
            source=texts["source"][i],
            n_flags=counts["n_flags"][i],
            trim_start=counts["trim_start"][i],
            height_m=None if math.isnan(numbers["height_m"][i]) else numbers["height_m"][i],
            source_rate=texts["source_rate"][i],
            lists=tuple(filter(None, texts["lists"][i].split(LIST_SEPARATOR))),
            n_frames=counts["n_frames"][i],
        )
        for i, clip_id in enumerate(texts["id"])
    )
    first: dict[str, IntArray] = {}
    available: dict[str, IntArray] = {}
    for f in fields:
        if f.per_clip or scope == "track":
            spans = f"clips/{f.kind}/{f.name}"
            offset = tables.whole(f"{spans}/offset") if f.kind == "audio" else 0
            first[f.name] = tables.whole(f"{spans}/start") + offset
            available[f.name] = tables.whole(f"{spans}/length") - offset
    return ClipTable(records, first, available)


def _check_spans(tables: _Tables, layout: FieldLayout, first: IntArray, available: IntArray) -> None:
    """Check that clips lie within the rows of a field: readers make room for as many as a clip has."""
    bad = (first < 0) | (available < 0) | (first > layout.n_rows)
    bad |= available > layout.n_rows - np.where(bad, 0, first)
    if bad.any():
        k = int(np.argmax(bad))
        found = f"clip {k} from row {first[k]} on, {available[k]} rows"
        raise tables.broken(
            f"clips{layout.name}", "spans outside the rows of a field", found, f"{layout.n_rows} rows"
        )


def _read_windows(tables: _Tables, fields: tuple[Field, ...], n_clips: int) -> StoredWindows:
    clip, start, length, index = (tables.whole(f"windows/{name}") for name in ("clip", "start", "length", "index"))
    if ((clip < 0) | (clip >= n_clips)).any():
        raise tables.broken(
            "windows/clip", "windows of no such clip", f"{clip.min()} to {clip.max()}", f"0 to {n_clips - 1}"
        )
    by_start = np.lexsort((start, clip))
    clip_begin = np.searchsorted(clip[by_start], np.arange(n_clips + 1))
    rows = {f.name: tables.whole(f"windows/rows/{f.name}") for f in fields}
    return StoredWindows(clip, start, length, index, rows, by_start, clip_begin)
