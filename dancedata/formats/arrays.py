"""Arrays in files of numpy, pickle, joblib and torch: no code is run; headers are checked before memory is taken."""

from __future__ import annotations

import io
import math
import os
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.text import listed, quoted, shown
from dancedata.core.typing import override
from dancedata.files.regular_file import open_regular
from dancedata.formats.safe_pickle import BOMB_BYTES, BOMB_RATIO, MAX_PICKLE_BYTES, as_array, load_pickle
from dancedata.formats.torch_file import TORCH_HEADS, load_torch

#: Kinds of dtypes that are read as numbers; truth values as 0 and 1.
NUMBERS = "fiub"

Array = NDArray[Any]


class ArrayFile:
    """Named arrays of a file; an .npy file and a pickled array have the single name "".

    Attributes
    ----------
    names
        All names in the file, whether or not they hold numbers.
    """

    def __init__(self, path: Path, names: tuple[str, ...]) -> None:
        self.path = path
        self.names = names

    @property
    def listed(self) -> str:
        """The first names, for messages."""
        return listed(self.names, 20, quoted) or "none"

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array of numbers, from its header. DataError if it does not hold numbers."""
        raise NotImplementedError

    def read(self, name: str) -> NDArray[np.float64]:
        """Return an array of numbers as float64. DataError if it does not hold numbers."""
        raise NotImplementedError

    def text(self, name: str) -> str:
        """Return a short text such as a gender, "True" or "False" for a truth value; "" for any other entry."""
        raise NotImplementedError


def text_of(array: Array) -> str:
    """Return the text of an array of one text, "True" or "False" for one truth value; "" for any other."""
    if array.size != 1 or array.dtype.kind not in "USb":
        return ""
    try:
        value = array.reshape(-1)[0]
    except ValueError:  # code points outside Unicode
        return ""
    return value.decode("latin1") if isinstance(value, bytes) else str(value)


def as_numbers(array: Array) -> NDArray[np.float64]:
    """Return an array of numbers as float64."""
    with np.errstate(over="ignore", invalid="ignore"):  # of long doubles; the caller reports infinite values
        return array.astype(np.float64)


def at(path: Path, name: str) -> str:
    """Return the place of an array, for messages."""
    return f"{path}, {shown(name)}" if name else str(path)


def broken(path: Path, found: str) -> DataError:
    """Return the DataError for a file that is not as numpy writes it."""
    return DataError(
        "the motion file cannot be read",
        reason="broken_file",
        where=str(path),
        found=found,
        allowed="an .npy, .npz or .pkl file as numpy writes it",
        fix="copy or save the file again",
    )


def not_numbers(path: Path, name: str, found: str) -> DataError:
    """Return the DataError for something other than an array of numbers."""
    return DataError(
        "not an array of numbers",
        reason="bad_shape",
        where=at(path, name),
        found=found,
        allowed="floats or integers",
        fix="save the motion as an array",
    )


def too_large(path: Path, found: str, allowed: str) -> DataError:
    """Return the DataError for an array, or a file, above its limit."""
    return DataError(
        "the array is larger than the limit",
        reason="too_large",
        where=str(path),
        found=found,
        allowed=allowed,
        fix="split the motion into several files, uncompressed",
    )


#: Names of pickles, files of joblib.dump and files of torch.save; each is recognised by its content.
VALUE_SUFFIXES = (".pkl", ".pk", ".joblib", ".pt", ".pth")

#: Four hours of SMPL-X at 120 FPS in float64 take 2.3 GB; a single motion is far below that.
MAX_ARRAY_BYTES = 1 << 30
MAX_MEMBERS = 1000
#: numpy's own limit, which numpy applies only after allocating the announced length, up to 4 GB.
MAX_HEADER_BYTES = 10_000
#: A member of an .npz archive that is larger is not a short text.
MAX_TEXT_BYTES = 4096


@contextmanager
def open_arrays(path: Path) -> Iterator[ArrayFile]:
    """Open a file; its suffix decides the format (anything but .npz and VALUE_SUFFIXES is read as .npy).

    Raises
    ------
    DataError
        ``broken_file``, ``unsafe_pickle`` (pickled objects), ``bad_shape`` (not numbers), ``too_large``.
    """
    kind = path.suffix.lower()
    if kind in VALUE_SUFFIXES:
        yield ValueArrays(path, load_values(path))
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

    @override
    def shape(self, name: str) -> tuple[int, ...]:
        with _named(self.path), open_regular(self.path) as file:
            return self._header(file).shape

    @override
    def read(self, name: str) -> NDArray[np.float64]:
        with _named(self.path), open_regular(self.path) as file:
            self._header(file)
            file.seek(0)
            return as_numbers(np.lib.format.read_array(file, allow_pickle=False))

    @override
    def text(self, name: str) -> str:
        return ""

    def _header(self, file: IO[bytes]) -> _Header:
        size = os.fstat(file.fileno()).st_size
        return _numeric_header(self.path, "", file, size, size)


def npy_header(path: Path) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return shape and dtype of an .npy file of numbers; DataError as `open_arrays`."""
    with _named(path), open_regular(path) as file:
        header = _numeric_header(path, "", file, size := os.fstat(file.fileno()).st_size, size)
        return header.shape, header.dtype


