"""Reads foreign pickles without running anything foreign: numpy arrays and plain containers only."""

from __future__ import annotations

import io
import math
import pickle
import struct
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dancedata.core.errors import DataError


class UnsafePickleError(pickle.UnpicklingError):
    """A pickle names something that is not on the allow-list."""


class _NdarrayName:
    """Stands for numpy.ndarray in a pickle: can be named, not called (a call could ask for any memory)."""

    def __new__(cls, *_: object) -> _NdarrayName:
        raise UnsafePickleError("numpy.ndarray, called")


def _reconstruct(kind: object, shape: object, code: object) -> np.ndarray[Any, Any]:
    if kind is not _NdarrayName or shape != (0,):
        raise pickle.UnpicklingError("an array is built in a way that numpy never writes")
    return np.empty((0,), dtype=np.int8)


def _dtype(code: object, align: object = False, copy: object = False) -> np.dtype[Any]:
    # A copy, for its byte order is set later. Records, subarrays and dates are not needed and too powerful.
    dtype: np.dtype[Any] = np.dtype(code if isinstance(code, str) else None, copy=True)
    if not isinstance(code, str) or dtype.kind not in "biufcSUO":
        raise pickle.UnpicklingError(f"arrays of type {code!r} are not read")
    return dtype


def _frombuffer(buffer: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray[Any, Any]:
    # Not of an array: that one could be filled anew and leave this one without its memory.
    if type(buffer) not in (bytes, bytearray) or not isinstance(dtype, np.dtype):
        raise pickle.UnpicklingError("an array is built in a way that numpy never writes")
    return np.frombuffer(buffer, dtype=dtype).reshape(shape, order=order)


def _scalar(dtype: Any, data: Any) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject:
        raise pickle.UnpicklingError("a numpy scalar holds an object")
    raw = data.encode("latin1") if isinstance(data, str) else data
    return np.frombuffer(raw, dtype=dtype, count=1)[0]


def _encode(text: str, encoding: str = "latin1") -> bytes:
    # Protocol 2 writes bytes as _codecs.encode(text, "latin1"); nothing else is needed of that function.
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError(f"text encoded as {encoding!r}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    # Protocol 2 writes b"" as bytes(); bytes(n) could ask for any memory.
    return b""


_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _NdarrayName,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): OrderedDict,
}
for _package in ("numpy.core", "numpy._core"):
    _ALLOWED[_package + ".multiarray", "_reconstruct"] = _reconstruct
    _ALLOWED[_package + ".multiarray", "scalar"] = _scalar
    _ALLOWED[_package + ".numeric", "_frombuffer"] = _frombuffer
for _package in ("builtins", "__builtin__"):
    _ALLOWED[_package, "set"] = set
    _ALLOWED[_package, "frozenset"] = frozenset
    _ALLOWED[_package, "bytes"] = _no_bytes


def _build(unpickler: Any) -> None:
    """Set the state of an array or a dtype, if it is a state that numpy writes.

    numpy believes what it is given: a dtype said to hold no objects makes pointers of the bytes of a file.
    """
    state = unpickler.stack.pop()
    target = unpickler.stack[-1]
    if isinstance(target, np.dtype) and isinstance(state, tuple):
        plain = np.dtype(target.str).__reduce__()[2]
        good = (
            len(state) == len(plain)
            and state[1] in ("<", ">", "|", "=")
            and (state[0], *state[2:]) == (3, *plain[2:])
        )
    elif isinstance(target, np.ndarray) and isinstance(state, tuple) and len(state) == 5:
        _, shape, dtype, _, data = state
        good = target.shape == (0,) and isinstance(dtype, np.dtype)
        # numpy makes room for the shape before it looks how many objects there are.
        good = good and (not isinstance(data, list) or math.prod(shape) == len(data))
    else:
        raise UnsafePickleError(f"the state of a {type(target).__name__}")
    if not good:
        raise pickle.UnpicklingError("an array is built in a way that numpy never writes")
    target.__setstate__(state)


def _bytearray8(unpickler: Any) -> None:
    # Python's own makes room for the announced size before it reads.
    (size,) = struct.unpack("<Q", unpickler.read(8))
    unpickler.append(bytearray(unpickler.read(size)))


def _extension(unpickler: Any) -> None:
    raise UnsafePickleError("an extension code")


class _Unpickler(pickle._Unpickler):
    """Python's unpickler in Python: only there can the state that a pickle sets be checked."""

    dispatch: ClassVar[dict[int, Any]] = {
        **pickle._Unpickler.dispatch,
        pickle.BUILD[0]: _build,
        pickle.BYTEARRAY8[0]: _bytearray8,
        **{code[0]: _extension for code in (pickle.EXT1, pickle.EXT2, pickle.EXT4)},
    }

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
        # From memory, where a size that the pickle announces is no reason to make room for it.
        # latin1: pickles of Python 2 hold array bytes as text.
        return _Unpickler(io.BytesIO(path.read_bytes()), encoding="latin1").load()
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
