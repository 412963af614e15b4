"""Arrays in files of any kind, and the values of pickles, files of joblib and torch and numpy's arrays of objects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.text import shown
from dancedata.core.typing import override
from dancedata.files.regular_file import open_regular
from dancedata.formats.arrays import (
    NUMBERS,
    Array,
    ArrayFile,
    NpyFile,
    as_numbers,
    broken,
    not_numbers,
    open_npz,
    read_header,
    reading,
    text_of,
)
from dancedata.formats.safe_pickle import MAX_PICKLE_BYTES, as_array, load_pickle
from dancedata.formats.torch_file import TORCH_HEADS, load_torch

#: Names of pickles, files of joblib.dump and files of torch.save; each is recognised by its content.
VALUE_SUFFIXES = (".pkl", ".pk", ".joblib", ".pt", ".pth")
#: Motion files that are read, in order of preference.
MOTION_SUFFIXES = (".npz", ".npy", ".pkl", ".bvh", *VALUE_SUFFIXES[1:])


@contextmanager
def open_arrays(path: Path) -> Iterator[ArrayFile]:
    """Open a file by its suffix, any but .npz and VALUE_SUFFIXES as .npy; DataError if it cannot be read."""
    kind = path.suffix.lower()
    if holds_values(path):
        yield ValueArrays(path, load_values(path))
    elif kind == ".npz":
        with open_npz(path) as arrays:
            yield arrays
    else:
        yield NpyFile(path)


def holds_values(path: Path) -> bool:
    """Return whether a file holds a pickle: one of VALUE_SUFFIXES, or numpy's with a dict in an array of objects."""
    kind = path.suffix.lower()
    try:
        if kind == ".npz":
            with open_npz(path) as arrays:
                return arrays.holds_objects
        if kind == ".npy":
            with reading(path), open_regular(path) as file:
                return read_header(path, file).dtype.hasobject
    except DataError:
        return False  # reading gives the error
    return kind in VALUE_SUFFIXES


def load_values(path: Path) -> object:
    """Return the content of a pickle, a file of joblib or torch, or numpy's objects, lists of dicts by number."""
    size = path.stat().st_size if path.is_file() else 0
    if size > MAX_PICKLE_BYTES:
        raise DataError(
            "the file is larger than the limit",
            reason="too_large",
            where=str(path),
            found=f"{size:,} bytes",
            allowed=f"at most {MAX_PICKLE_BYTES:,}",
            fix="save it without what is not the motion, such as WHAM's verts, or run the program on shorter videos",
        )
    kind = path.suffix.lower()
    if kind == ".npz":
        with open_npz(path) as arrays:
            found = {name: _unboxed(value) for name, value in arrays.values().items()}
        inner = [value for value in found.values() if isinstance(value, Mapping)]
        return inner[0] if len(inner) == 1 else found
    if kind == ".npy":
        with reading(path), open_regular(path) as file:
            return _unboxed(load_pickle(path, start=read_header(path, file).start))
    return _unboxed(load_torch(path) if _is_torch(path) else load_pickle(path))


def _unboxed(value: object) -> object:
    """Return what an array of one object holds; of several dicts a dict by their numbers."""
    while isinstance(value, np.ndarray) and value.dtype.hasobject and value.size == 1:
        value = value.reshape(-1)[0]
    several = value.reshape(-1).tolist() if isinstance(value, np.ndarray) and value.dtype.hasobject else value
    if isinstance(several, list | tuple) and several and all(isinstance(one, Mapping) for one in several):
        return {str(number): one for number, one in enumerate(several)}
    return value


def load_object(path: Path) -> object:
    """Return the object in an .npy file with an array () of objects, as numpy.save(file, {...}) writes it."""
    with reading(path), open_regular(path) as file:
        header = read_header(path, file)
    if header.shape != () or not header.dtype.hasobject:
        raise DataError("the file does not hold a dict", reason="bad_shape", where=str(path),
                        found=f"an array {header.shape} of {header.dtype}",
                        allowed="an .npy file as numpy.save writes it for a dict: an array () of objects",
                        fix="save the motion as a dict, or download the file again")  # fmt: skip
    cell = load_pickle(path, start=header.start)
    if not isinstance(cell, np.ndarray) or cell.shape != () or cell.dtype != object:
        raise broken(path, f"a pickle of {type(cell).__name__}")
    return cell[()]


def _is_torch(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(20).startswith(TORCH_HEADS)
    except OSError:
        return False  # load_pickle gives the error


class ValueArrays(ArrayFile):
    """The named values of a container; one that has no names is itself the value ""."""

    def __init__(self, path: Path, content: object) -> None:
        if not isinstance(content, Mapping):
            content = {"": content}
        self._content = {name: value for name, value in content.items() if isinstance(name, str)}
        super().__init__(path, tuple(self._content))

    @override
    def shape(self, name: str) -> tuple[int, ...]:
        return self._array(name).shape

    @override
    def read(self, name: str) -> NDArray[np.float64]:
        return as_numbers(self._array(name))

    @override
    def text(self, name: str) -> str:
        value = self._content[name]
        if isinstance(value, bytes):
            return value[:20].decode("latin1")
        if isinstance(value, str | bool):
            return str(value)[:20]
        return text_of(np.asarray(value)) if isinstance(value, np.ndarray | np.generic) else ""

    @override
    def texts(self, name: str) -> tuple[str, ...]:
        value = self._content[name]
        items = value.tolist() if isinstance(value, np.ndarray) and value.ndim == 1 and value.size < 1000 else value
        texts = isinstance(items, list | tuple) and len(items) < 1000 and all(isinstance(item, str) for item in items)
        return tuple(items) if texts else ()  # type: ignore[arg-type]

    def _array(self, name: str) -> Array:
        if name not in self._content:
            raise not_numbers(self.path, name, f"named values {self.listed}")
        array = as_array(self._content[name])
        if array is None:
            value = self._content[name]
            raise not_numbers(self.path, name, f"{type(value).__name__}, {shown(value)}")
        if array.dtype.kind not in NUMBERS:
            raise not_numbers(self.path, name, f"dtype {array.dtype}")
        return array
