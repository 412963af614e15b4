"""Writes one shard, clip by clip; a thread loads the next array while one is checked and written."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.codebook import Codebook
from dancedata.core.errors import StoreError
from dancedata.files.atomic import atomic_file
from dancedata.store import hdf5
from dancedata.store.hdf5 import SparseFile
from dancedata.store.schema import FORMAT, Field
from dancedata.store.shard_plan import ShardPlan
from dancedata.store.stored_clip import LazyArray

#: Values converted and checked at a time.
_CHUNK_VALUES = 1 << 18


@contextmanager
def written_shard(out: Path, plan: ShardPlan, progress: Callable[[], None]) -> Iterator[None]:
    """Write a shard; leaving the context flushes and renames it, which another thread may do."""
    layout = SparseFile()
    with hdf5.create_file(layout) as file:
        hdf5.write_attributes(file, format=FORMAT, split=plan.split, fps=str(plan.header.fps))
        offsets = {f.name: _make_field(file, plan, f) for f in plan.header.fields}
        plan.first_bytes = offsets
    with atomic_file(out / plan.file) as temporary:
        with open(temporary, "wb") as target:
            layout.copy_to(target)
            target.flush()
            _write_fields(target.fileno(), plan, offsets, progress)
        yield


def _make_field(file: Any, plan: ShardPlan, f: Field) -> int:
    dataset = hdf5.create_dataset(file, f.path, (plan.rows[f.name], f.columns.width), f.disk_dtype)
    hdf5.write_attributes(dataset, rate=str(f.rate))
    return int(dataset.id.get_offset() or 0)


@dataclass(frozen=True)
class _Piece:
    """Rows to be written: number of their clip, field, first row in the field, and the array that has them."""

    clip: int
    field: Field
    first: int
    array: LazyArray
    where: str


def _write_fields(file: int, plan: ShardPlan, offsets: Mapping[str, int], progress: Callable[[], None]) -> None:
    done = 0
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="loading") as loading:
        for piece, array in _loaded_ahead(loading, _pieces(plan)):
            while done < piece.clip:
                done += 1
                progress()
            offset = offsets[piece.field.name] + piece.first * piece.field.row_bytes
            for rows in _checked_rows(array, piece):
                _write_at(file, rows.data.cast("B"), offset)
                offset += rows.nbytes
            del array
    while done < len(plan.clips):
        done += 1
        progress()


def _pieces(plan: ShardPlan) -> Iterator[_Piece]:
    """Yield the parts of each clip to write; shared parts are written with the first clip."""
    written: dict[str, set[str]] = {name: set() for name in plan.blocks}
    for number, clip in enumerate(plan.clips):
        for f in plan.header.fields:
            where = f"clip {clip.id}, field {f.name}"
            if f.per_clip:
                yield _Piece(number, f, plan.spans[f.name][number].start, clip.motion[f.name], where)
                continue
            block = clip.audio[f.name]
            if block.key not in written[f.name]:
                written[f.name].add(block.key)
                yield _Piece(number, f, plan.blocks[f.name][block.key][0], block.array, where)


def _loaded_ahead(loading: Executor, pieces: Iterable[_Piece]) -> Iterator[tuple[_Piece, npt.NDArray[Any]]]:
    each = ((piece, loading.submit(np.asarray, piece.array)) for piece in pieces)
    begun = next(each, None)
    while begun is not None:
        piece = begun[0]
        try:
            array = begun[1].result()
        except OSError as error:
            raise StoreError("an array cannot be read", where=piece.where, found=str(error)) from error
        # Drop the future: only the caller then refers to the array.
        begun = None
        begun = next(each, None)
        yield piece, array
        del array


def _write_at(file: int, data: memoryview, offset: int) -> None:
    while data:
        n = os.pwrite(file, data, offset)
        data, offset = data[n:], offset + n


def _checked_rows(array: npt.NDArray[Any], piece: _Piece) -> Iterator[npt.NDArray[Any]]:
    """Yield the rows of a piece as they are stored, some at a time."""
    f, where, shape = piece.field, piece.where, piece.array.shape
    if array.shape != tuple(shape):
        raise StoreError(
            "an array does not have the shape that it reported", where=where, found=array.shape, allowed=shape
        )
    if array.dtype.kind not in "fiub":
        raise StoreError("an array does not hold real numbers", where=where, found=str(array.dtype))
    if f.codebook is not None:
        _check_codes(array, f, f.codebook, where)
    step = max(1, _CHUNK_VALUES // f.columns.width)
    for begin in range(0, len(array), step):
        chunk = array[begin : begin + step]
        with np.errstate(over="ignore"):
            stored = np.ascontiguousarray(chunk, dtype=f.disk_dtype)
        if not np.isfinite(stored).all():
            _raise_not_finite(chunk, stored, begin, f, where)
        yield stored


def _check_codes(rows: npt.NDArray[Any], f: Field, codebook: Codebook, where: str) -> None:
    bad = (rows != codebook.pad) & ((rows < 0) | (rows >= np.array(codebook.sizes)) | (rows != np.trunc(rows)))
    if bad.any():
        row, column = (int(i) for i in np.argwhere(bad)[0])
        raise StoreError("a code is not in its codebook",
                         where=f"{where}, row {row}, column {f.columns.labels[column]}", found=rows[row, column],
                         allowed=f"0 to {codebook.sizes[column] - 1}, or {codebook.pad} for none")  # fmt: skip


def _raise_not_finite(chunk: npt.NDArray[Any], stored: npt.NDArray[Any], begin: int, f: Field, where: str) -> None:
    row, column = (int(i) for i in np.argwhere(~np.isfinite(stored))[0])
    value = chunk[row, column]
    where = f"{where}, row {begin + row}, column {f.columns.labels[column]}"
    if np.isfinite(value):
        raise StoreError(f"a value does not fit {f.dtype}", where=where, found=float(value),
                         allowed=f"at most {float(np.finfo(f.dtype).max):g} in size",
                         fix="store the field as float32" if f.dtype == "float16" else None)  # fmt: skip
    raise StoreError(
        "a value is not finite", where=where, found=float(value), fix="leave the clip out, or repair its file"
    )
