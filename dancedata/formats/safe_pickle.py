"""Reads untrusted pickles without executing them: numpy arrays and plain containers only.

A pickle is a program, and its result can be far larger, deeper or slower to traverse than its bytes suggest. All
opcodes that build anything are therefore replaced by checked ones (`checked_unpickler`), and the result satisfies:

- Keys and members of sets are texts and small integers.
- Containers are nested at most MAX_DEPTH deep, and none contains itself.
- The total size of what calls build (arrays, bytes, sets) is not much larger than the file.

A list can still occur so many times in the result that expanding it fills any memory: `as_array` accepts no nested
lists, and messages show values by `core.text.shown`, which does not expand them.
"""

from __future__ import annotations

import io
import math
import pickle
import struct
from collections import OrderedDict
from collections.abc import Callable, Iterable
from pathlib import Path
from types import FunctionType
from typing import Any, ClassVar

import numpy as np

from dancedata.core.errors import DataError
from dancedata.core.regular_file import read_regular
from dancedata.core.text import shown
from dancedata.formats.checked_unpickler import (
    CheckedUnpickler,
    UnsafePickleError,
    frozen_set,
    invalid,
    mutable_set,
    ordered_dict,
)

__all__ = ["MAX_DEPTH", "MAX_PICKLE_BYTES", "as_array", "load_pickle"]

MAX_PICKLE_BYTES = 1 << 29
MAX_DEPTH = 100
#: Containers of one file: each takes a byte of it and up to 216 of memory.
MAX_CONTAINERS = 100_000
_MAX_DIMENSIONS = 32
#: Calls may build this many times the size of the file, plus a constant. Protocol 2 stores the bytes of an array as
#: text, which is encoded to bytes and then copied.
_BUILT_FACTOR, _BUILT_BYTES = 2, 1 << 16


_INVALID_ARRAY = "an array is built in a way that numpy never writes"


class _NdarrayName:
    """Placeholder for numpy.ndarray: may be named but not called, as a call could allocate any amount of memory."""


def _reconstruct(kind: object, shape: object, code: object) -> np.ndarray[Any, Any]:
    if kind is not _NdarrayName or type(shape) is not tuple or shape != (0,):
        raise invalid(_INVALID_ARRAY)
    return np.empty((0,), dtype=np.int8)


def _dtype(code: object, align: object = False, copy: object = False) -> np.dtype[Any]:
    # Long codes describe structured dtypes, which numpy takes seconds to parse.
    if type(code) is not str or len(code) > 20:
        raise invalid(f"an array of type {shown(code)}")
    # A copy, because its byte order is set later. Structured dtypes, subarrays and dates are not needed.
    dtype: np.dtype[Any] = np.dtype(code, copy=True)
    if dtype.kind not in "biufcSUO":
        raise invalid(f"arrays of type {shown(code)} are not read")
    return dtype


def _frombuffer(buffer: Any, dtype: Any, shape: Any, order: Any, axes: Any = None) -> np.ndarray[Any, Any]:
    # Not of an array: its buffer could be replaced later, which would leave this array dangling.
    plain = type(buffer) in (bytes, bytearray) and isinstance(dtype, np.dtype) and type(order) is str
    if not plain or not _is_shape(shape) or not (order in ("C", "F") or (order == "K" and _is_shape(axes))):
        raise invalid(_INVALID_ARRAY)
    array = np.frombuffer(buffer, dtype=dtype)
    # numpy 2.3 and later: an array whose axes are permuted in memory.
    return array.reshape(shape).transpose(axes) if order == "K" else array.reshape(shape, order=order)


def _scalar(dtype: Any, data: Any) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject or type(data) not in (bytes, str):
        raise invalid("a numpy scalar that numpy never writes")
    raw = data.encode("latin1") if isinstance(data, str) else data
    return np.frombuffer(raw, dtype=dtype, count=1)[0]


def _encode(text: object, encoding: object = "latin1") -> bytes:
    # Protocol 2 writes bytes as _codecs.encode(text, "latin1"), the only call that is needed.
    if type(text) is not str or type(encoding) is not str or encoding not in ("latin1", "latin-1"):
        raise invalid(f"a {type(text).__name__} encoded as {shown(encoding)}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    # Protocol 2 writes b"" as bytes(); bytes(n) could allocate any amount of memory.
    return b""


_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _NdarrayName,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): ordered_dict,
}
for _package in ("numpy.core", "numpy._core"):
    _ALLOWED[_package + ".multiarray", "_reconstruct"] = _reconstruct
    _ALLOWED[_package + ".multiarray", "scalar"] = _scalar
    _ALLOWED[_package + ".numeric", "_frombuffer"] = _frombuffer
