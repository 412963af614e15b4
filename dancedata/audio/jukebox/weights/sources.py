"""Sources of tensors: one interface for legacy torch files, zip torch files and safetensors folders."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import torch

from dancedata.audio.jukebox.network.tensors import TensorSpec
from dancedata.audio.jukebox.weights.legacy_file import LegacyFile, LegacyTensor
from dancedata.core.errors import SourceError
from dancedata.core.text import listed, shown
from dancedata.core.typing import override

_FLOATING = (torch.float16, torch.bfloat16, torch.float32)


class TensorSource(Protocol):
    """Named tensors on disk, read one at a time."""

    path: Path

    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Shape of every tensor, by name."""

    def dtype(self, name: str) -> torch.dtype:
        """Type of a tensor."""

    def read(self, name: str, rows: int) -> torch.Tensor:
        """Read the leading rows into separate memory, on the CPU, in the stored type."""

    def close(self) -> None:
        """Close all open files."""


class _Closing:
    """Base of sources: a context manager."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close all open files; by default there are none."""


class LegacySource(_Closing):
    """A torch file from before the zip format, read lazily."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = LegacyFile(path)
        try:
            self._tensors: dict[str, LegacyTensor] = {
                name: tensor
                for name, tensor in _model(self._file.object, path).items()
                if isinstance(tensor, LegacyTensor)
            }
        except BaseException:
            self._file.close()
            raise

    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Shape of every tensor, by name."""
        return {name: tensor.shape for name, tensor in self._tensors.items()}

    def dtype(self, name: str) -> torch.dtype:
        """Type of a tensor."""
        dtype: torch.dtype = getattr(torch, self._tensors[name].dtype)
        return dtype

    def read(self, name: str, rows: int) -> torch.Tensor:
        """Read the leading rows into separate memory, in the stored type."""
        stored = self._tensors[name]
        tensor = torch.empty(stored.span(rows), dtype=self.dtype(name))
        # numpy has no bfloat16: the buffer is the plain bytes.
        self._file.read_into(stored, name, tensor.view(torch.uint8).numpy().data)
        shape = (rows, *stored.shape[1:])
        return tensor.as_strided(shape, stored.stride).contiguous()

    @override
    def close(self) -> None:
        self._file.close()


class ZipSource(_Closing):
    """A torch file of the zip format, mapped into memory."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            loaded = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
        except Exception as error:  # torch may raise anything for a damaged file
            raise SourceError(
                "torch cannot read this file as weights",
                where=path,
                found=shown(error),
                allowed="a complete file that torch.save wrote, of tensors and plain containers",
                fix="get the file again",
            ) from error
        self._tensors: dict[str, torch.Tensor] = {
            name: tensor for name, tensor in _model(loaded, path).items() if isinstance(tensor, torch.Tensor)
        }

    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Shape of every tensor, by name."""
        return {name: tuple(tensor.shape) for name, tensor in self._tensors.items()}

    def dtype(self, name: str) -> torch.dtype:
        """Type of a tensor."""
        return self._tensors[name].dtype

    def read(self, name: str, rows: int) -> torch.Tensor:
        """Read the leading rows into separate memory, in the stored type."""
        return self._tensors[name][:rows].clone(memory_format=torch.contiguous_format)

    @override
    def close(self) -> None:
        self._tensors = {}


