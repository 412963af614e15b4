"""Tensors as torch.save writes them, as numpy arrays: by torch's reader that runs no code, after a check of its own.

torch.load(weights_only=True) calls `bytearray(n)` and `torch.FloatTensor(n)` with any n, and hashes keys of any kind.
The pickle is therefore read without tensors first, by the unpickler of all other files. That checks the states of
numpy's arrays as well, which torch would pass on.
"""

import io
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from packaging.version import Version

from dancedata.core.errors import DataError
from dancedata.core.packages import MissingPackageError, require
from dancedata.core.text import quoted, shown
from dancedata.files.regular_file import read_regular
from dancedata.formats.safe_pickle import (
    ARRAY_NAMES,
    MAX_PICKLE_BYTES,
    ArrayUnpickler,
    ClassName,
    Names,
    UnsafePickleError,
    invalid,
)

#: First bytes: of a zip archive, and of files from before torch 1.6, which begin with a number of 10 bytes.
TORCH_HEADS = (b"PK\x03\x04", pickle.dumps(0x1950A86A20F9469CFC6C, 2))
#: torch's class of storages -> bytes of an element.
_STORAGES = {
    **{"Double": 8, "Float": 4, "Half": 2, "BFloat16": 2},
    **{"Long": 8, "Int": 4, "Short": 2, "Char": 1, "Byte": 1, "Bool": 1},
}
_NAMES: Names = {
    **ARRAY_NAMES,
    **{("torch", f"{kind}Storage"): ClassName(kind) for kind in _STORAGES},
    ("torch", "Size"): lambda sizes: sizes,
    ("torch", "device"): lambda *_: None,
    **{("torch", dtype): ClassName(dtype) for dtype in ("Tensor", "bool", "bfloat16", "uint8")},
    **{("torch", f"{kind}{bits}"): ClassName(kind) for kind in ("float", "int") for bits in (8, 16, 32, 64)},
    ("torch.nn.parameter", "Parameter"): ClassName("Parameter"),
    ("torch._tensor", "_rebuild_from_type_v2"): lambda *_: None,
    **{
        ("torch._utils", f"_rebuild_{what}"): lambda *_: None
        for what in ("tensor", "tensor_v2", "parameter", "parameter_with_state")
    },
}
#: weights_only ran code before.
_SAFE_TORCH = Version("2.6")
#: Views of storages take no memory, but their copies do: together at most this, or this many times the file.
_VIEWED_BYTES, _VIEWED_FACTOR = MAX_PICKLE_BYTES, 8


class _Check(ArrayUnpickler):
    """Reads all of a pickle but its tensors; their storages are together at most as large as the file."""

    def __init__(self, data: bytes, size: int, pid_length: int) -> None:
        super().__init__(data, _NAMES, size)
        self._size, self._pid_length = size, pid_length
        self.storages: dict[str, int] = {}

    def set_state(self, state: Any, target: Any) -> None:
        if not isinstance(target, OrderedDict):  # a state dict has an attribute _metadata
            super().set_state(state, target)

    def persistent_load(self, pid: Any) -> None:
        if type(pid) is not tuple or len(pid) != self._pid_length or pid[0] != "storage":
            raise invalid("a reference that torch never writes")
        _, kind, key, _, count = pid[:5]
        item_bytes = _STORAGES.get(kind.name) if isinstance(kind, ClassName) else None
        if item_bytes is None or type(key) is not str or type(count) is not int or not 0 <= count < 1 << 63:
            raise invalid(f"a storage named {quoted(key)}")
        self.storages[key] = max(count * item_bytes, self.storages.get(key, 0))
        if self.storages[key] > self._size or sum(self.storages.values()) > self._size:
            raise invalid(f"a storage of {count:,} elements, which is larger than the file")