for _package in ("builtins", "__builtin__"):
    _ALLOWED[_package, "set"] = mutable_set
    _ALLOWED[_package, "frozenset"] = frozen_set
    _ALLOWED[_package, "bytes"] = _no_bytes


def _is_shape(shape: object) -> bool:
    """Whether it can be an array's shape: its product is then a number of bounded size."""
    if type(shape) is not tuple or len(shape) > _MAX_DIMENSIONS:
        return False
    return all(type(n) is int and 0 <= n <= MAX_PICKLE_BYTES for n in shape)


# The handlers of opcodes; each takes the unpickler.


def _call(unpickler: Any) -> None:
    """Call a function of the allow-list, and count the size of its result."""
    arguments = unpickler.stack.pop()
    function = unpickler.stack[-1]
    # find_class returns functions only, except for _NdarrayName.
    if not isinstance(function, FunctionType) or type(arguments) is not tuple:
        raise UnsafePickleError(f"{'numpy.ndarray' if function is _NdarrayName else shown(function)}, called")
    result = function(*arguments)
    if isinstance(result, np.ndarray | np.generic):
        unpickler.count_built(result.nbytes)
        if function is _reconstruct:
            unpickler.unfinished[id(result)] = result
    elif not isinstance(result, np.dtype):
        unpickler.count_built(len(result))
    unpickler.stack[-1] = result


def _build(unpickler: Any) -> None:
    """Set the state of an array or a dtype, if numpy itself writes such a state.

    numpy does not validate the state: a wrong dtype flag would turn bytes of the file into pointers.
    """
    state = unpickler.stack.pop()
    target = unpickler.stack[-1]
    if isinstance(target, np.dtype) and type(state) is tuple:
        valid = _is_dtype_state(target, state)
    elif isinstance(target, np.ndarray) and type(state) is tuple and len(state) == 5:
        valid = unpickler.unfinished.pop(id(target), None) is target and _is_array_state(unpickler, state)
    else:
        raise UnsafePickleError(f"the state of a {type(target).__name__}")
    if not valid:
        raise invalid(_INVALID_ARRAY)
    target.__setstate__(state)
    if isinstance(target, np.ndarray):
        unpickler.count_built(target.nbytes)


def _is_dtype_state(target: np.dtype[Any], state: tuple[Any, ...]) -> bool:
    plain = np.dtype(target.str).__reduce__()[2]
    if len(state) != len(plain) or any(type(value) not in (int, str, type(None)) for value in state):
        return False
    return state[1] in ("<", ">", "|", "=") and (state[0], *state[2:]) == (3, *plain[2:])


def _is_array_state(unpickler: Any, state: tuple[Any, ...]) -> bool:
    version, shape, dtype, fortran, data = state
    if type(version) is not int or type(fortran) not in (bool, int) or not isinstance(dtype, np.dtype):
        return False
    if type(data) not in (bytes, str, list) or not _is_shape(shape):
        return False
    if type(data) is not list:
        return True
    # numpy allocates the shape before it counts the objects. Nested arrays of objects would recurse without bound;
    # an unfinished array can still become one of objects.
    nested = any(isinstance(v, np.ndarray) and (v.dtype.hasobject or id(v) in unpickler.unfinished) for v in data)
    return math.prod(shape) == len(data) and not nested


def _bytearray8(unpickler: Any) -> None:
    # Python's own handler allocates the announced size before it reads.
    (size,) = struct.unpack("<Q", unpickler.read(8))
    unpickler.append(bytearray(unpickler.read(size)))


def _counted(code: bytes) -> Callable[[Any], None]:
    """Return the checked form of an opcode that makes a container, or begins one."""
    plain = CheckedUnpickler.dispatch[code[0]]

    def load(unpickler: Any) -> None:
        unpickler.n_containers += 1
        if unpickler.n_containers > MAX_CONTAINERS:
            raise invalid(f"more than {MAX_CONTAINERS:,} containers")
        plain(unpickler)

    return load


_CONTAINERS = (
    pickle.MARK, pickle.EMPTY_LIST, pickle.EMPTY_DICT, pickle.EMPTY_SET, pickle.EMPTY_TUPLE,
    pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3,
)  # fmt: skip


