"""Arrays in .npy, .npz and .pkl files, read without running anything and without believing what they announce."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.regular_file import open_regular
from dancedata.core.text import listed, quoted, shown
from dancedata.formats.npy_header import require_short_header
from dancedata.formats.safe_pickle import MAX_PICKLE_BYTES, as_array, load_pickle

__all__ = ["MAX_ARRAY_BYTES", "ArrayFile", "open_arrays"]

#: Four hours of SMPL-X at 120 FPS in doubles are 2.3 GB; a motion is far below.
MAX_ARRAY_BYTES = 1 << 30
MAX_MEMBERS = 1000
#: An array above this size that was compressed more than this many times is no motion.
BOMB_BYTES = 1 << 26
BOMB_RATIO = 100
_NUMBERS = "fiu"

Array = NDArray[Any]


class ArrayFile:
    """Named arrays of a file; an .npy file and a pickled array have the one name "".

    Attributes
    ----------
    names : what is there, numbers or not.
    """

    def __init__(self, path: Path, names: tuple[str, ...]) -> None:
        self.path = path
        self.names = names

    @property
    def listed(self) -> str:
        """The first names, for messages."""
        return listed(self.names, 20, quoted) or "none"

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array of numbers, from its header. DataError if it is none."""
        raise NotImplementedError

    def read(self, name: str) -> NDArray[np.float64]:
        """Return an array of numbers as float64. DataError if it is none."""
        raise NotImplementedError

    def text(self, name: str) -> str:
        """Return a short text such as a gender; "" if it is none."""
        raise NotImplementedError


@contextmanager
def open_arrays(path: Path) -> Iterator[ArrayFile]:
    """Open a file by its ending.

    Raises
    ------
    DataError
        ``broken_file``, ``unsafe_pickle`` (pickled objects), ``bad_shape`` (no numbers), ``too_large``.
    """
    kind = path.suffix.lower()
    if kind == ".pkl":
        yield _Pickle(path)
    elif kind == ".npz":
        with ExitStack() as stack:
            with _named(path):
                archive = stack.enter_context(zipfile.ZipFile(stack.enter_context(open_regular(path))))
            yield _Npz(path, archive)
    else:
        yield _Npy(path)