def read_npy(path: Path) -> Array:
    """Return an .npy file of numbers in its own dtype; DataError as `open_arrays`."""
    with _named(path), open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        _numeric_header(path, "", file, size, size)
        file.seek(0)
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


class _Npz(ArrayFile):
    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
        if len(members) > MAX_MEMBERS:
            raise too_large(path, f"{len(members):,} arrays", f"at most {MAX_MEMBERS:,}")
        self._archive = archive
        self._members = {info.filename.removesuffix(".npy"): info for info in members}
        super().__init__(path, tuple(self._members))

    @override
    def shape(self, name: str) -> tuple[int, ...]:
        with _named(self.path), self._open(name) as file:
            return self._header(name, file).shape

    @override
    def read(self, name: str) -> NDArray[np.float64]:
        with _named(self.path), self._open(name) as file:
            header = self._header(name, file)
        array = self._array(name)
        if (array.shape, array.dtype) != (header.shape, header.dtype):
            raise broken(self.path, f"{name} has two different headers")
        return as_numbers(array)

    @override
    def text(self, name: str) -> str:
        size = self._members[name].file_size
        if size > MAX_TEXT_BYTES:
            return ""
        with _named(self.path), self._open(name) as file:
            header = _read_header(self.path, file)
            if not header.dtype.hasobject:
                _require_size(self.path, name, header, size)
        return text_of(self._array(name))

    def _array(self, name: str) -> Array:
        with _named(self.path), self._open(name) as file:
            # From memory: read_array allocates by the stored bytes, not by the size that the header announces.
            array: Array = np.lib.format.read_array(io.BytesIO(file.read()), allow_pickle=False)
        return array

    def _open(self, name: str) -> IO[bytes]:
        info = self._members[name]
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise broken(self.path, f"{name} has a compression method that numpy never writes")
        size = self.path.stat().st_size
        if info.compress_size > size:
            # zipfile allocates as much memory as this field announces.
            raise broken(self.path, f"{name} announces {info.compress_size:,} compressed bytes in a file of {size:,}")
        return self._archive.open(info)

    def _header(self, name: str, file: IO[bytes]) -> _Header:
        info = self._members[name]
        return _numeric_header(self.path, name, file, info.file_size, info.compress_size)


@dataclass(frozen=True)
class _Header:
    """The header of an .npy file or of a member of an .npz archive."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    #: First byte of the values, and their size by shape and dtype.
    start: int
    n_bytes: int


def _read_header(path: Path, file: IO[bytes]) -> _Header:
    """Parse a header within bounds, or raise DataError (``broken_file``): the only parser of such headers."""
    try:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0), (3, 0)):
            raise ValueError(f"unknown version {version[0]}.{version[1]}")
        field = file.read(2 if version == (1, 0) else 4)
        length = int.from_bytes(field, "little")
        if length > MAX_HEADER_BYTES:
            raise ValueError(f"a header of {length:,} bytes")
        file.seek(-len(field), os.SEEK_CUR)
        parse = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = parse(file)
    except Exception as error:  # tokenize, recursion, memory: crafted headers can raise anything
        raise broken(path, f"no .npy header: {shown(error)}") from error
    if any(type(n) is not int or not 0 <= n <= MAX_ARRAY_BYTES for n in shape):
        raise broken(path, f"an array of shape {str(shape)[:80]}")
    return _Header(shape, dtype, file.tell(), math.prod(shape) * dtype.itemsize)


def _require_size(path: Path, name: str, header: _Header, size: int) -> None:
    """Raise DataError (``broken_file``) unless the file, or member, holds exactly what its header announces."""
    announced = header.start + header.n_bytes
    if size != announced:
        what = f"{name or 'the array'} of shape {header.shape}, {header.dtype}"
        raise broken(path, f"{what}: {size:,} bytes, but its header announces {announced:,}")


def _numeric_header(path: Path, name: str, file: IO[bytes], size: int, compressed: int) -> _Header:
    """Check the header of an array of numbers against the stored and the compressed size of header and values."""
    header = _read_header(path, file)
    if header.dtype.hasobject:
        raise DataError(
            "the file holds pickled Python objects, which are not read",
            reason="unsafe_pickle",
            where=at(path, name),
            found=f"dtype {header.dtype}",
            allowed="arrays of numbers",
            fix="save the numbers themselves",
        )
    if header.dtype.kind not in NUMBERS:
        raise not_numbers(path, name, f"dtype {header.dtype}")
    _require_size(path, name, header, size)
    n_bytes = header.n_bytes
    if n_bytes > MAX_ARRAY_BYTES:
        raise too_large(
            path, f"{name or 'the array'} of shape {header.shape}, {n_bytes:,} bytes", f"{MAX_ARRAY_BYTES:,} bytes"
        )
    if n_bytes > BOMB_BYTES and n_bytes > BOMB_RATIO * max(compressed, 1):
        raise too_large(
            path, f"{name}: {n_bytes:,} bytes packed into {compressed:,}", f"a ratio of at most {BOMB_RATIO}"
        )
    return header


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Turn any exception that numpy or zipfile raise for a broken file into a DataError."""
    try:
        with warnings.catch_warnings():
            # numpy warns about headers written by Python 2, and reads them.
            warnings.simplefilter("ignore")
            yield
    except DataError:
        raise
    except Exception as error:  # zip, zlib, struct, recursion: crafted files can raise anything
        raise broken(path, shown(error)) from error


