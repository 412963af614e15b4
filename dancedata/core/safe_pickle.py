"""Reads foreign pickles without running anything foreign: numpy arrays and plain containers only."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.errors import DataError


class _NdarrayName:
    """Stands for numpy.ndarray in a pickle: can be named, not called (a call could ask for any memory)."""


def _reconstruct(kind: object, shape: object, code: object) -> np.ndarray[Any, Any]:
    if kind is not _NdarrayName or shape != (0,):
        raise pickle.UnpicklingError("an array is built in a way that numpy never writes")
    return np.empty((0,), dtype=np.int8)


def _frombuffer(buffer: Any, dtype: np.dtype[Any], shape: Any, order: Any) -> np.ndarray[Any, Any]:
    return np.frombuffer(buffer, dtype=dtype).reshape(shape, order=order)


def _scalar(dtype: np.dtype[Any], data: bytes) -> Any:
    if dtype.hasobject:
        raise pickle.UnpicklingError("a numpy scalar holds an object")
    return np.frombuffer(data, dtype=dtype, count=1)[0]


def _encode(text: str, encoding: str = "latin1") -> bytes:
    # Protocol 2 writes bytes as _codecs.encode(text, "latin1"); nothing else is needed of that function.
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError(f"text encoded as {encoding!r}")
    return text.encode("latin1")


_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _NdarrayName,
    ("numpy", "dtype"): np.dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): OrderedDict,
}
for _package in ("numpy.core", "numpy._core"):
    _ALLOWED[_package + ".multiarray", "_reconstruct"] = _reconstruct
    _ALLOWED[_package + ".multiarray", "scalar"] = _scalar
    _ALLOWED[_package + ".numeric", "_frombuffer"] = _frombuffer


class UnsafePickleError(pickle.UnpicklingError):
    """A pickle names something that is not on the allow-list."""


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Callable[..., Any]:
        try:
            found: Callable[..., Any] = _ALLOWED[module, name]
        except KeyError:
            raise UnsafePickleError(f"{module}.{name}") from None
        return found


def load_pickle(path: Path) -> Any:
    """Read a pickle of numpy arrays, numbers, text, lists, tuples, sets and dicts.

    Raises
    ------
    DataError
        "unsafe_pickle" if the file names anything else (which is not run); "broken_file" if it is truncated,
        is no pickle or cannot be read.
    """
    try:
        with open(path, "rb") as file:
            # latin1: pickles of Python 2 hold array bytes as text.
            return _Unpickler(file, encoding="latin1").load()
    except UnsafePickleError as error:
        raise DataError(
            "the pickle wants to run foreign code; nothing was run",
            reason="unsafe_pickle",
            where=path,
            found=str(error),
            allowed="numpy arrays and plain Python containers",
            fix="get the file again from its publisher, or save its arrays anew",
        ) from None
    except Exception as error:  # a broken pickle can raise anything: its bytes are a program
        raise DataError(
            "the pickle cannot be read",
            reason="broken_file",
            where=path,
            found=f"{type(error).__name__}: {error}",
            fix="get the file again: it is truncated or no pickle",
        ) from error
