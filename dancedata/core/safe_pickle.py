"""Reads foreign pickles without running anything foreign: numpy arrays and plain containers only.

A pickle is a program, and what it builds can be far larger, deeper or slower to look at than its bytes. So the parts
of Python's unpickler that build anything are replaced by ones that check first, and what comes out holds to this:

- Keys and members of sets are texts and small whole numbers. Others can have equal hashes, or hashes that take longer
  than any life.
- Containers are nested MAX_DEPTH deep at most, and none holds itself.
- All that calls build (arrays, bytes, sets) is together not much larger than the file.

It can still hold a list so often that unfolding it fills any memory: `as_array` takes no lists within lists, and
messages show values by `core.text.shown`, which unfolds nothing.
"""

from __future__ import annotations

import io
import math
import pickle
import struct
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any, ClassVar

import numpy as np

from dancedata.core.errors import DataError
from dancedata.core.regular_file import read_regular
from dancedata.core.text import shown

__all__ = [
    "MAX_DEPTH",
    "MAX_PICKLE_BYTES",
    "CheckedUnpickler",
    "UnsafePickleError",
    "as_array",
    "load_pickle",
    "ordered_dict",
]

MAX_PICKLE_BYTES = 1 << 29
MAX_DEPTH = 100
#: Containers of one file: each takes a byte of it and up to 216 of memory.
MAX_CONTAINERS = 100_000
#: Keys, and places in the unpickler's memory, are below this: no more than a handful of them have one hash.
_MAX_KEY = 1 << 63
_MAX_DIMENSIONS = 32
#: What calls build may be this many times as large as the file, and so much more. A pickle of protocol 2 has the
#: bytes of an array as text, which is turned to bytes and then copied.
_BUILT_PARTS, _BUILT_BYTES = 2, 1 << 16


class UnsafePickleError(pickle.UnpicklingError):
    """A pickle names something that is not on the allow-list."""


def _odd(what: str) -> pickle.UnpicklingError:
    return pickle.UnpicklingError(what)


_ODD_ARRAY = "an array is built in a way that numpy never writes"


class _NdarrayName:
    """Stands for numpy.ndarray in a pickle: can be named, not called (a call could ask for any memory)."""


def _reconstruct(kind: object, shape: object, code: object) -> np.ndarray[Any, Any]:
    if kind is not _NdarrayName or type(shape) is not tuple or shape != (0,):
        raise _odd(_ODD_ARRAY)
    return np.empty((0,), dtype=np.int8)


def _dtype(code: object, align: object = False, copy: object = False) -> np.dtype[Any]:
    # Long codes describe records, which numpy takes seconds for.
    if type(code) is not str or len(code) > 20:
        raise _odd(f"an array of type {shown(code)}")
    # A copy, for its byte order is set later. Records, subarrays and dates are not needed and too powerful.
    dtype: np.dtype[Any] = np.dtype(code, copy=True)
    if dtype.kind not in "biufcSUO":
        raise _odd(f"arrays of type {shown(code)} are not read")
    return dtype


def _frombuffer(buffer: Any, dtype: Any, shape: Any, order: Any, axes: Any = None) -> np.ndarray[Any, Any]:
    # Not of an array: that one could be filled anew and leave this one without its memory.
    plain = type(buffer) in (bytes, bytearray) and isinstance(dtype, np.dtype) and type(order) is str
    if not plain or not _is_shape(shape) or not (order in ("C", "F") or (order == "K" and _is_shape(axes))):
        raise _odd(_ODD_ARRAY)
    array = np.frombuffer(buffer, dtype=dtype)
    # numpy 2.3 and later: an array whose axes lie in memory in another order.
    return array.reshape(shape).transpose(axes) if order == "K" else array.reshape(shape, order=order)


def _scalar(dtype: Any, data: Any) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject or type(data) not in (bytes, str):
        raise _odd("a numpy scalar that numpy never writes")
    raw = data.encode("latin1") if isinstance(data, str) else data
    return np.frombuffer(raw, dtype=dtype, count=1)[0]


