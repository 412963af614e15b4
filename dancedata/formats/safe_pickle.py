"""Reads untrusted pickles without executing them: numpy arrays and plain containers only.

A pickle is a program, and its result can be far larger, deeper or slower to traverse than its bytes suggest. All
opcodes that build anything are therefore replaced by checked ones (`checked_unpickler`): keys are texts and small
integers, objects of allowed classes are stand-ins without behaviour, containers are nested at most MAX_DEPTH deep,
and calls build (arrays, bytes, sets) not much more than the file's size. A list can still occur so many times that
expanding it fills any memory: `as_array` accepts no nested lists, and `core.text.shown` does not expand them.
"""

import bz2
import io
import lzma
import pickle
import struct
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sized
from pathlib import Path
from types import FunctionType
from typing import Any, ClassVar, Protocol

import numpy as np

from dancedata.core.errors import DataError
from dancedata.core.text import shown
from dancedata.files.regular_file import read_regular
from dancedata.formats.checked_unpickler import (
    CheckedUnpickler,
    ClassName,
    StandIn,
    UnsafePickleError,
    default_dict,
    invalid,
    new_object,
    set_state,
)
from dancedata.formats.numpy_pickle import (
    ALLOWED,
    INVALID_ARRAY,
    WRAPPER,
    NamesOfJoblib,
    NdarrayName,
    is_array_state,
    is_dtype_state,
    read_array,
    reconstruct,
)

#: Something above this size with a higher compression ratio than this is not a motion.
BOMB_BYTES = 1 << 26
BOMB_RATIO = 100
#: Memory of lzma's dictionary; its highest preset needs 64 MiB.
_LZMA_BYTES = 80 << 20


class _Decompressor(Protocol):
    @property
    def eof(self) -> bool: ...

    def decompress(self, data: bytes, max_length: int, /) -> bytes: ...


def _lzma(kind: int) -> Callable[[], Any]:
    return lambda: lzma.LZMADecompressor(kind, memlimit=_LZMA_BYTES)


#: First bytes -> what unpacks; no pickle begins so.
_KINDS: dict[bytes, Callable[[], _Decompressor]] = {
    b"\x78": zlib.decompressobj,
    b"\x1f\x8b": lambda: zlib.decompressobj(wbits=31),
    b"BZh": bz2.BZ2Decompressor,
    b"\xfd7zXZ\x00": _lzma(lzma.FORMAT_XZ),
    b"\x5d\x00": _lzma(lzma.FORMAT_ALONE),
}
_LZ4 = b"\x04\x22\x4d\x18"


def read_unpacked(path: Path, limit: int) -> tuple[bytes, int]:
    """Return the content of a file, unpacked if zlib, gzip, bz2, lzma or xz has packed it, and the file's size.

    Raises
    ------
    ValueError
        If it is larger than the limit, truncated, or packed more than 100-fold.
    OSError
        If it cannot be read.
    """
    data = read_regular(path, limit)
    kind = next((make for head, make in _KINDS.items() if data.startswith(head)), None)
    if data.startswith(_LZ4):
        raise ValueError("compressed by lz4; write it with compress='zlib', or without compression")
    if kind is None:
        return data, len(data)
    allowed = min(limit, max(BOMB_BYTES, BOMB_RATIO * len(data)))
    unpacker = kind()
    content = unpacker.decompress(data, allowed + 1)
    if len(content) > allowed:
        raise ValueError(f"{len(data):,} bytes unpack to more than {allowed:,}")
    if not unpacker.eof:
        raise ValueError("the compressed data are truncated")
    return content, len(data)


MAX_PICKLE_BYTES = 1 << 29
MAX_DEPTH = 100
#: Containers of one file: each takes a byte of it and up to 216 of memory.
MAX_CONTAINERS = 100_000
#: Bytes of a larger file per container: an array of joblib takes about 250 bytes and 8 containers of opcodes.
_BYTES_PER_CONTAINER = 24
#: Calls may build this many times the size of the file, plus a constant. Protocol 2 stores the bytes of an array as
#: text, which is encoded to bytes and then copied.
_BUILT_FACTOR, _BUILT_BYTES = 2, 1 << 16

