"""Reads pickles of numpy arrays and plain containers (pickle, joblib.dump) without running anything.

Every name in a pickle must be on a list; numpy's own functions are not on it. numpy does not validate the state of an
array or a dtype (a wrong flag would turn bytes of the file into pointers), so states are checked before it sees them.
joblib.dump writes the description of an array in the pickle, and its values as raw bytes after the opcodes.

Keys are values whose hashes cannot be made equal or slow; what calls build, and how many containers there are, is
bounded by the file's size. A list can still occur so often that expanding it fills any memory, and hold itself:
`as_array` accepts no nested lists, and `core.text.shown` does not expand them.
"""

import bz2
import io
import lzma
import math
import pickle
import zlib
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence, Sized
from copy import copy
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar

import numpy as np

from dancedata.core.errors import DataError
from dancedata.core.text import shown
from dancedata.files.regular_file import read_regular

MAX_PICKLE_BYTES = 1 << 29
#: Something above this size with a higher compression ratio than this is not a motion.
BOMB_BYTES, BOMB_RATIO = 1 << 26, 100
#: Memory of lzma's dictionary; its highest preset needs 64 MiB.
_LZMA_BYTES = 80 << 20
#: Containers of one file: each takes a byte of it and up to 216 of memory. An array of joblib takes about 250 bytes
#: of the file and 8 of them.
_CONTAINERS, _BYTES_PER_CONTAINER = 100_000, 24
_UNPACKERS: Mapping[bytes, Callable[[], Any]] = {
    b"\x78": zlib.decompressobj,
    b"\x1f\x8b": lambda: zlib.decompressobj(wbits=31),
    b"BZh": bz2.BZ2Decompressor,
    b"\xfd7zXZ\x00": lambda: lzma.LZMADecompressor(lzma.FORMAT_XZ, _LZMA_BYTES),
    b"\x5d\x00": lambda: lzma.LZMADecompressor(lzma.FORMAT_ALONE, _LZMA_BYTES),
}
Names = Mapping[tuple[str, str], Any]


class UnsafePickleError(pickle.UnpicklingError):
    """A pickle names something that is not on the list."""


def invalid(problem: str) -> pickle.UnpicklingError:
    """Return the error for content that numpy and joblib never write."""
    return pickle.UnpicklingError(problem)


class ClassName:
    """The name of a class in a pickle, which may be an argument; if `makes`, objects of it may be made."""

    def __init__(self, name: str, makes: bool = False) -> None:
        self.name, self.makes = name, makes


class StandIn:
    """Stands for an object: the name of its class, and its attributes as the pickle sets them, once."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: dict[str, Any] | None = None


def make(kind: object, *_: object) -> StandIn:
    """Make the stand-in of an object; as copyreg._reconstructor does, which old protocols use."""
    if not isinstance(kind, ClassName) or not kind.makes:
        raise UnsafePickleError(f"an object of {kind.name if isinstance(kind, ClassName) else type(kind).__name__}")
    return StandIn(kind.name)


_NDARRAY, _WRAPPER = ClassName("numpy.ndarray"), "joblib.numpy_pickle.NumpyArrayWrapper"


def is_shape(shape: object) -> bool:
    """Return whether it can be an array's shape."""
    return type(shape) is tuple and len(shape) <= 32 and all(type(n) is int and 0 <= n < 1 << 29 for n in shape)


def _keys(keys: Sequence[Any]) -> list[Any]:
    """Return keys and members of sets, numpy's scalars as Python's; hashes of others can be equal, or take long."""
    plain = [key.item() if isinstance(key, np.generic) else key for key in keys]
    for key in plain:
        if type(key) not in (str, bytes, float, bool, NoneType) and not (type(key) is int and abs(key) < 1 << 63):
            raise invalid(f"a key that is neither text nor a number of 64 bits: {shown(key)}")
    return plain


def _pairs(items: Sequence[Any]) -> dict[Any, Any]:
    return dict(zip(_keys(items[::2]), items[1::2], strict=True))


def _require(good: bool) -> None:
    if not good:
        raise invalid("an array is built in a way that numpy never writes")


def _reconstruct(kind: object, shape: object, code: object) -> np.ndarray[Any, Any]:
    _require(kind is _NDARRAY and type(shape) is tuple and shape == (0,))
    return np.empty((0,), dtype=np.int8)


def _is_empty(array: np.ndarray[Any, Any]) -> bool:
    """Return whether its state may yet be set, as `_reconstruct` leaves it."""
    return bool(array.shape == (0,) and array.dtype == np.int8)