class SafetensorsSource(_Closing):
    """Several safetensors files as one source; one file is open at a time, so that little memory is mapped.

    Parameters
    ----------
    path
        The folder.
    files
        File names in it.
    """

    def __init__(self, path: Path, files: Iterable[str]) -> None:
        self.path = path
        self._homes: dict[str, str] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._dtypes: dict[str, torch.dtype] = {}
        self._open_name = ""
        self._open_file: Any = None
        for file in files:
            opened = self._opened(file)
            # An open safetensors file is not a dict.
            for name in opened.keys():  # noqa: SIM118
                part = opened.get_slice(name)
                self._homes[name] = file
                self._shapes[name] = tuple(part.get_shape())
                self._dtypes[name] = _SAFETENSORS_DTYPES.get(part.get_dtype(), torch.uint8)

    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Shape of every tensor, by name."""
        return self._shapes

    def dtype(self, name: str) -> torch.dtype:
        """Type of a tensor."""
        return self._dtypes[name]

    def read(self, name: str, rows: int) -> torch.Tensor:
        """Read the leading rows into separate memory, in the stored type."""
        part: torch.Tensor = self._opened(self._homes[name]).get_slice(name)[:rows]
        # A slice may be a view of the mapped file.
        return part.clone()

    @override
    def close(self) -> None:
        self._open_file, self._open_name = None, ""

    def _opened(self, file: str) -> Any:
        from safetensors import SafetensorError, safe_open

        if file != self._open_name:
            self.close()
            try:
                self._open_file = safe_open(self.path / file, framework="pt", device="cpu")
            except (OSError, SafetensorError) as error:
                raise SourceError(
                    "a file of the converted checkpoint cannot be read",
                    where=self.path / file,
                    found=shown(error),
                    fix="copy the folder again, or convert again",
                ) from error
            self._open_name = file
        return self._open_file


_SAFETENSORS_DTYPES = {"F16": torch.float16, "BF16": torch.bfloat16, "F32": torch.float32}


def open_torch_file(path: Path) -> LegacySource | ZipSource:
    """Open a torch file of either format.

    Raises
    ------
    SourceError
        The file does not exist, is of neither format, or is damaged.
    DataError
        "unsafe_pickle".
    """
    if not path.is_file():
        raise SourceError(
            "a file of the Jukebox checkpoint is missing",
            where=path,
            found=sorted(p.name for p in path.parent.iterdir())[:10] if path.parent.is_dir() else "no such folder",
            fix="get it with `dancedata jukebox fetch`, from OpenAI, a mirror or another folder",
        )
    with path.open("rb") as file:
        start = file.read(4)
    return ZipSource(path) if start == b"PK\x03\x04" else LegacySource(path)


def _model(loaded: Any, path: Path) -> Mapping[str, Any]:
    """Return the dictionary of tensors, without the prefix that distributed training adds to their names."""
    model = loaded.get("model") if isinstance(loaded, dict) else None
    if not isinstance(model, dict):
        raise SourceError(
            "the torch file is not a Jukebox checkpoint",
            where=path,
            found=f"keys {shown(list(loaded))}" if isinstance(loaded, dict) else type(loaded).__name__,
            allowed="a dictionary with the key 'model'",
        )
    return {str(name).removeprefix("module."): tensor for name, tensor in model.items()}


def require_tensors(source: TensorSource, specs: Iterable[TensorSpec], *, trimmed: bool = False) -> None:
    """Check that a source has these tensors.

    Parameters
    ----------
    trimmed
        The source has only the needed rows, as a converted checkpoint does. More rows than needed are accepted.

    Raises
    ------
    SourceError
        Tensors are missing, or have another shape or a type that is not floating-point; the first ten are named.
    """
    shapes = source.shapes()
    problems = []
    for spec in specs:
        if spec.name not in shapes:
            problems.append(f"{spec.name} is missing")
            continue
        shape, dtype = shapes[spec.name], source.dtype(spec.name)
        if trimmed and shape[1:] == spec.shape[1:] and spec.rows <= shape[0] <= spec.shape[0]:
            shape = spec.shape
        if shape != spec.shape:
            problems.append(f"{spec.name} has shape {shown(shape)}, not {spec.shape}")
        elif dtype not in _FLOATING:
            problems.append(f"{spec.name} is {dtype}, not {spec.dtype}")
    if problems:
        raise SourceError(
            "the tensors of the checkpoint do not match the network",
            where=source.path,
            found=listed(problems, 10, lambda problem, _limit: str(problem)),
            fix="use the complete 5b model without lyrics, or pass the JukeboxConfig of another size",
        )