Names = Mapping[tuple[str, str], Any]
#: Names that files of arrays use.
ARRAY_NAMES: Names = {
    **ALLOWED,
    **NamesOfJoblib,
    ("collections", "defaultdict"): default_dict,
    **{(package, name): ClassName(name) for package in ("builtins", "__builtin__") for name in ("dict", "list")},
}

# The handlers of opcodes; each takes the unpickler.


def _call(unpickler: Any) -> None:
    """Call a function of the allow-list, and count the size of its result."""
    arguments = unpickler.stack.pop()
    function = unpickler.stack[-1]
    # find_class returns functions only, except for NdarrayName.
    if not isinstance(function, FunctionType) or type(arguments) is not tuple:
        name = function.name if isinstance(function, ClassName) else shown(function)
        raise UnsafePickleError(f"{'numpy.ndarray' if function is NdarrayName else name}, called")
    result = function(*arguments)
    if isinstance(result, np.ndarray | np.generic):
        unpickler.count_built(result.nbytes)
        if function is reconstruct:
            unpickler.unfinished[id(result)] = result
    elif isinstance(result, Sized):
        unpickler.count_built(len(result))
    unpickler.stack[-1] = result


def _build(unpickler: Any) -> None:
    """Set the state of an array or a dtype, if numpy itself writes such a state, or of a stand-in."""
    state = unpickler.stack.pop()
    target = unpickler.stack[-1]
    if isinstance(target, StandIn):
        set_state(target, state)
        if target.name == WRAPPER:
            unpickler.stack[-1] = read_array(unpickler, state)
        return
    if isinstance(target, np.dtype) and type(state) is tuple:
        valid = is_dtype_state(target, state)
    elif isinstance(target, np.ndarray) and type(state) is tuple and len(state) == 5:
        valid = unpickler.unfinished.pop(id(target), None) is target and is_array_state(unpickler, state)
    else:
        raise UnsafePickleError(f"the state of a {type(target).__name__}")
    if not valid:
        raise invalid(INVALID_ARRAY)
    target.__setstate__(state)
    if isinstance(target, np.ndarray):
        unpickler.count_built(target.nbytes)


def _bytearray8(unpickler: Any) -> None:
    # Python's own handler allocates the announced size before it reads.
    (size,) = struct.unpack("<Q", unpickler.read(8))
    unpickler.append(bytearray(unpickler.read(size)))


def _counted(code: bytes) -> Callable[[Any], None]:
    """Return the checked form of an opcode that makes a container, or begins one."""
    plain = new_object if code == pickle.NEWOBJ else CheckedUnpickler.dispatch[code[0]]

    def load(unpickler: Any) -> None:
        unpickler.n_containers += 1
        if unpickler.n_containers > unpickler.max_containers:
            raise invalid(f"more than {unpickler.max_containers:,} containers")
        plain(unpickler)

    return load


_CONTAINERS = (
    pickle.MARK, pickle.EMPTY_LIST, pickle.EMPTY_DICT, pickle.EMPTY_SET, pickle.EMPTY_TUPLE,
    pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3, pickle.NEWOBJ,
)  # fmt: skip


class _Stream(io.BytesIO):
    def readline(self, size: int | None = -1, /) -> bytes:
        line = super().readline(size)
        if not line.endswith(b"\n"):  # a truncated name must not be read as another name
            raise EOFError("the pickle ends within a line")
        return line


