"""Reads the rows of one shard, by position or from the mapped file.

Rows of a field are one piece of the file: threads and processes read them at the same time, without an HDF5 handle.
"""

from __future__ import annotations

import logging
import mmap
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.core.system import read_ahead
from dancedata.store import hdf5
from dancedata.store.dataset_json import ShardEntry
from dancedata.store.listed_file import FileHash, ListedFile
from dancedata.store.schema import Field
from dancedata.store.window_list import Ints

_log = logging.getLogger(__name__)
_CHECK = "run dancedata check on the dataset"


class WindowRows:
    """Rows of a field for the windows of a list, (rows, D) each; any number of threads may read."""

    def __init__(
        self, field: str, shards: Sequence[ShardReader], shard: Ints, first: Ints, n_rows: int, mapped: bool
    ) -> None:
        """Map the shards, or read by position; `shard` (W,) are the numbers of the windows' shards in `shards`."""
        self._field, self._shards = field, shards
        self._shard, self._first, self._n_rows = shard, first, n_rows
        layouts = [reader.layout(field) for reader in shards]
        self.shape = n_rows, layouts[0].width
        self.dtype = layouts[0].dtype.newbyteorder("=")
        self._maps: list[npt.NDArray[Any] | None] = [None] * len(shards)
        #: Shards that are mapped when they are first read: those of an address are fetched then.
        self._unopened = {number for number, reader in enumerate(shards) if mapped}
        for number in [number for number in self._unopened if shards[number].is_there]:
            self._map(number)
        # A field that fits into memory is read from the disk once, a larger one again and again.
        n_bytes = sum(layout.n_rows * layout.row_bytes for layout in layouts)
        self._fits = n_bytes < os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
        self._seen = np.zeros(len(shard), dtype=np.bool_)

    def read(self, place: int, out: npt.NDArray[Any], shift: int = 0) -> npt.NDArray[Any]:
        """Return a window's rows, read-only from the mapped file; else `out`, (rows, D), which they are read into.

        `shift` moves the window by this many rows; the caller makes sure that the clip has them.
        """
        number, first = self._shard[place], self._first[place] + shift
        rows = self._maps[number]
        if rows is None:
            rows = self._map(int(number))
        if rows is None:
            self._shards[number].read_rows(self._field, int(first), out)
            return out
        rows_of_shard: npt.NDArray[Any] = rows[first : first + self._n_rows]
        return rows_of_shard

    def _map(self, number: int) -> npt.NDArray[Any] | None:
        """Map a shard that was not opened before; None if it cannot be."""
        if number not in self._unopened:
            return self._maps[number]
        self._maps[number] = self._shards[number].mapped_rows(self._field)
        self._unopened.discard(number)
        return self._maps[number]

    def read_ahead(self, places: Sequence[int]) -> None:
        """Ask the system for the next windows, each only once if the field fits into half of the memory."""
        for place in places:
            number = self._shard[place]
            if self._maps[number] is not None and self._fits and self._seen[place]:
                continue
            self._seen[place] = True
            self._shards[number].read_ahead(self._field, int(self._first[place]), self._n_rows)

    def require_unchanged(self, places: Sequence[int], *, again: bool = False) -> None:
        """Raise StoreError if a mapped file was written to since it was opened: rows may be those of two datasets.

        `again`: whether this is asked before they are read; where a file was cut off, reading would end the process.
        """
        for number in {int(self._shard[place]) for place in places}:
            if self._maps[number] is not None:
                self._shards[number].file.require_unchanged(again=again)


@dataclass(frozen=True)
class FieldLayout:
    """Place of a field's rows in a shard, from a byte on."""

    offset: int
    n_rows: int
    width: int
    dtype: np.dtype[Any]
    name: str

    @property
    def row_bytes(self) -> int:
        """Bytes of one row."""
        return self.width * self.dtype.itemsize