class _Unpickler(CheckedUnpickler):
    """Accepts numpy arrays and plain containers, and counts what calls build.

    Attributes
    ----------
    left
        Bytes that calls may still build.
    unfinished
        Arrays whose state has not been set yet, by id.
    n_containers
        Containers that were begun; those that calls make have arguments, which are one each.
    """

    dispatch: ClassVar[dict[int, Any]] = {
        **CheckedUnpickler.dispatch,
        pickle.REDUCE[0]: _call,
        pickle.BUILD[0]: _build,
        pickle.BYTEARRAY8[0]: _bytearray8,
        **{code[0]: _counted(code) for code in _CONTAINERS},
    }

    def __init__(self, data: bytes) -> None:
        # latin1: pickles of Python 2 store the bytes of arrays as text.
        super().__init__(io.BytesIO(data), encoding="latin1")
        self.left = _BUILT_FACTOR * len(data) + _BUILT_BYTES
        self.unfinished: dict[int, np.ndarray[Any, Any]] = {}
        self.n_containers = 0

    def find_class(self, module: str, name: str) -> Callable[..., Any]:
        try:
            found: Callable[..., Any] = _ALLOWED[module, name]
        except KeyError:
            raise UnsafePickleError(f"{shown(module)}.{shown(name)}") from None
        return found

    def count_built(self, n_bytes: int) -> None:
        """Count bytes that a call has built."""
        self.left -= n_bytes
        if self.left < 0:
            raise invalid("it builds far more than its own size")


def _require_shallow(root: Any) -> None:
    """Raise UnpicklingError for containers nested deeper than MAX_DEPTH, or in themselves; not recursive."""
    heights: dict[int, int] = {}  # of containers; 0 for those on the current path
    path = [_Level(root)]
    while path:
        level = path[-1]
        child = next(level.children, None)
        if child is None:
            heights[id(level.container)] = level.height
            path.pop()
            if path:
                path[-1].height = max(path[-1].height, 1 + level.height)
        elif id(child) not in heights:
            heights[id(child)] = 0
            path.append(_Level(child))
        elif heights[id(child)] == 0:
            raise invalid("a container that contains itself")
        else:
            level.height = max(level.height, 1 + heights[id(child)])
        if level.height > MAX_DEPTH or len(path) > MAX_DEPTH:
            raise invalid(f"containers nested more than {MAX_DEPTH} deep")


class _Level:
    """A container on the current path, the containers in it that are yet to be visited, and its height so far."""

    def __init__(self, container: Any) -> None:
        self.container = container
        self.children = iter([child for child in _inside(container) if _is_container(child)])
        self.height = 1


def _is_container(value: object) -> bool:
    return type(value) in (list, tuple, dict, OrderedDict) or (type(value) is np.ndarray and value.dtype.hasobject)


def _inside(container: Any) -> Iterable[Any]:
    if isinstance(container, dict):
        return container.values()
    if isinstance(container, np.ndarray):
        return container.reshape(-1).tolist() if container.dtype.hasobject else ()
    return container if isinstance(container, list | tuple) else ()


def as_array(value: object) -> np.ndarray[Any, Any] | None:
    """Return a value of a pickle as an array if it is an array, a number or a list of numbers; else None.

    Nested lists are not expanded: where they are shared, a small file can describe more than fits into memory.
    """
    if isinstance(value, np.ndarray | np.generic):
        return np.asarray(value)
    numbers = value if isinstance(value, list | tuple) else [value]
    if not all(isinstance(v, int | float | np.number) and not isinstance(v, bool) for v in numbers):
        return None
    # An array of objects if a number is larger than any of numpy's types.
    return np.asarray(value)


def load_pickle(path: Path) -> Any:
    """Read a pickle of numpy arrays, numbers, text, lists, tuples, sets and dicts.

    Raises
    ------
    DataError
        "unsafe_pickle" if the file names anything else (which is not executed); "broken_file" if it is truncated,
        not a pickle, unreadable, larger than MAX_PICKLE_BYTES, or builds what no motion needs: keys other than
        text, deep nesting, far more data than its own size.
    """
    try:
        # From memory: reads there do not allocate the size that the pickle announces.
        content = _Unpickler(read_regular(path, MAX_PICKLE_BYTES)).load()
        _require_shallow(content)
    except UnsafePickleError as error:
        raise DataError(
            "the pickle refers to code; nothing was executed",
            reason="unsafe_pickle",
            where=path,
            found=str(error),
            allowed="numpy arrays and plain Python containers",
            fix="download the file again from its publisher, or save its arrays again",
        ) from None
    except Exception as error:  # a pickle is a program: a broken one can raise anything
        raise DataError(
            "the pickle cannot be read",
            reason="broken_file",
            where=path,
            found=shown(error),
            allowed="a complete pickle of numpy arrays, numbers, text and plain containers; keys are text",
            fix="download the file again: it is truncated or not a pickle",
        ) from error
    return content