def _encode(text: object, encoding: object = "latin1") -> bytes:
    # Protocol 2 writes bytes as _codecs.encode(text, "latin1"); nothing else is needed of that function.
    if type(text) is not str or type(encoding) is not str or encoding not in ("latin1", "latin-1"):
        raise _odd(f"a {type(text).__name__} encoded as {shown(encoding)}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    # Protocol 2 writes b"" as bytes(); bytes(n) could ask for any memory.
    return b""


def _set(members: object = ()) -> set[Any]:
    found: set[Any] = set()
    _add(found, _items(members))
    return found


def _frozenset(members: object = ()) -> frozenset[Any]:
    return frozenset(_set(members))


def ordered_dict(pairs: object = ()) -> OrderedDict[Any, Any]:
    """Make an OrderedDict; Python 2 gives its items as a list of lists of two."""
    found: OrderedDict[Any, Any] = OrderedDict()
    for pair in _items(pairs):
        if type(pair) not in (list, tuple) or len(pair) != 2:
            raise _odd("an OrderedDict of other things than pairs")
        _put_items(found, pair)
    return found


def _items(value: object) -> Sequence[Any]:
    if not isinstance(value, list | tuple):
        raise _odd(f"a container made of a {type(value).__name__}")
    return value


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
    _ALLOWED[_package, "set"] = _set
    _ALLOWED[_package, "frozenset"] = _frozenset
    _ALLOWED[_package, "bytes"] = _no_bytes


def _require_keys(keys: Iterable[object], what: str) -> None:
    for key in keys:
        if type(key) is not str and not (type(key) is int and abs(key) < _MAX_KEY):
            raise _odd(f"a {what} that is neither text nor a small whole number: {shown(key)}")


def _is_shape(shape: object) -> bool:
    """Whether it can be an array's shape: its product is then a number of bounded size."""
    if type(shape) is not tuple or len(shape) > _MAX_DIMENSIONS:
        return False
    return all(type(n) is int and 0 <= n <= MAX_PICKLE_BYTES for n in shape)


# From here on, what stands in for the unpickler's own opcodes; each takes the unpickler.


def _call(unpickler: Any) -> None:
    """Call a function of the allow-list, and count what it made."""
    arguments = unpickler.stack.pop()
    function = unpickler.stack[-1]
    # find_class gives no others.
    if not isinstance(function, FunctionType) or type(arguments) is not tuple:
        raise UnsafePickleError(f"{'numpy.ndarray' if function is _NdarrayName else shown(function)}, called")
    made = function(*arguments)
    if isinstance(made, np.ndarray | np.generic):
        unpickler.count_built(made.nbytes)
        if function is _reconstruct:
            unpickler.unfinished[id(made)] = made
    elif not isinstance(made, np.dtype):
        unpickler.count_built(len(made))
    unpickler.stack[-1] = made


def _build(unpickler: Any) -> None:
    """Set the state of an array or a dtype, if it is a state that numpy writes.

    numpy believes what it is given: a dtype said to hold no objects makes pointers of the bytes of a file.
    """
    state = unpickler.stack.pop()
    target = unpickler.stack[-1]
    if isinstance(target, np.dtype) and type(state) is tuple:
        good = _is_dtype_state(target, state)
    elif isinstance(target, np.ndarray) and type(state) is tuple and len(state) == 5:
        good = unpickler.unfinished.pop(id(target), None) is target and _is_array_state(unpickler, state)
    else:
        raise UnsafePickleError(f"the state of a {type(target).__name__}")
    if not good:
        raise _odd(_ODD_ARRAY)
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
    # numpy makes room for the shape before it looks how many objects there are. Arrays of objects within each other
    # would be taken apart by recursion without an end; an unfinished one can still become such an array.
    nested = any(isinstance(v, np.ndarray) and (v.dtype.hasobject or id(v) in unpickler.unfinished) for v in data)
    return math.prod(shape) == len(data) and not nested


def _put_items(target: dict[Any, Any], items: Sequence[Any]) -> None:
    """Put key, value, key, value, ... into a dict."""
    if len(items) % 2:
        raise _odd("a dict with a key and no value")
    _require_keys(items[::2], "key")
    target.update(zip(items[::2], items[1::2], strict=True))


def _set_items(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    _put_items(_top(unpickler, dict), items)


def _set_item(unpickler: Any) -> None:
    value, key = unpickler.stack.pop(), unpickler.stack.pop()
    _put_items(_top(unpickler, dict), [key, value])


def _dict(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    found: dict[Any, Any] = {}
    _put_items(found, items)
    unpickler.append(found)


def _append(unpickler: Any) -> None:
    value = unpickler.stack.pop()
    _top(unpickler, list).append(value)


def _appends(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    _top(unpickler, list).extend(items)


def _add(target: set[Any], members: Iterable[Any]) -> None:
    _require_keys(members, "member of a set")
    target.update(members)


def _add_items(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    _add(_top(unpickler, set), items)


def _frozen(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    unpickler.append(_frozenset(items))


def _top(unpickler: Any, kind: type) -> Any:
    """Return what lies on top of the stack, which has to be a container of this kind."""
    target = unpickler.stack[-1]
    if not isinstance(target, kind):
        raise UnsafePickleError(f"a {type(target).__name__}, filled")
    return target


def _put(unpickler: Any) -> None:
    number = int(unpickler.readline()[:-1])
    if not 0 <= number < _MAX_KEY:
        raise _odd("a memo index out of range")
    unpickler.memo[number] = unpickler.stack[-1]


def _bytearray8(unpickler: Any) -> None:
    # Python's own makes room for the announced size before it reads.
    (size,) = struct.unpack("<Q", unpickler.read(8))
    unpickler.append(bytearray(unpickler.read(size)))


def _refuse(unpickler: Any) -> None:
    raise UnsafePickleError("an object of a class, or an extension code")


class CheckedUnpickler(pickle._Unpickler):
    """Python's unpickler in Python, for only there can it be checked what is put into which container."""

    dispatch: ClassVar[dict[int, Any]] = {
        **pickle._Unpickler.dispatch,
        pickle.SETITEM[0]: _set_item,
        pickle.SETITEMS[0]: _set_items,
        pickle.DICT[0]: _dict,
        pickle.APPEND[0]: _append,
        pickle.APPENDS[0]: _appends,
        pickle.ADDITEMS[0]: _add_items,
        pickle.FROZENSET[0]: _frozen,
        pickle.PUT[0]: _put,
        **{code[0]: _refuse for code in (pickle.EXT1, pickle.EXT2, pickle.EXT4)},
        **{code[0]: _refuse for code in (pickle.NEWOBJ, pickle.NEWOBJ_EX, pickle.OBJ)},
    }

    def _instantiate(self, klass: Any, args: Any) -> None:
        # Of INST, which has looked for the class.
        _refuse(self)


def _counted(code: bytes) -> Callable[[Any], None]:
    """Return what stands in for an opcode that makes a container, or the beginning of one."""
    plain = CheckedUnpickler.dispatch[code[0]]

    def load(unpickler: Any) -> None:
        unpickler.n_containers += 1
        if unpickler.n_containers > MAX_CONTAINERS:
            raise _odd(f"more than {MAX_CONTAINERS:,} containers")
        plain(unpickler)

    return load


_CONTAINERS = (
    pickle.MARK, pickle.EMPTY_LIST, pickle.EMPTY_DICT, pickle.EMPTY_SET, pickle.EMPTY_TUPLE,
    pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3,
)  # fmt: skip


class _Unpickler(CheckedUnpickler):
    """Knows numpy arrays and plain containers, and counts what calls build.

    Attributes
    ----------
    left
        Bytes that calls may still build.
    unfinished
        Arrays whose state was not set yet, by id.
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
        # latin1: pickles of Python 2 hold array bytes as text.
        super().__init__(io.BytesIO(data), encoding="latin1")
        self.left = _BUILT_PARTS * len(data) + _BUILT_BYTES
        self.unfinished: dict[int, np.ndarray[Any, Any]] = {}
        self.n_containers = 0

    def find_class(self, module: str, name: str) -> Callable[..., Any]:
        try:
            found: Callable[..., Any] = _ALLOWED[module, name]
        except KeyError:
            raise UnsafePickleError(f"{shown(module)}.{shown(name)}") from None
        return found

    def count_built(self, n_bytes: int) -> None:
        """Count bytes that a call has made."""
        self.left -= n_bytes
        if self.left < 0:
            raise _odd("it builds more than it holds")


def _require_shallow(root: Any) -> None:
    """Raise UnpicklingError for containers nested deeper than MAX_DEPTH, or in themselves; by no recursion."""
    heights: dict[int, int] = {}  # of containers; 0 of those that lie above
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
            raise _odd("a container that holds itself")
        else:
            level.height = max(level.height, 1 + heights[id(child)])
        if level.height > MAX_DEPTH or len(path) > MAX_DEPTH:
            raise _odd(f"containers nested more than {MAX_DEPTH} deep")


class _Level:
    """A container on the way down, the containers in it that are still to be looked at, and its height so far."""

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

    Lists within lists are not unfolded: where they are shared, a small file holds more than any memory.
    """
    if isinstance(value, np.ndarray | np.generic):
        return np.asarray(value)
    numbers = value if isinstance(value, list | tuple) else [value]
    if not all(isinstance(v, int | float | np.number) and not isinstance(v, bool) for v in numbers):
        return None
    # Of objects, if a number is larger than any of numpy's.
    return np.asarray(value)


def load_pickle(path: Path) -> Any:
    """Read a pickle of numpy arrays, numbers, text, lists, tuples, sets and dicts.

    Raises
    ------
    DataError
        "unsafe_pickle" if the file names anything else (which is not run); "broken_file" if it is truncated,
        is no pickle, cannot be read, is larger than MAX_PICKLE_BYTES, or builds what no motion needs: keys that are
        no text, deep nesting, far more than it holds.
    """
    try:
        # From memory, where a size that the pickle announces is no reason to make room for it.
        content = _Unpickler(read_regular(path, MAX_PICKLE_BYTES)).load()
        _require_shallow(content)
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
            found=shown(error),
            allowed="a whole pickle of numpy arrays, numbers, text and plain containers; keys are text",
            fix="get the file again: it is truncated or no pickle",
        ) from error
    return content
