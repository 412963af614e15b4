"""Tensors of torch files, read one at a time."""

import os
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
import torch
from torch._weights_only_unpickler import Unpickler
from torch._weights_only_unpickler import load as unpickle

from dancedata.audio.jukebox.network.tensors import TensorSpec
from dancedata.core.errors import SourceError
from dancedata.core.text import listed, shown
from dancedata.formats.torch_file import torch_for

_FLOATING = (torch.float16, torch.bfloat16, torch.float32)


class TensorSource(Protocol):
    """Named tensors on disk, read one at a time; those of `tensors` have a shape and a type."""

    path: Path
    tensors: Mapping[str, torch.Tensor]

    def read(self, name: str, rows: int) -> torch.Tensor:
        """Read the leading rows into separate memory, on the CPU, in the stored type."""


class TorchFile:
    """A torch file of tensors and plain containers; tensors are read one at a time.

    torch's own unpickler for weights reads it, which runs no code: of the zip format by `torch.load`, mapped into
    memory, of the one before torch 1.6, as OpenAI's, its head alone.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._places: dict[int, int] = {}
        torch_for(path)
        try:
            with path.open("rb") as file, torch.serialization.safe_globals(_STAND_INS):
                if file.read(4) == b"PK\x03\x04":
                    loaded = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
                else:
                    file.seek(0)
                    loaded = self._head(file)
        except Exception as error:  # torch may raise anything for a damaged file
            raise SourceError("torch cannot read this file as weights; nothing of it was run", where=path,
                              found=shown(error),
                              allowed="a complete file that torch.save wrote, of tensors and plain containers",
                              fix="get the file again with `dancedata pull jukebox`") from error  # fmt: skip
        self.tensors: Mapping[str, torch.Tensor] = {
            name: tensor for name, tensor in _model(loaded, path).items() if isinstance(tensor, torch.Tensor)
        }

    def _head(self, file: BinaryIO) -> Any:
        """Return the object of a file from before torch 1.6, tensors without memory; note where their storages are.

        The file is five pickles: a number, a version, the machine, the object, the keys of its storages; then for
        each key a count of elements, int64, and the elements.
        """
        storages: dict[str, Any] = {}
        counts: dict[str, int] = {}

        def storage(pid: tuple[Any, ...]) -> Any:
            kind, (key, _, count, view) = pid[1].dtype, pid[2:]
            if view is not None:
                raise ValueError("a storage that is part of another, which torch has not written since 0.4")
            whole = storages.setdefault(key, _Storage(count * kind.itemsize, device="meta"))
            counts[key] = count
            return _TypedStorage(wrap_storage=whole, dtype=kind, _internal=True)

        if unpickle(file) != _MAGIC or unpickle(file) != _VERSION or not unpickle(file)["little_endian"]:
            raise ValueError("not a file of torch.save on a little-endian machine")
        unpickler = _Unpickler(file, encoding="utf-8")
        unpickler.persistent_load = storage
        loaded, keys = unpickler.load(), unpickle(file)
        size, position = os.fstat(file.fileno()).st_size, file.tell()
        for key in keys:
            self._places[storages[key]._cdata] = position + 8
            file.seek(position)
            if (found := int.from_bytes(file.read(8), "little")) != counts[key] and position + 8 <= size:
                raise ValueError(f"a storage of {found} elements, which has {counts[key]} in the head of the file")
            position += 8 + storages[key].nbytes()
        if position > size:
            raise ValueError(f"the file is truncated: {size:,} of {position:,} bytes")
        return loaded

    def read(self, name: str, rows: int) -> torch.Tensor:
        """Read the leading rows into separate memory, in the stored type."""
        part = self.tensors[name][:rows]
        if not part.numel():
            return torch.empty(part.shape, dtype=part.dtype)
        if not part.is_meta:
            return part.clone(memory_format=torch.contiguous_format)
        count = 1 + sum((n - 1) * step for n, step in zip(part.shape, part.stride(), strict=True))
        start = self._places[part.untyped_storage()._cdata] + part.storage_offset() * part.itemsize
        data = np.fromfile(self.path, np.uint8, count * part.itemsize, offset=start)
        return torch.frombuffer(data, dtype=part.dtype).as_strided(part.shape, part.stride()).contiguous()


#: Classes of torch whose arguments have no types.
_Unpickler: Any = Unpickler
_Storage: Any = torch.UntypedStorage
_TypedStorage: Any = torch.storage.TypedStorage
#: First pickles of a file from before torch 1.6.
_MAGIC, _VERSION = 0x1950A86A20F9469CFC6C, 1001
_NUMBER = np.float64().__reduce__()[0]
#: What stands for OpenAI's class of hyperparameters, which is a dict; and numpy's numbers, which may be in them.
_STAND_INS: list[Any] = [
    (OrderedDict, "jukebox.hparams.Hyperparams"), np.dtype, *(type(np.dtype(kind)) for kind in "fdilqbB?"),
    *((_NUMBER, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")),
]  # fmt: skip


def open_torch_file(path: Path) -> TorchFile:
    """Open a torch file of either format; SourceError if it does not exist, is of neither, or is damaged."""
    if not path.is_file():
        raise SourceError(
            "a file of the Jukebox checkpoint is missing",
            where=path,
            found=sorted(p.name for p in path.parent.iterdir())[:10] if path.parent.is_dir() else "no such folder",
            fix="get it with `dancedata pull jukebox`, from OpenAI, a mirror or another folder",
        )
    return TorchFile(path)


def _model(loaded: Any, path: Path) -> Mapping[str, Any]:
    """Return the dictionary of tensors, without the prefix that distributed training adds to their names."""
    model = loaded.get("model") if isinstance(loaded, dict) else None
    if not isinstance(model, dict):
        raise SourceError("the torch file is not a Jukebox checkpoint", where=path,
                          found=f"keys {shown(list(loaded))}" if isinstance(loaded, dict) else type(loaded).__name__,
                          allowed="a dictionary with the key 'model'")  # fmt: skip
    return {str(name).removeprefix("module."): tensor for name, tensor in model.items()}


def require_tensors(source: TensorSource, specs: Iterable[TensorSpec]) -> None:
    """Raise SourceError unless tensors are there, floating-point and of their shape; the first ten are named."""
    problems = []
    for spec in specs:
        if spec.name not in source.tensors:
            problems.append(f"{spec.name} is missing")
            continue
        shape, dtype = tuple(source.tensors[spec.name].shape), source.tensors[spec.name].dtype
        if shape != spec.shape:
            problems.append(f"{spec.name} has shape {shown(shape)}, not {spec.shape}")
        elif dtype not in _FLOATING:
            problems.append(f"{spec.name} is {dtype}, not {spec.dtype}")
    if problems:
        raise SourceError(
            "the tensors of the checkpoint do not match the network",
            where=source.path,
            found=listed(problems, 10, lambda problem, _limit: str(problem)),
            fix="use the complete 5b model without lyrics, or write the sizes of another network into sizes.json",
        )
