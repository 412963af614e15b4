"""The one place that opens HDF5 files. h5py ships no types, so its objects are Any from here on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.store.schema import ALIGNMENT
from dancedata.store.sparse_file import SparseFile


@contextmanager
def create_file(target: SparseFile) -> Iterator[Any]:
    """Make an HDF5 file whose bytes depend on its content only: pinned versions, no times, aligned data."""
    with h5py.File(
        target,
        "w",
        libver=("earliest", "v110"),
        track_order=False,
        alignment_threshold=1,
        alignment_interval=ALIGNMENT,
    ) as file:
        yield file


@contextmanager
def open_file(path: Path) -> Iterator[Any]:
    """Open a shard for reading, without file locks (network file systems).

    Raises
    ------
    StoreError
        If it is no HDF5 file, or lacks something that is asked for.
    """
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except FileNotFoundError as error:
        raise StoreError("a shard is missing", where=str(path), fix="build the dataset again") from error
    except (OSError, KeyError, RuntimeError) as error:
        raise StoreError(
            "a shard cannot be read",
            where=str(path),
            found=str(error),
            fix="run dancedata check on the dataset",
        ) from error


def create_dataset(group: Any, name: str, shape: tuple[int, ...], dtype: Any) -> Any:
    """Make a contiguous dataset whose place in the file is settled at once; nothing is written to it yet."""
    options = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    options.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    options.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    options.set_obj_track_times(False)
    return group.create_dataset(name, shape=shape, dtype=dtype, dcpl=options)


def write_array(group: Any, name: str, array: npt.NDArray[Any]) -> None:
    """Write a whole numeric array, little-endian."""
    dataset = create_dataset(group, name, array.shape, array.dtype.newbyteorder("<"))
    if array.size:
        dataset[...] = array


def write_strings(group: Any, name: str, texts: list[str]) -> None:
    """Write texts as fixed-length UTF-8, padded with NUL."""
    raw = [t.encode() for t in texts]
    dtype = h5py.string_dtype("utf-8", max([1, *map(len, raw)]))
    dataset = create_dataset(group, name, (len(raw),), dtype)
    if raw:
        dataset[...] = np.array(raw, dtype=dtype)


def write_text_attribute(item: Any, name: str, text: str) -> None:
    """Write one fixed-length UTF-8 attribute."""
    raw = text.encode()
    item.attrs.create(name, np.array(raw, dtype=h5py.string_dtype("utf-8", max(1, len(raw)))))


def read_strings(dataset: Any) -> list[str]:
    """Read what `write_strings` wrote."""
    return [raw.decode() for raw in dataset[...].tolist()]