def _dtype(code: object, *_: object) -> np.dtype[Any]:
    # Not structured ones, which numpy takes seconds to parse. A copy, because its byte order is set later.
    _require(type(code) is str and len(code) <= 20)
    dtype = np.dtype(code, copy=True)  # type: ignore[call-overload]
    _require(dtype.kind in "biufcSUO")
    return dtype  # type: ignore[no-any-return]


def _frombuffer(buffer: Any, dtype: Any, shape: Any, order: Any, axes: Any = None) -> np.ndarray[Any, Any]:
    _require(type(buffer) in (bytes, bytearray) and isinstance(dtype, np.dtype) and is_shape(shape))
    _require(type(order) is str and (order in ("C", "F") or (order == "K" and is_shape(axes))))
    array = np.frombuffer(buffer, dtype=dtype)
    return array.reshape(shape).transpose(axes) if order == "K" else array.reshape(shape, order=order)


def _scalar(dtype: Any, data: Any) -> Any:
    _require(isinstance(dtype, np.dtype) and not dtype.hasobject and type(data) in (bytes, str))
    if not dtype.itemsize:  # an empty text
        return dtype.type()
    return np.frombuffer(data.encode("latin1") if type(data) is str else data, dtype=dtype, count=1)[0]


def _encode(text: Any, encoding: object = "latin1") -> bytes:
    # Protocol 2 writes bytes so.
    _require(type(text) is str and type(encoding) is str and encoding in ("latin1", "latin-1"))
    return bytes(text, "latin1")


#: Names that files of arrays use. No class of Python's: bytes(n) would allocate any amount of memory.
ARRAY_NAMES: Names = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "memmap"): _NDARRAY,
    ("numpy", "dtype"): _dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): lambda pairs=(): OrderedDict(
        _pairs([part for key, value in pairs for part in (key, value)])
    ),
    ("collections", "defaultdict"): lambda factory=None: {},
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): ClassName(_WRAPPER, makes=True),
    ("sklearn.externals.joblib.numpy_pickle", "NumpyArrayWrapper"): ClassName(_WRAPPER, makes=True),
    **{
        (f"numpy.{core}.{module}", name): function
        for core in ("core", "_core")
        for module, name, function in (
            ("multiarray", "_reconstruct", _reconstruct),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _frombuffer),
        )
    },
    **{
        (package, name): function
        for package in ("builtins", "__builtin__")
        for name, function in {
            "set": lambda members=(): set(_keys(members)),
            "frozenset": lambda members=(): frozenset(_keys(members)),
            "bytes": lambda: b"",
            "dict": ClassName("dict"),
            "list": ClassName("list"),
        }.items()
    },
}


class _Stream(io.BytesIO):
    def readline(self, size: int | None = -1, /) -> bytes:
        line = super().readline(size)
        if not line.endswith(b"\n"):  # a truncated name must not be read as another name
            raise EOFError("the pickle ends within a line")
        return line