class _Npy(ArrayFile):
    def __init__(self, path: Path) -> None:
        super().__init__(path, ("",))

    def shape(self, name: str) -> tuple[int, ...]:
        with _named(self.path), open_regular(self.path) as file:
            return self._header(file)[0]

    def read(self, name: str) -> NDArray[np.float64]:
        with _named(self.path), open_regular(self.path) as file:
            self._header(file)
            file.seek(0)
            return _numbers(np.lib.format.read_array(file, allow_pickle=False))

    def text(self, name: str) -> str:
        return ""

    def _header(self, file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
        return _header(self.path, "", file, self.path.stat().st_size, self.path.stat().st_size)


class _Npz(ArrayFile):
    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
        if len(members) > MAX_MEMBERS:
            raise _too_large(path, f"{len(members):,} arrays", f"at most {MAX_MEMBERS:,}")
        self._archive = archive
        self._members = {info.filename.removesuffix(".npy"): info for info in members}
        super().__init__(path, tuple(self._members))

    def shape(self, name: str) -> tuple[int, ...]:
        with _named(self.path), self._open(name) as file:
            return self._header(name, file)[0]

    def read(self, name: str) -> NDArray[np.float64]:
        with _named(self.path), self._open(name) as file:
            shape, dtype = self._header(name, file)
        with _named(self.path), self._open(name) as file:
            # Not by the header's size alone: what is stored decides how much is read.
            array: Array = np.lib.format.read_array(io.BytesIO(file.read()), allow_pickle=False)
            if array.shape != shape or array.dtype != dtype:
                raise _broken(self.path, f"two headers in {name}")
            return _numbers(array)

    def text(self, name: str) -> str:
        with _named(self.path), self._open(name) as file:
            if self._members[name].file_size > 4096:
                return ""
            array: Array = np.lib.format.read_array(io.BytesIO(file.read()), allow_pickle=False)
        return _text(array)

    def _open(self, name: str) -> IO[bytes]:
        info = self._members[name]
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise _broken(self.path, f"{name} is compressed in a way that numpy never writes")
        size = self.path.stat().st_size
        if info.compress_size > size:
            # zipfile asks for as much memory as is announced here.
            raise _broken(self.path, f"{name} announces {info.compress_size:,} packed bytes in a file of {size:,}")
        return self._archive.open(info)

    def _header(self, name: str, file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
        info = self._members[name]
        return _header(self.path, name, file, info.file_size, info.compress_size)


class _Pickle(ArrayFile):
    def __init__(self, path: Path) -> None:
        size = path.stat().st_size if path.is_file() else 0
        if size > MAX_PICKLE_BYTES:
            raise _too_large(path, f"{size:,} bytes", f"at most {MAX_PICKLE_BYTES:,}")
        content = load_pickle(path)
        if not isinstance(content, Mapping):
            content = {"": content}
        self._content = {name: value for name, value in content.items() if isinstance(name, str)}
        super().__init__(path, tuple(self._content))

    def shape(self, name: str) -> tuple[int, ...]:
        return self._array(name).shape

    def read(self, name: str) -> NDArray[np.float64]:
        return _numbers(self._array(name))

    def text(self, name: str) -> str:
        value = self._content[name]
        if isinstance(value, bytes):
            return value[:20].decode("latin1")
        return value[:20] if isinstance(value, str) else _text(np.asarray(value)) if _is_array(value) else ""

    def _array(self, name: str) -> Array:
        array = as_array(self._content[name])
        if array is None:
            value = self._content[name]
            raise _no_numbers(self.path, name, f"{type(value).__name__}, {shown(value)}")
        if array.dtype.kind not in _NUMBERS:
            raise _no_numbers(self.path, name, f"dtype {array.dtype}")
        return array


def _is_array(value: object) -> bool:
    return isinstance(value, (np.ndarray, np.generic))


def _text(array: Array) -> str:
    if array.size != 1 or array.dtype.kind not in "US":
        return ""
    try:
        value = array.reshape(-1)[0]
    except ValueError:  # numbers that are no characters
        return ""
    return value.decode("latin1") if isinstance(value, bytes) else str(value)


def _numbers(array: Array) -> NDArray[np.float64]:
    with np.errstate(over="ignore", invalid="ignore"):  # of long doubles; what is infinite is reported by who asked
        return array.astype(np.float64)


def _header(
    path: Path, name: str, file: IO[bytes], size: int, compressed: int
) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Check the header of an array against what the file holds, before any memory is taken."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise _no_numbers(path, name, f"an array of format {version[0]}.{version[1]}")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    require_short_header(file, version)
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise DataError(
            "the file holds pickled Python objects, which are not read",
            reason="unsafe_pickle",
            where=_at(path, name),
            found=f"dtype {dtype}",
            allowed="arrays of numbers",
            fix="save the numbers themselves",
        )
    if dtype.kind not in _NUMBERS:
        raise _no_numbers(path, name, f"dtype {dtype}")
    if any(type(n) is not int or not 0 <= n <= MAX_ARRAY_BYTES for n in shape):
        raise _broken(path, f"an array of shape {str(shape)[:80]}")
    wanted = math.prod(shape) * dtype.itemsize
    if wanted > MAX_ARRAY_BYTES or size > MAX_ARRAY_BYTES + 65536:
        raise _too_large(path, f"{name or 'the array'} of shape {shape}, {wanted:,} bytes", f"{MAX_ARRAY_BYTES:,}")
    if wanted > BOMB_BYTES and wanted > BOMB_RATIO * max(compressed, 1):
        raise _too_large(path, f"{name}: {wanted:,} bytes packed into {compressed:,}", f"{BOMB_RATIO}-fold at most")
    if size != file.tell() + wanted:
        raise _broken(path, f"{name or 'the array'}: {size:,} bytes where its header wants {file.tell() + wanted:,}")
    return shape, dtype


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Turn whatever a broken file makes numpy and zipfile raise into a DataError."""
    import warnings

    try:
        with warnings.catch_warnings():
            # numpy warns of headers that Python 2 wrote, and reads them.
            warnings.simplefilter("ignore")
            yield
    except DataError:
        raise
    except Exception as error:  # zip, zlib, struct, tokenize, recursion: a file made up to hurt can raise anything
        raise _broken(path, shown(error)) from error


def _at(path: Path, name: str) -> str:
    return f"{path}, {shown(name)}" if name else str(path)


def _broken(path: Path, found: str) -> DataError:
    return DataError(
        "the motion file cannot be read",
        reason="broken_file",
        where=str(path),
        found=found,
        allowed=".npy, .npz or .pkl as numpy writes them",
        fix="copy or save the file again",
    )


def _no_numbers(path: Path, name: str, found: str) -> DataError:
    return DataError(
        "this is no array of numbers",
        reason="bad_shape",
        where=_at(path, name),
        found=found,
        allowed="floats or whole numbers",
        fix="save the motion as an array",
    )


def _too_large(path: Path, found: str, allowed: str) -> DataError:
    return DataError(
        "the file announces more than is read; nothing was read",
        reason="too_large",
        where=str(path),
        found=found,
        allowed=allowed,
        fix="cut the motion into several files, uncompressed",
    )
