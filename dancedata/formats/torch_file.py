"""Tensors as torch.save writes them (torch 1.6 and later), as numpy arrays, without torch.

A zip archive, not compressed: NAME/data.pkl, a pickle in which each tensor is a call of
torch._utils._rebuild_tensor_v2 with a storage, and NAME/data/KEY, the elements of each storage.
"""

import zipfile
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dancedata.core.errors import DataError
from dancedata.core.text import quoted, shown
from dancedata.files.regular_file import open_regular
from dancedata.formats.checked_unpickler import ClassName, UnsafePickleError, invalid
from dancedata.formats.numpy_pickle import is_shape
from dancedata.formats.safe_pickle import ARRAY_NAMES, MAX_PICKLE_BYTES, ArrayUnpickler, Names, require_shallow

#: First bytes of a zip archive.
TORCH_HEAD = b"PK\x03\x04"
MAX_MEMBERS = 10_000
#: torch's class of storages -> type and bytes of an element.
STORAGES = {
    "DoubleStorage": ("float64", 8),
    "FloatStorage": ("float32", 4),
    "HalfStorage": ("float16", 2),
    "BFloat16Storage": ("bfloat16", 2),
    "LongStorage": ("int64", 8),
    "IntStorage": ("int32", 4),
    "ShortStorage": ("int16", 2),
    "CharStorage": ("int8", 1),
    "ByteStorage": ("uint8", 1),
    "BoolStorage": ("bool", 1),
}
#: Largest counts, which are int64 in files from before the zip format.
_MAX_COUNT = 1 << 63
STORAGE_NAMES: Names = {("torch", name): ClassName(name) for name in STORAGES}

Array = np.ndarray[Any, Any]


class _Storage:
    """The elements of a storage."""

    def __init__(self, elements: Array) -> None:
        self.elements = elements


def storage_of(pid: Any, length: int) -> tuple[str, int, str, int]:
    """Return type, bytes of an element, key and count of elements of a storage that a pickle refers to."""
    if type(pid) is not tuple or len(pid) != length or pid[0] != "storage" or not isinstance(pid[1], ClassName):
        raise invalid("a reference that torch never writes")
    _, kind, key, _, count = pid[:5]
    if kind.name not in STORAGES or type(key) is not str or type(count) is not int or not 0 <= count < _MAX_COUNT:
        raise invalid(f"a storage named {quoted(key)}")
    return *STORAGES[kind.name], key, count


def require_layout(offset: object, shape: Any, stride: Any) -> None:
    """Raise UnpicklingError unless these can be the place of a tensor in a storage."""
    if type(offset) is not int or not is_shape(shape) or not is_shape(stride) or len(shape) != len(stride):
        raise invalid("a tensor that torch never writes")


def _tensor(storage: object, offset: Any, shape: Any, stride: Any, *_: object) -> Array:
    """Stand for torch._utils._rebuild_tensor_v2."""
    require_layout(offset, shape, stride)
    if not isinstance(storage, _Storage):
        raise invalid("a tensor that torch never writes")
    if 0 in shape:
        return storage.elements[:0].reshape(shape)
    n = len(storage.elements)
    last = offset + sum((size - 1) * step for size, step in zip(shape, stride, strict=True))
    if not 0 <= offset <= last < n:
        raise invalid(f"a tensor of shape {shown(shape)} that reaches beyond its storage")
    steps = tuple(step * storage.elements.itemsize for step in stride)
    return np.lib.stride_tricks.as_strided(storage.elements[offset:], shape, steps, writeable=False)


def _parameter(tensor: Any, *_: object) -> Array:
    if not isinstance(tensor, np.ndarray):
        raise invalid("a parameter that is not a tensor")
    return tensor


_NAMES: Names = {
    **ARRAY_NAMES,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch._utils", "_rebuild_parameter"): _parameter,
    **STORAGE_NAMES,
}


class _Unpickler(ArrayUnpickler):
    """Reads the storages that the pickle refers to, each once."""

    def __init__(self, archive: zipfile.ZipFile, folder: str, data: bytes, size: int) -> None:
        super().__init__(data, _NAMES, size)
        self._archive = archive
        self._folder = folder
        self._order: Literal[">", "<"] = ">" if _member(archive, f"{folder}/byteorder", size) == b"big" else "<"
        self._storages: dict[str, tuple[str, _Storage]] = {}

    def persistent_load(self, pid: Any) -> _Storage:
        dtype, _, key, count = storage_of(pid, 5)
        storage = self._storages.get(key)
        if storage is None:
            storage = self._storages.setdefault(key, (dtype, self._read(key, dtype, count)))
        if storage[0] != dtype or len(storage[1].elements) != count:
            raise invalid(f"two kinds of the storage {quoted(key)}")
        return storage[1]

    def _read(self, key: str, dtype: str, count: int) -> _Storage:
        data = _member(self._archive, f"{self._folder}/data/{key}", self.size)
        bfloat = dtype == "bfloat16"
        kind = np.dtype("uint16" if bfloat else dtype).newbyteorder(self._order)
        if data is None or len(data) != count * kind.itemsize:
            raise invalid(f"the storage {quoted(key)} has {len(data or b''):,} bytes, not {count:,} elements")
        self.count_built(len(data))
        elements = np.frombuffer(data, kind)
        # bfloat16 is the upper half of float32.
        return _Storage((elements.astype("uint32") << 16).view("float32") if bfloat else elements)


def _member(archive: zipfile.ZipFile, name: str, size: int) -> bytes | None:
    try:
        info = archive.getinfo(name)
    except KeyError:
        return None
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > size or info.compress_size > size:
        raise invalid(f"{quoted(name)} is compressed, or larger than the file; torch writes neither")
    return archive.read(info)


def load_torch(path: Path) -> Any:
    """Read what torch.save has written: tensors, as arrays, in plain containers.

    Raises
    ------
    DataError
        "unsafe_pickle" if the file names anything else (which is not executed); "broken_file" if it is truncated or
        not such a file; "too_large".
    """
    try:
        with open_regular(path) as file:
            size = path.stat().st_size
            if size > MAX_PICKLE_BYTES:
                raise invalid(f"{size:,} bytes, more than {MAX_PICKLE_BYTES:,}")
            with zipfile.ZipFile(file) as archive:
                names = archive.namelist()
                heads = [name for name in names if name.count("/") == 1 and name.endswith("/data.pkl")]
                if len(heads) != 1 or len(names) > MAX_MEMBERS:
                    raise invalid("a zip archive without data.pkl, so not one of torch.save")
                pickled = _member(archive, heads[0], size) or b""
                content = _Unpickler(archive, heads[0].partition("/")[0], pickled, size).load()
                require_shallow(content)
    except UnsafePickleError as error:
        raise DataError(
            "the torch file refers to code; nothing was executed",
            reason="unsafe_pickle",
            where=path,
            found=str(error),
            allowed="tensors and plain Python containers",
            fix="save its tensors alone: torch.save({name: tensor.cpu(), ...}, file)",
        ) from None
    except Exception as error:  # zip, pickle: crafted files can raise anything
        raise DataError(
            "the torch file cannot be read",
            reason="broken_file",
            where=path,
            found=shown(error),
            allowed="a file that torch.save (1.6 or later) has written",
            fix="copy the file again; one of an older torch: torch.save(torch.load(old), new)",
        ) from error
    return content