def torch_for(path: Path) -> Any:
    """Return torch for reading a file of torch.save; MissingPackageError if it is missing, or older than 2.6."""
    require("torch", what=f"{path}, a file of torch.save,")
    import torch

    if Version(torch.__version__) < _SAFE_TORCH:
        raise MissingPackageError(f"{path} needs torch 2.6 or later", found=torch.__version__, fix="update torch")
    return torch


def load_torch(path: Path) -> Any:
    """Read, without running code, what torch.save wrote: tensors, as arrays, in plain containers; else DataError."""
    try:
        torch = torch_for(path)
        data = read_regular(path, MAX_PICKLE_BYTES)
        _check(data, torch)
        with torch.serialization.safe_globals(_numpy_names()):
            content = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
        return _Arrays(len(data), torch).of(content)
    except UnsafePickleError as error:
        raise DataError(
            "the torch file refers to code; nothing was executed",
            reason="unsafe_pickle",
            where=path,
            found=str(error),
            allowed="tensors and plain Python containers",
            fix="save its tensors alone: torch.save({name: tensor.cpu(), ...}, file)",
        ) from None
    except MissingPackageError as error:  # the other clips of a folder are read
        raise DataError(
            "reading a torch file needs torch", reason="broken_file", where=path, found=str(error), fix=error.fix
        ) from None
    except Exception as error:  # zip, pickle: crafted files can raise anything
        raise DataError(
            "the torch file cannot be read",
            reason="broken_file",
            where=path,
            found=shown(error),
            allowed="a file that torch.save has written",
            fix="copy the file again, or save its tensors alone: torch.save({name: tensor.cpu(), ...}, file)",
        ) from error


def _check(data: bytes, torch: Any) -> None:
    if not data.startswith(TORCH_HEADS[0]):
        check = _Check(data, len(data), 6)
        *_, keys = [check.load() for _ in ("number", "version", "machine", "content", "keys of storages")]
        if type(keys) is not list or set(keys) != check.storages.keys():
            raise invalid("its storages are not those that its tensors have")
        return
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if sum(member.file_size for member in archive.infolist()) > len(data):
            raise invalid("its members are compressed, which torch never does")
    # By torch, so that it is the pickle that torch reads.
    _Check(torch._C.PyTorchFileReader(io.BytesIO(data)).get_record("data.pkl"), len(data), 5).load()


def _numpy_names() -> list[Any]:
    """Return what numpy's arrays are made of in a pickle, whose states have been checked."""
    reconstruct, scalar = np.zeros(1).__reduce__()[0], np.float64().__reduce__()[0]
    dtypes = {type(np.dtype(code)) for code in "?bBhHiIlLqQefdSUO"}
    return [
        (np.ndarray, "numpy.ndarray"),
        (np.dtype, "numpy.dtype"),
        *((reconstruct, f"numpy.{core}.multiarray._reconstruct") for core in ("core", "_core")),
        *((scalar, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")),
        *((dtype, f"numpy.dtypes.{dtype.__name__}") for dtype in dtypes),
    ]


class _Arrays:
    """Turns tensors to arrays, each once; what is counted is views that are copied, not storages."""

    def __init__(self, size: int, torch: Any) -> None:
        self._left = max(_VIEWED_BYTES, _VIEWED_FACTOR * size)
        self._torch = torch
        self._made: dict[int, Any] = {}

    def of(self, value: Any) -> Any:
        if id(value) not in self._made:
            self._made[id(value)] = self._of(value)
        return self._made[id(value)]

    def _of(self, value: Any) -> Any:
        if isinstance(value, self._torch.Tensor):
            self._left -= value.nbytes
            if self._left < 0:
                raise invalid("its tensors show their storages far more often than the file is long")
            tensor = value.detach()
            return (tensor.float() if tensor.dtype == self._torch.bfloat16 else tensor).numpy()
        if isinstance(value, Mapping):
            return {key: self.of(inner) for key, inner in value.items()}
        return [self.of(inner) for inner in value] if isinstance(value, list | tuple) else value
