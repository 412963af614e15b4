"""Arrays that lie in nested containers, as pickles, joblib's and torch's files have them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.regular_file import open_regular
from dancedata.core.text import shown
from dancedata.formats.array_file import NUMBERS, Array, ArrayFile, as_numbers, not_numbers, text_of
from dancedata.formats.safe_pickle import MAX_PICKLE_BYTES, as_array, load_pickle
from dancedata.formats.torch_file import TORCH_HEAD, load_torch

__all__ = ["ValueArrays", "load_values"]


def load_values(path: Path) -> object:
    """Return the content of a pickle, a file of joblib.dump or one of torch.save, whatever its name.

    Raises
    ------
    DataError
        ``broken_file``, ``unsafe_pickle``, ``too_large``.
    """
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
    return load_torch(path) if _is_torch(path) else load_pickle(path)


def _is_torch(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(len(TORCH_HEAD)) == TORCH_HEAD
    except OSError:
        return False  # load_pickle gives the error


class ValueArrays(ArrayFile):
    """The named values of a container; one that has no names is itself the value "".

    Parameters
    ----------
    content : of the file, or of a part of it.
    """

    def __init__(self, path: Path, content: object) -> None:
        if not isinstance(content, Mapping):
            content = {"": content}
        self._content = {name: value for name, value in content.items() if isinstance(name, str)}
        super().__init__(path, tuple(self._content))

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array of numbers."""
        return self._array(name).shape

    def read(self, name: str) -> NDArray[np.float64]:
        """Return an array of numbers as float64."""
        return as_numbers(self._array(name))

    def text(self, name: str) -> str:
        """See `ArrayFile.text`."""
        value = self._content[name]
        if isinstance(value, bytes):
            return value[:20].decode("latin1")
        if isinstance(value, str | bool):
            return str(value)[:20]
        return text_of(np.asarray(value)) if isinstance(value, np.ndarray | np.generic) else ""

    def _array(self, name: str) -> Array:
        array = as_array(self._content[name])
        if array is None:
            value = self._content[name]
            raise not_numbers(self.path, name, f"{type(value).__name__}, {shown(value)}")
        if array.dtype.kind not in NUMBERS:
            raise not_numbers(self.path, name, f"dtype {array.dtype}")
        return array