def load_values(path: Path) -> object:
    """Return the content of a pickle, a file of joblib.dump or one of torch.save, under any name.

    Raises
    ------
    DataError
        ``broken_file``, ``unsafe_pickle``, ``too_large``.
    """
    size = path.stat().st_size if path.is_file() else 0
    if size > MAX_PICKLE_BYTES:
        raise DataError(
            "the file is larger than the limit",
            reason="too_large",
            where=str(path),
            found=f"{size:,} bytes",
            allowed=f"at most {MAX_PICKLE_BYTES:,}",
            fix="save it without what is not the motion, such as WHAM's verts, or run the program on shorter videos",
        )
    return load_torch(path) if _is_torch(path) else load_pickle(path)


def load_object(path: Path) -> object:
    """Return the object in an .npy file with an array () of objects, such as the dict of ``numpy.save(file, {...})``.

    Raises
    ------
    DataError
        ``broken_file``, ``unsafe_pickle``; ``bad_shape`` for any other array.
    """
    with _named(path), open_regular(path) as file:
        header = _read_header(path, file)
    if header.shape != () or not header.dtype.hasobject:
        raise DataError(
            "the file does not hold a dict",
            reason="bad_shape",
            where=str(path),
            found=f"an array {header.shape} of {header.dtype}",
            allowed="an .npy file as numpy.save writes it for a dict: an array () of objects",
            fix="save the motion as a dict, or download the file again",
        )
    cell = load_pickle(path, start=header.start)
    if not isinstance(cell, np.ndarray) or cell.shape != () or cell.dtype != object:
        raise broken(path, f"a pickle of {type(cell).__name__}")
    return cell[()]


def _is_torch(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(20).startswith(TORCH_HEADS)
    except OSError:
        return False  # load_pickle gives the error


class ValueArrays(ArrayFile):
    """The named values of a container; one that has no names is itself the value "".

    Parameters
    ----------
    content
        Of the file, or of a part of it.
    """

    def __init__(self, path: Path, content: object) -> None:
        if not isinstance(content, Mapping):
            content = {"": content}
        self._content = {name: value for name, value in content.items() if isinstance(name, str)}
        super().__init__(path, tuple(self._content))

    @override
    def shape(self, name: str) -> tuple[int, ...]:
        return self._array(name).shape

    @override
    def read(self, name: str) -> NDArray[np.float64]:
        return as_numbers(self._array(name))

    @override
    def text(self, name: str) -> str:
        value = self._content[name]
        if isinstance(value, bytes):
            return value[:20].decode("latin1")
        if isinstance(value, str | bool):
            return str(value)[:20]
        return text_of(np.asarray(value)) if isinstance(value, np.ndarray | np.generic) else ""

    def _array(self, name: str) -> Array:
        array = as_array(self._content[name])
        if array is None:
            value = self._content[name]
            raise not_numbers(self.path, name, f"{type(value).__name__}, {shown(value)}")
        if array.dtype.kind not in NUMBERS:
            raise not_numbers(self.path, name, f"dtype {array.dtype}")
        return array
