"""Lazy reader of torch files from before the zip format (torch < 1.6), such as OpenAI's checkpoints.

Such a file is a sequence of five pickles (magic number, protocol, type sizes, the object, the list of storage keys)
and then, for each key in that list, an int64 element count and the raw little-endian elements. Opening reads the
pickles only; tensors, or their leading rows, are read on request.

The unpickler accepts tensors and plain containers and nothing else. No code of the file, or of the package that wrote
it, is run.
"""

from __future__ import annotations

import os
import pickle
import struct
from collections.abc import Callable
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any, ClassVar

from dancedata.core.errors import DataError, SourceError
from dancedata.core.text import quoted, shown
from dancedata.core.typing import override
from dancedata.formats.safe_pickle import ARRAY_NAMES, ArrayUnpickler, Names, UnsafePickleError, invalid
from dancedata.formats.torch_file import STORAGE_NAMES, require_layout, storage_of

MAGIC = 0x1950A86A20F9469CFC6C
PROTOCOL = 1001
# A prior of 872 tensors has 0.1 MB of pickles; a file with more is damaged.
MAX_PICKLE_BYTES = 64 << 20


@dataclass(frozen=True)
class _Storage:
    """A whole storage, or a part of one, by the key of the whole; counts are elements."""

    key: str
    dtype: str
    item_bytes: int
    whole: int
    offset: int


@dataclass(frozen=True)
class LegacyTensor:
    """The place of a tensor in the file.

    Attributes
    ----------
    key : of its storage.
    dtype : "float32" and so on.
    item_bytes : bytes per element.
    offset : elements from the start of the storage.
    shape : sizes.
    stride : elements from one index to the next, per dimension.
    """

    key: str
    dtype: str
    item_bytes: int
    offset: int
    shape: tuple[int, ...]
    stride: tuple[int, ...]

    def span(self, rows: int) -> int:
        """Return the number of elements of the storage from the first to the last of the leading rows."""
        if 0 in (rows, *self.shape):
            return 0
        return 1 + sum((n - 1) * step for n, step in zip((rows, *self.shape[1:]), self.stride, strict=True))


class _Ignored(dict[Any, Any]):
    """Placeholder for objects that are not tensors (hyperparameters of OpenAI's class, numpy numbers)."""


def _ignored(*_: object) -> _Ignored:
    return _Ignored()


def _tensor(storage: Any, offset: Any, shape: Any, stride: Any, *_: object) -> LegacyTensor:
    """Replace torch._utils._rebuild_tensor and _rebuild_tensor_v2."""
    require_layout(offset, shape, stride)
    if not isinstance(storage, _Storage):
        raise invalid("a tensor that torch never writes")
    start = offset + storage.offset
    tensor = LegacyTensor(storage.key, storage.dtype, storage.item_bytes, start, shape, stride)
    if start < 0 or start + tensor.span(shape[0] if shape else 1) > storage.whole:
        raise invalid(f"a tensor of shape {shown(shape)} that reaches beyond its storage")
    return tensor


def _parameter(tensor: Any, *_: object) -> Any:
    return tensor


_NAMES: Names = {
    ("collections", "OrderedDict"): ARRAY_NAMES["collections", "OrderedDict"],
    ("torch._utils", "_rebuild_tensor"): _tensor,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch._utils", "_rebuild_parameter"): _parameter,
    ("numpy", "dtype"): _ignored,
    ("numpy.core.multiarray", "scalar"): _ignored,
    ("numpy._core.multiarray", "scalar"): _ignored,
    ("_codecs", "encode"): _ignored,
    **STORAGE_NAMES,
}


def _new(unpickler: Any) -> None:
    """Replace the creation of an object by its class, as for those of OpenAI's package."""
    unpickler.stack.pop()
    if unpickler.stack.pop() is not _ignored:
        raise UnsafePickleError("an object of a class")
    unpickler.append(_Ignored())


def _build(unpickler: Any) -> None:
    # A state dict has a _metadata attribute; it is dropped, and no other object may have its state set.
    unpickler.stack.pop()
    if not isinstance(unpickler.stack[-1], dict):
        raise UnsafePickleError(f"the state of a {type(unpickler.stack[-1]).__name__}")


class _Unpickler(ArrayUnpickler):
    """Accepts tensors and plain containers only; a pickle cannot set its state."""

    dispatch: ClassVar[dict[int, Any]] = {
        **ArrayUnpickler.dispatch,
        pickle.BUILD[0]: _build,
        pickle.NEWOBJ[0]: _new,
    }

    def __init__(self, data: bytes) -> None:
        super().__init__(data, _NAMES)
        self.storages: dict[str, tuple[int, int]] = {}  # item bytes and element count by key

    @override
    def find_class(self, module: str, name: str) -> Callable[..., Any]:
        # A class of OpenAI's package, by its name alone: the package is not imported.
        return _ignored if module.split(".")[0] == "jukebox" else super().find_class(module, name)

    def persistent_load(self, pid: Any) -> _Storage:
        dtype, item_bytes, key, whole = storage_of(pid, 6)
        if self.storages.setdefault(key, (item_bytes, whole)) != (item_bytes, whole):
            raise invalid(f"two sizes of the storage {quoted(key)}")
        # The view of a storage that is a part of another one is (own key, offset, size).
        offset = 0 if pid[5] is None else pid[5][1]
        if type(offset) is not int:
            raise invalid(f"a part of a storage at offset {shown(offset)}")
        return _Storage(key, dtype, item_bytes, whole, offset)