class ShardReader:
    """One shard of an open store, safe under threads and fork; holds at most one file descriptor, opened late."""

    def __init__(self, file: ListedFile, entry: ShardEntry, fields: tuple[Field, ...]) -> None:
        self.path = file.path
        self.n_clips = entry.clips
        self.file, self._entry, self._fields = file, entry, fields
        self._layout: dict[str, FieldLayout] = {}
        self._is_checked = False
        self._file: _File | None = None
        self._map: _Map | None = None

    @property
    def is_there(self) -> bool:
        """Whether the file is on the disk, or missing and not fetched."""
        return self.path.exists() or not self.file.is_fetched

    def layout(self, field: str) -> FieldLayout:
        """Return the place of a field's rows in the file."""
        if not self._layout:
            self._layout = {f.name: self._stated_layout(f) for f in self._fields}
        return self._layout[field]

    def _stated_layout(self, f: Field) -> FieldLayout:
        first, n_rows = self._entry.fields[f.name]
        layout = FieldLayout(first, n_rows, f.columns.width, f.disk_dtype, f"/{f.path}")
        if first + n_rows * layout.row_bytes > self._entry.size:
            raise _too_short(self.path, first + n_rows * layout.row_bytes - self._entry.size, self._entry.size)
        return layout

    def require_layout(self) -> None:
        """Raise StoreError, when the file is first opened, where fields do not lie as dataset.json states."""
        if self._is_checked:
            return
        with self.opened() as file:
            for f in self._fields:
                actual, stated = _field_layout(file, f, self.path), self.layout(f.name)
                if stated.n_rows and stated != actual:
                    lies, allowed = (f"{of.n_rows} rows from byte {of.offset} on" for of in (actual, stated))
                    where, problem = f"{self.path}, {actual.name}", "a field does not lie where dataset.json states"
                    raise StoreError(problem, where=where, found=lies, allowed=allowed, fix=_CHECK)
        self._is_checked = True

    def read_rows(self, field: str, first: int, out: npt.NDArray[Any]) -> None:
        """Read rows [first, first + len(out)) of a field into `out`, (rows, D), converting to its dtype."""
        layout = self.layout(field)
        if first < 0 or first + len(out) > layout.n_rows:
            where, rows = f"{self.path}, field {field}", f"rows {first} to {first + len(out)} of {layout.n_rows}"
            raise StoreError("rows lie outside the shard", where=where, found=rows, fix=_CHECK)
        direct = out.dtype == layout.dtype and out.flags.c_contiguous and out.flags.writeable
        target = out if direct else np.empty((len(out), layout.width), dtype=layout.dtype)
        if target.size:
            self._open().read_into(memoryview(target.data).cast("B"), layout.offset + first * layout.row_bytes)
        if not direct:
            out[...] = target

    def rows(self, field: str, first: int, n: int) -> npt.NDArray[Any]:
        """Return n rows of a field, a new array of the stored type."""
        layout = self.layout(field)
        out = np.empty((n, layout.width), dtype=layout.dtype)
        self.read_rows(field, first, out)
        return out

    def mapped_rows(self, field: str) -> npt.NDArray[Any] | None:
        """Return all rows of a field, (n_rows, D), as a read-only view of the mapped file; None if it cannot be."""
        layout = self.layout(field)
        if self._map is None:
            try:
                self._map = _Map(self.file)
            except (OSError, ValueError) as error:
                _log.warning("%s is read by position, as it cannot be mapped: %s", self.path.name, error)
                return None
        rows = self._map.rows(layout)
        self.require_layout()
        return rows

    def read_ahead(self, field: str, first: int, n_rows: int) -> None:
        """Ask the system to read rows of a mapped field from the disk; returns at once."""
        layout = self.layout(field)
        if self._map is not None:
            self._map.read_ahead(layout.offset + first * layout.row_bytes, n_rows * layout.row_bytes)

    def require_bytes(self, sha256: FileHash) -> None:
        """Raise StoreError unless the shard has the bytes that dataset.json lists."""
        self.file.require_bytes(sha256)

    def close(self) -> None:
        """Release file descriptor and mapping; a later read opens the file again."""
        self._file = None
        self._map = None

    def _open(self) -> _File:
        file = self._file
        # A forked child opens the file again: the inherited descriptor belongs to the parent.
        if file is None or file.pid != os.getpid():
            file = _File(self.file)
            self.require_layout()
            self._file = file
        return file

    @contextmanager
    def opened(self) -> Iterator[Any]:
        """Open the shard through h5py."""
        self.file.ensure_local()
        with hdf5.open_file(self.path, self.file.require) as file:
            yield file


class _File:
    def __init__(self, file: ListedFile) -> None:
        self.path = file.path
        self.pid = os.getpid()
        self._descriptor = -1
        self._listed, self._descriptor = file, file.open()

    def read_into(self, view: memoryview, position: int) -> None:
        """Fill `view` with the bytes from `position` on."""
        while view.nbytes:
            n = os.preadv(self._descriptor, [view], position)
            if n == 0:
                raise _too_short(self.path, view.nbytes, position)
            view, position = view[n:], position + n
        self._listed.require_unchanged()

    def __del__(self, close: Callable[[int], None] = os.close) -> None:  # at the interpreter's end `os` is gone
        if self._descriptor >= 0:
            close(self._descriptor)


class _Map:
    """A whole file mapped read-only. A forked child can use it; other processes share its memory."""

    def __init__(self, file: ListedFile) -> None:
        self.path = file.path
        descriptor = file.open()
        try:
            self._memory = mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
        finally:
            os.close(descriptor)

    def rows(self, layout: FieldLayout) -> npt.NDArray[Any]:
        count, offset = layout.n_rows * layout.width, layout.offset
        missing = offset + layout.n_rows * layout.row_bytes - len(self._memory)
        if missing > 0:
            raise _too_short(self.path, missing, len(self._memory))
        rows = np.frombuffer(self._memory, dtype=layout.dtype, count=count, offset=offset)
        return rows.reshape(layout.n_rows, layout.width)

    def read_ahead(self, position: int, n_bytes: int) -> None:
        read_ahead(self._memory, position, n_bytes)


def _too_short(path: Path, missing: int, position: int) -> StoreError:
    actual = f"{missing} bytes missing at byte {position}"
    return StoreError("a shard ends too early", where=str(path), found=actual, fix=_CHECK)


def _field_layout(file: Any, f: Field, path: Path) -> FieldLayout:
    name = f"/{f.path}"
    dataset = hdf5.find_dataset(file, name)
    if dataset.ndim != 2 or dataset.shape[1] != f.columns.width or dataset.dtype != f.disk_dtype:
        raise StoreError("the shape or dtype of a field differs from dataset.json", where=f"{path}, {name}",
                         found=f"{dataset.shape} {dataset.dtype}",
                         allowed=f"(rows, {f.columns.width}) {f.disk_dtype}")  # fmt: skip
    offset = dataset.id.get_offset() if dataset.size else 0
    return FieldLayout(offset, int(dataset.shape[0]), int(dataset.shape[1]), f.disk_dtype, name)