class ArrayUnpickler(pickle._Unpickler):
    """Python's unpickler with a list of names, and a check of every state."""

    dispatch: ClassVar[dict[int, Any]] = dict(pickle._Unpickler.dispatch)
    # Of Python's own, for the type checker.
    stack: list[Any]
    memo: dict[int, Any]
    append: Callable[[Any], None]
    pop_mark: Callable[[], list[Any]]
    read: Callable[[int], bytes]
    readline: Callable[[], bytes]

    def __init__(self, data: bytes, names: Names = ARRAY_NAMES, size: int = 0) -> None:
        # From memory: reads there do not allocate what the pickle announces. latin1: bytes in pickles of Python 2.
        self.data, self.stream = data, _Stream(data)
        super().__init__(self.stream, encoding="latin1")
        self.names = names
        # Bytes that calls may build: protocol 2 stores the bytes of an array as text, encodes it, and copies that.
        self.left = 2 * max(len(data), size) + (1 << 16)
        self.containers = max(_CONTAINERS, (size or len(data)) // _BYTES_PER_CONTAINER)

    def take(self, n_bytes: int) -> None:
        """Count what is built, not what refers to it."""
        self.left -= n_bytes
        if self.left < 0:
            raise invalid("it builds far more than its own size")

    def find_class(self, module: str, name: str) -> Any:
        """Return the substitute for a name; UnsafePickleError if it is not on the list."""
        try:
            return self.names[module, name]
        except KeyError:
            raise UnsafePickleError(f"{shown(module)}.{shown(name)}") from None

    def _reduce(self) -> None:
        arguments, function = self.stack.pop(), self.stack[-1]
        if isinstance(function, ClassName) or not callable(function):
            raise UnsafePickleError(f"{getattr(function, 'name', shown(function))}, called")
        self.stack[-1] = result = function(*arguments)
        array = isinstance(result, np.ndarray | np.generic)
        self.take(result.nbytes if array else len(result) if isinstance(result, Sized) else 0)

    def _newobj(self) -> None:
        arguments, kind = self.stack.pop(), self.stack.pop()
        if arguments != ():
            raise UnsafePickleError("an object that is made with arguments")
        self.append(make(kind))

    def _dict(self) -> None:
        items = self.pop_mark()
        self.append(_pairs(items))

    def _setitems(self) -> None:
        items = self.pop_mark()
        self.stack[-1].update(_pairs(items))

    def _setitem(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self.stack[-1].update(_pairs([key, value]))

    def _additems(self) -> None:
        members = self.pop_mark()
        self.stack[-1].update(_keys(members))

    def _frozenset(self) -> None:
        members = self.pop_mark()
        self.append(frozenset(_keys(members)))

    def _put(self) -> None:
        self.memo[_keys([int(self.readline()[:-1])])[0]] = self.stack[-1]

    def _bytearray8(self) -> None:
        size = int.from_bytes(self.read(8), "little")  # Python's own handler allocates it before it reads
        self.append(bytearray(self.read(size)))

    def _refused(self) -> None:
        raise UnsafePickleError("an object of a class, or an extension code")

    def _build(self) -> None:
        self.set_state(self.stack.pop(), self.stack[-1])

    def set_state(self, state: Any, target: Any) -> None:
        """Set a state that numpy or joblib writes, on the top of the stack."""
        if isinstance(target, StandIn):
            if target.state is not None or type(state) is not dict:
                raise invalid(f"the state of a {target.name}")
            target.state = state
            if target.name == _WRAPPER:
                self.stack[-1] = self._read_array(state)
        elif isinstance(target, np.dtype):
            plain = np.dtype(target.str).__reduce__()[2]
            _require(state[:1] == (3,) and state[1] in ("<", ">", "|", "=") and state[2:] == plain[2:])
            _require(all(type(value) in (int, str, type(None)) for value in state))
            target.__setstate__(state)  # type: ignore[attr-defined]
        elif type(target) is np.ndarray and _is_empty(target):
            version, shape, dtype, fortran, data = state
            _require(type(version) is int and type(fortran) in (bool, int) and isinstance(dtype, np.dtype))
            _require(is_shape(shape) and type(data) in (bytes, str, list))
            if type(data) is list:
                # numpy allocates the shape before it counts the objects; nested arrays recurse when they are freed.
                _require(math.prod(shape) == len(data))
                _require(not any(type(v) is np.ndarray and (v.dtype.hasobject or _is_empty(v)) for v in data))
            target.__setstate__(state)
            self.take(target.nbytes)  # of a list or a text that may occur in many arrays
        else:
            raise UnsafePickleError(f"the state of a {type(target).__name__}")

    def _read_array(self, state: Mapping[str, Any]) -> np.ndarray[Any, Any]:
        shape, order, dtype = state["shape"], state["order"], state["dtype"]
        _require(is_shape(shape) and type(order) is str and order in ("C", "F"))
        _require(isinstance(dtype, np.dtype) and state["subclass"] is _NDARRAY)
        if dtype.hasobject:  # another pickle
            inner = copy(self)
            inner.memo = {}
            array = inner.load()
            self.left, self.containers = inner.left, inner.containers
            _require(isinstance(array, np.ndarray) and array.shape == shape and array.dtype.hasobject)
            return array  # type: ignore[no-any-return]
        if state.get("numpy_array_alignment_bytes") is not None:
            self.stream.seek(self.stream.read(1)[0], io.SEEK_CUR)
        start, count = self.stream.tell(), math.prod(shape)
        array = np.frombuffer(self.data, dtype, count, start) if count * dtype.itemsize else np.empty(0, dtype)
        self.stream.seek(start + array.nbytes)
        return array.reshape(shape, order=order)


def _counted(load: Callable[[Any], None]) -> Callable[[Any], None]:
    def counted(unpickler: Any) -> None:
        unpickler.containers -= 1
        if unpickler.containers < 0:
            raise invalid("more containers than a file of its size needs")
        load(unpickler)

    return counted


_CHECKED = ("REDUCE", "NEWOBJ", "BUILD", "DICT", "SETITEM", "SETITEMS", "ADDITEMS", "FROZENSET", "PUT", "BYTEARRAY8")
_REFUSED = ("INST", "OBJ", "NEWOBJ_EX", "EXT1", "EXT2", "EXT4", "NEXT_BUFFER", "READONLY_BUFFER")
_COUNTED = (
    "MARK", "EMPTY_LIST", "EMPTY_DICT", "EMPTY_SET", "EMPTY_TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "NEWOBJ",
)  # fmt: skip
ArrayUnpickler.dispatch |= {
    **{getattr(pickle, code)[0]: getattr(ArrayUnpickler, f"_{code.lower()}") for code in _CHECKED},
    **{getattr(pickle, code)[0]: ArrayUnpickler._refused for code in _REFUSED},
}
ArrayUnpickler.dispatch |= {
    getattr(pickle, code)[0]: _counted(ArrayUnpickler.dispatch[getattr(pickle, code)[0]]) for code in _COUNTED
}


def _read_unpacked(path: Path, limit: int) -> tuple[bytes, int]:
    """Return the content of a file, unpacked, and its size; ValueError if too large, cut, or packed over 100-fold."""
    data = read_regular(path, limit)
    kind = next((make for head, make in _UNPACKERS.items() if data.startswith(head)), None)
    if data.startswith(b"\x04\x22\x4d\x18"):
        raise ValueError("compressed by lz4; write it with compress='zlib', or without compression")
    if kind is None:
        return data, len(data)
    allowed, unpacker = min(limit, max(BOMB_BYTES, BOMB_RATIO * len(data))), kind()
    content: bytes = unpacker.decompress(data, allowed + 1)
    if len(content) > allowed:
        raise ValueError(f"{len(data):,} bytes unpack to more than {allowed:,}")
    if not unpacker.eof:
        raise ValueError("the compressed data are truncated")
    return content, len(data)


def as_array(value: object) -> np.ndarray[Any, Any] | None:
    """Return an array, a number or a flat list of numbers as an array, else None: nested lists can fill memory."""
    if isinstance(value, np.ndarray) and value.dtype.hasobject:  # as tables of pandas are saved
        numbers = as_array(value.reshape(-1).tolist()) if value.size else None
        return value if numbers is None or numbers.dtype.hasobject else numbers.reshape(value.shape)
    if isinstance(value, np.ndarray | np.generic):
        return np.asarray(value)
    values = value if isinstance(value, list | tuple) else [value]
    if not all(isinstance(v, int | float | np.number) and not isinstance(v, bool) for v in values):
        return None
    return np.asarray(value)


def load_pickle(path: Path, names: Names = ARRAY_NAMES, start: int = 0) -> Any:
    """Read a pickle of numpy arrays, numbers, text, lists, tuples, sets and dicts, or a file of joblib.dump.

    `names`: (module, name) -> the function or `ClassName` that replaces it. `start`: first byte of the pickle.

    Raises DataError: "unsafe_pickle" if the file names anything else (which is not executed); "broken_file" if it is
        truncated, not a pickle, unreadable, or larger than MAX_PICKLE_BYTES.
    """
    return unpickled(lambda: _read_unpacked(path, MAX_PICKLE_BYTES), path, names, start)


def unpickled(read: Callable[[], tuple[bytes, int]], path: Path, names: Names = ARRAY_NAMES, start: int = 0) -> Any:
    """Return the content of the bytes that a call reads, with their size on disk; DataError as `load_pickle`."""
    try:
        data, size = read()
        return ArrayUnpickler(data[start:] if start else data, names, size).load()
    except UnsafePickleError as error:
        raise DataError("the pickle refers to code; nothing was executed", reason="unsafe_pickle", where=path,
                        found=str(error), allowed="numpy arrays and plain Python containers",
                        fix=_FIXES.get(str(error).split(".")[0], _ARRAYS)) from None  # fmt: skip
    except Exception as error:  # a pickle is a program: a broken one can raise anything
        raise DataError("the pickle cannot be read", reason="broken_file", where=path, found=shown(error),
                        allowed="a complete pickle or joblib file of arrays, numbers, text and plain containers",
                        fix=f"copy the file again if it is truncated; else {_ARRAYS}") from error  # fmt: skip


_ARRAYS = (
    "with the program that has written it, load the file and save its arrays: numpy.savez(file, poses=..., trans=...)"
)
_FIXES = {
    "torch": "call tensor.cpu().numpy() before joblib.dump or pickle.dump, or torch.save the tensors to a .pt file",
    **dict.fromkeys(
        ("chumpy", "scipy"), "if it is a body model, give it as dataset.folder.body_model, not as a motion"
    ),
}