class LegacyFile:
    """An open legacy torch file; close it, or use it in a ``with`` block.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    object
        The saved object, with a `LegacyTensor` in place of every tensor.

    Raises
    ------
    SourceError
        The file is not a legacy torch file, or is truncated; the message names the first incomplete tensor.
    DataError
        "unsafe_pickle": the file contains foreign code. Nothing was run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BufferedReader = path.open("rb")
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            self.object, keys, storages = self._load_pickles()
            self._starts = self._locate(keys, storages)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> LegacyFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def read_into(self, tensor: LegacyTensor, name: str, buffer: memoryview) -> None:
        """Read the leading ``len(buffer)`` bytes of a tensor; `name` is for messages."""
        start, n_elements = self._starts[tensor.key]
        self._file.seek(start - 8)
        (stored,) = struct.unpack("<q", self._file.read(8))
        if stored != n_elements:
            raise SourceError(
                f"the torch file is damaged at the tensor {shown(name)}",
                where=self.path,
                found=f"a storage of {stored} elements",
                allowed=f"{n_elements}, as in the head of the file",
                fix="get the file again",
            )
        self._file.seek(start + tensor.offset * tensor.item_bytes)
        if self._file.readinto(buffer) != len(buffer):
            raise self._truncated(name, start + n_elements * tensor.item_bytes)

    def _load_pickles(self) -> tuple[Any, list[Any], dict[str, tuple[int, int]]]:
        """Return the object, the keys in the order of the data, and the storages by key."""
        unpickler = _Unpickler(self._file.read(MAX_PICKLE_BYTES))
        try:
            magic = unpickler.load()
            if type(magic) is not int or magic != MAGIC:
                raise invalid("a wrong magic number")
            protocol, system = unpickler.load(), unpickler.load()
            if type(protocol) is not int or protocol != PROTOCOL or not system["little_endian"]:
                raise invalid(f"protocol {shown(protocol)}, {shown(system)}")
            obj, keys = unpickler.load(), unpickler.load()
            if any(type(key) is not str for key in keys) or set(keys) != unpickler.storages.keys():
                raise invalid("the list of storages does not match the tensors")
        except UnsafePickleError as error:
            raise DataError(
                "the torch file contains foreign code; nothing was run",
                reason="unsafe_pickle",
                where=self.path,
                found=str(error),
                allowed="tensors and plain Python containers",
                fix="get the file again with `dancedata jukebox fetch`, or from the address in docs/jukebox.md",
            ) from None
        except Exception as error:  # a damaged pickle can raise anything: its bytes are a program
            raise SourceError(
                "not a torch file, or a truncated one",
                where=self.path,
                found=f"{self._size} bytes; {shown(error)}",
                allowed="a file that torch.save wrote",
                fix="get the file again",
            ) from error
        self._file.seek(unpickler.stream.tell())
        return obj, keys, unpickler.storages

    def _locate(self, keys: list[str], storages: dict[str, tuple[int, int]]) -> dict[str, tuple[int, int]]:
        """Return the byte position and element count of every storage, by key."""
        names = _tensors(self.object)
        starts: dict[str, tuple[int, int]] = {}
        position = self._file.tell()
        for key in keys:
            item_bytes, count = storages[key]
            starts[key] = (position + 8, count)
            position += 8 + count * item_bytes
            if position > self._size:
                raise self._truncated(names.get(key, f"of storage {key}"), position)
        return starts

    def _truncated(self, name: str, needed: int) -> SourceError:
        return SourceError(
            "the torch file is truncated",
            where=self.path,
            found=f"{self._size} bytes, so the tensor {shown(name)} and all after it are incomplete",
            allowed=f"at least {needed} bytes",
            fix="get the file again (a download can be resumed)",
        )


def _tensors(obj: Any) -> dict[str, str]:
    """Return the names of the tensors in nested dictionaries (the last key), by storage; cycles are allowed."""
    names: dict[str, str] = {}
    seen: set[int] = set()
    level = [("", obj)]
    while level:
        names |= {value.key: name for name, value in level if isinstance(value, LegacyTensor)}
        inner = [value for _, value in level if isinstance(value, dict) and id(value) not in seen]
        seen.update(map(id, inner))
        level = [(str(name), value) for outer in inner for name, value in outer.items()]
    return names