class ArrayUnpickler(CheckedUnpickler):
    """Accepts numpy arrays and plain containers, and counts what calls build.

    Attributes
    ----------
    stream
        The file, after the opcodes that were read.
    names
        The names that the pickle may use, and their substitutes.
    size
        Size of the file, before it was unpacked.
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

    def __init__(self, data: bytes, names: Names, size: int) -> None:
        # latin1: pickles of Python 2 store the bytes of arrays as text.
        self.stream = _Stream(data)  # from memory: reads there do not allocate the size that the pickle announces
        super().__init__(self.stream, encoding="latin1")
        self.data = data
        self.names = names
        self.size = size
        self.left = _BUILT_FACTOR * max(len(data), size) + _BUILT_BYTES
        self.unfinished: dict[int, np.ndarray[Any, Any]] = {}
        self.n_containers = 0
        self.max_containers = max(MAX_CONTAINERS, size // _BYTES_PER_CONTAINER)

    def take(self, count: int) -> memoryview:
        """Return the next bytes of the file, after the opcodes that were read."""
        start = self.stream.tell()
        if count > len(self.data) - start:
            raise EOFError(f"an array of {count:,} bytes, but the file has {len(self.data) - start:,} more")
        self.stream.seek(start + count)
        return memoryview(self.data)[start : start + count]

    def load_inner(self) -> Any:
        """Load a pickle that follows the opcodes that were read; it counts as a part of this one."""
        inner = ArrayUnpickler(self.data, ALLOWED, self.size)
        inner.stream.seek(self.stream.tell())
        inner.left, inner.n_containers = self.left, self.n_containers
        value = inner.load()
        self.left, self.n_containers = inner.left, inner.n_containers
        self.stream.seek(inner.stream.tell())
        return value

    def find_class(self, module: str, name: str) -> Callable[..., Any]:
        """Return the substitute for a name; UnsafePickleError if the name is not allowed."""
        try:
            stand_in: Callable[..., Any] = self.names[module, name]
        except KeyError:
            raise UnsafePickleError(f"{shown(module)}.{shown(name)}") from None
        return stand_in

    def count_built(self, n_bytes: int) -> None:
        """Count bytes that a call has built."""
        self.left -= n_bytes
        if self.left < 0:
            raise invalid("it builds far more than its own size")


def require_shallow(root: Any) -> None:
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
    if type(value) in (list, tuple, dict, OrderedDict, StandIn):
        return True
    return type(value) is np.ndarray and value.dtype.hasobject


def _inside(container: Any) -> Iterable[Any]:
    if isinstance(container, dict):
        return container.values()
    if isinstance(container, StandIn):
        return (container.state,)
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


def load_pickle(path: Path, names: Names = ARRAY_NAMES, start: int = 0) -> Any:
    """Read a pickle of numpy arrays, numbers, text, lists, tuples, sets and dicts, or a file of joblib.dump.

    Parameters
    ----------
    names
        (module, name) -> the function or `ClassName` that replaces it.
    start
        First byte of the pickle in the file.

    Raises
    ------
    DataError
        "unsafe_pickle" if the file names anything else (which is not executed); "broken_file" if it is truncated,
        not a pickle, unreadable, larger than MAX_PICKLE_BYTES, or builds what no motion needs: keys other than
        text, deep nesting, far more data than its own size.
    """
    try:
        data, size = read_unpacked(path, MAX_PICKLE_BYTES)
        content = ArrayUnpickler(data[start:] if start else data, names, size).load()
        require_shallow(content)
    except UnsafePickleError as error:
        raise DataError(
            "the pickle refers to code; nothing was executed",
            reason="unsafe_pickle",
            where=path,
            found=str(error),
            allowed="numpy arrays and plain Python containers",
            fix=_arrays_instead(str(error)),
        ) from None
    except Exception as error:  # a pickle is a program: a broken one can raise anything
        raise DataError(
            "the pickle cannot be read",
            reason="broken_file",
            where=path,
            found=shown(error),
            allowed="a complete pickle or joblib file of arrays, numbers, text and plain containers; keys are text",
            fix=f"copy the file again if it is truncated. {_SAVE_ARRAYS}",
        ) from error
    return content


_SAVE_ARRAYS = (
    "Otherwise, with the program that has written it, load the file and save its arrays alone: "
    "numpy.savez(file, poses=..., trans=...)"
)


def _arrays_instead(found: str) -> str:
    """Return the fix for a pickle that names something other than arrays."""
    if found.startswith("torch"):
        return (
            "save numpy arrays: call tensor.cpu().numpy() before joblib.dump or pickle.dump, or write the tensors "
            "with torch.save to a .pt file"
        )
    if found.startswith(("chumpy", "scipy.sparse")):
        return "this looks like a body model: give it as dataset.folder.body_model, not as a motion"
    return (
        "if you do not trust the file, delete it. If you do: with the program that has written it, load it and save "
        "its arrays alone, numpy.savez(file, poses=..., trans=...)"
    )
