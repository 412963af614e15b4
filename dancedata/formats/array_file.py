"""What all files of arrays have in common: names, shapes, values as float64, and the errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.text import listed, quoted, shown

__all__ = ["NUMBERS", "Array", "ArrayFile", "as_numbers", "at", "broken", "not_numbers", "text_of", "too_large"]

#: Kinds of dtypes that are read as numbers.
NUMBERS = "fiu"

Array = NDArray[Any]


class ArrayFile:
    """Named arrays of a file; an .npy file and a pickled array have the single name "".

    Attributes
    ----------
    names : all names in the file, whether or not they hold numbers.
    """

    def __init__(self, path: Path, names: tuple[str, ...]) -> None:
        self.path = path
        self.names = names

    @property
    def listed(self) -> str:
        """The first names, for messages."""
        return listed(self.names, 20, quoted) or "none"

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array of numbers, from its header. DataError if it does not hold numbers."""
        raise NotImplementedError

    def read(self, name: str) -> NDArray[np.float64]:
        """Return an array of numbers as float64. DataError if it does not hold numbers."""
        raise NotImplementedError

    def text(self, name: str) -> str:
        """Return a short text such as a gender, "True" or "False" for a truth value; "" for any other entry."""
        raise NotImplementedError


def text_of(array: Array) -> str:
    """Return the text of an array of one text, "True" or "False" for one truth value; "" for any other."""
    if array.size != 1 or array.dtype.kind not in "USb":
        return ""
    try:
        value = array.reshape(-1)[0]
    except ValueError:  # code points outside Unicode
        return ""
    return value.decode("latin1") if isinstance(value, bytes) else str(value)


def as_numbers(array: Array) -> NDArray[np.float64]:
    """Return an array of numbers as float64."""
    with np.errstate(over="ignore", invalid="ignore"):  # of long doubles; the caller reports infinite values
        return array.astype(np.float64)


def at(path: Path, name: str) -> str:
    """Return the place of an array, for messages."""
    return f"{path}, {shown(name)}" if name else str(path)


def broken(path: Path, found: str) -> DataError:
    """Return the DataError for a file that is not as numpy writes it."""
    return DataError(
        "the motion file cannot be read",
        reason="broken_file",
        where=str(path),
        found=found,
        allowed="an .npy, .npz or .pkl file as numpy writes it",
        fix="copy or save the file again",
    )


def not_numbers(path: Path, name: str, found: str) -> DataError:
    """Return the DataError for something other than an array of numbers."""
    return DataError(
        "not an array of numbers",
        reason="bad_shape",
        where=at(path, name),
        found=found,
        allowed="floats or integers",
        fix="save the motion as an array",
    )


def too_large(path: Path, found: str, allowed: str) -> DataError:
    """Return the DataError for an array, or a file, above its limit."""
    return DataError(
        "the array is larger than the limit",
        reason="too_large",
        where=str(path),
        found=found,
        allowed=allowed,
        fix="split the motion into several files, uncompressed",
    )
