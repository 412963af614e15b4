"""Arrays in files of numpy: no code is run; headers are checked before memory is taken."""

from __future__ import annotations

import io
import math
import os
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.text import listed, quoted, shown
from dancedata.core.typing import override
from dancedata.files.regular_file import open_regular
from dancedata.formats.safe_pickle import BOMB_BYTES, BOMB_RATIO, MAX_PICKLE_BYTES, unpickled

#: Kinds of dtypes that are read as numbers; truth values as 0 and 1.
NUMBERS = "fiub"

Array = NDArray[Any]


class ArrayFile:
    """Named arrays of a file; that of an .npy file is named "". `names` lists all, whether of numbers or not."""

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
        return ""

    def texts(self, name: str) -> tuple[str, ...]:
        """Return the texts of a list, such as the names of joints; none for any other entry."""
        return ()


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
    return DataError("the motion file cannot be read", reason="broken_file", where=str(path), found=found,
                     allowed="an .npy, .npz or .pkl file as numpy writes it",
                     fix="copy or save the file again")  # fmt: skip


def not_numbers(path: Path, name: str, found: str) -> DataError:
    """Return the DataError for something other than an array of numbers."""
    return DataError("not an array of numbers", reason="bad_shape", where=at(path, name), found=found,
                     allowed="floats or integers", fix="save the motion as an array")  # fmt: skip


def too_large(path: Path, found: str, allowed: str) -> DataError:
    """Return the DataError for an array, or a file, above its limit."""
    return DataError("the array is larger than the limit", reason="too_large", where=str(path), found=found,
                     allowed=allowed, fix="split the motion into several files, uncompressed")  # fmt: skip


#: Four hours of SMPL-X at 120 FPS in float64 take 2.3 GB; a single motion is far below that.
MAX_ARRAY_BYTES = 1 << 30
MAX_MEMBERS = 1000
#: numpy's own limit, which numpy applies only after allocating the announced length, up to 4 GB.
MAX_HEADER_BYTES = 10_000
#: A member of an .npz archive that is larger is not a short text.
_MAX_TEXT_BYTES = 4096
#: A list of texts that is larger is not one of names.
MAX_TEXTS_BYTES = 1 << 16


class NpyFile(ArrayFile):
    """An .npy file of numbers; errors as `formats.values.open_arrays`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, ("",))

    @override
    def shape(self, name: str) -> tuple[int, ...]:
        return npy_header(self.path).shape

    @override
    def read(self, name: str) -> NDArray[np.float64]:
        return as_numbers(read_npy(self.path))


def npy_header(path: Path) -> Header:
    """Return the header of an .npy file of numbers; DataError as `formats.values.open_arrays`."""
    with reading(path), open_regular(path) as file:
        return _numeric_header(path, "", file, size := os.fstat(file.fileno()).st_size, size)


def read_npy(path: Path) -> Array:
    """Return an .npy file of numbers in its own dtype; DataError as `formats.values.open_arrays`."""
    with reading(path), open_regular(path) as file:
        _numeric_header(path, "", file, size := os.fstat(file.fileno()).st_size, size)
        file.seek(0)
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


class NpzFile(ArrayFile):
    """The arrays of an .npz archive."""

    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
        if len(members) > MAX_MEMBERS:
            raise too_large(path, f"{len(members):,} arrays", f"at most {MAX_MEMBERS:,}")
        self._archive = archive
        self._members = {info.filename.removesuffix(".npy"): info for info in members}
        super().__init__(path, tuple(self._members))

    @override
    def shape(self, name: str) -> tuple[int, ...]:
        with reading(self.path), self._open(name) as file:
            return self._header(name, file).shape

    @override
    def read(self, name: str) -> NDArray[np.float64]:
        with reading(self.path), self._open(name) as file:
            header = self._header(name, file)
        array = self._array(name)
        if (array.shape, array.dtype) != (header.shape, header.dtype):
            raise broken(self.path, f"{name} has two different headers")
        return as_numbers(array)

    @override
    def text(self, name: str) -> str:
        size = self._members[name].file_size
        if size > _MAX_TEXT_BYTES:
            return ""
        with reading(self.path), self._open(name) as file:
            header = read_header(self.path, file)
            if not header.dtype.hasobject:
                _require_size(self.path, name, header, size)
        return text_of(self._array(name))

    @override
    def texts(self, name: str) -> tuple[str, ...]:
        header = self._any_header(name)
        if header.dtype.kind != "U" or len(header.shape) != 1 or header.n_bytes > MAX_TEXTS_BYTES:
            return ()
        _require_size(self.path, name, header, self._members[name].file_size)
        with reading(self.path):
            return tuple(map(str, self._array(name).tolist()))

    @property
    def holds_objects(self) -> bool:
        """Whether it has pickled objects and no array of two dimensions besides."""
        headers = [self._any_header(name) for name in self.names]
        is_array = any(len(header.shape) > 1 and header.dtype.kind in NUMBERS for header in headers)
        return not is_array and any(header.dtype.hasobject for header in headers)

    def values(self) -> dict[str, object]:
        """Return all members by name, objects as the pickles in them."""
        found: dict[str, object] = {}
        for name in self.names:
            header = self._any_header(name)
            if header.dtype.hasobject:
                found[name] = unpickled(partial(self._unpacked, name), self.path, start=header.start)
            elif header.n_bytes <= _MAX_TEXT_BYTES:
                found[name] = self._array(name)
        return found

    def _unpacked(self, name: str) -> tuple[bytes, int]:
        """Return the bytes of a member, and their size in the file."""
        size = self._members[name].compress_size
        allowed = min(MAX_PICKLE_BYTES, max(BOMB_BYTES, BOMB_RATIO * size))
        with self._open(name) as file:
            data = file.read(allowed + 1)
        if len(data) > allowed:
            raise ValueError(f"{name}: {size:,} bytes unpack to more than {allowed:,}")
        return data, size

    def _any_header(self, name: str) -> Header:
        with reading(self.path), self._open(name) as file:
            return read_header(self.path, file)

    def _array(self, name: str) -> Array:
        with reading(self.path), self._open(name) as file:
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

    def _header(self, name: str, file: IO[bytes]) -> Header:
        info = self._members[name]
        return _numeric_header(self.path, name, file, info.file_size, info.compress_size)


@dataclass(frozen=True)
class Header:
    """The header of an .npy file or of a member of an .npz archive."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    #: First byte of the values, and their size by shape and dtype.
    start: int
    n_bytes: int


def read_header(path: Path, file: IO[bytes]) -> Header:
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
    return Header(shape, dtype, file.tell(), math.prod(shape) * dtype.itemsize)


def _require_size(path: Path, name: str, header: Header, size: int) -> None:
    """Raise DataError (``broken_file``) unless the file, or member, holds exactly what its header announces."""
    announced = header.start + header.n_bytes
    if size != announced:
        what = f"{name or 'the array'} of shape {header.shape}, {header.dtype}"
        raise broken(path, f"{what}: {size:,} bytes, but its header announces {announced:,}")


def _numeric_header(path: Path, name: str, file: IO[bytes], size: int, compressed: int) -> Header:
    """Check the header of an array of numbers against the stored and the compressed size of header and values."""
    header = read_header(path, file)
    if header.dtype.hasobject:
        raise DataError("the file holds pickled Python objects, which are not read", reason="unsafe_pickle",
                        where=at(path, name), found=f"dtype {header.dtype}", allowed="arrays of numbers",
                        fix="save the numbers themselves")  # fmt: skip
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
def reading(path: Path) -> Iterator[None]:
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


@contextmanager
def open_npz(path: Path) -> Iterator[NpzFile]:
    """Open an archive of arrays; DataError ``broken_file``, ``too_large``."""
    with ExitStack() as stack:
        with reading(path):
            archive = stack.enter_context(zipfile.ZipFile(stack.enter_context(open_regular(path))))
        yield NpzFile(path, archive)


#: Entries that state whether columns are normalised, and by which scaler.
_NORMALIZED, _SCALER = "normalized", "scaler_sha256"


@dataclass(frozen=True)
class StatedScaling:
    """What a file states of its columns: whether they are normalised, None without a word; and the scaler's hash."""

    normalized: bool | None = None
    scaler: str = ""


#: Of columns of which no file states anything.
UNSTATED = StatedScaling()


def stated_scaling(arrays: ArrayFile) -> StatedScaling:
    """Return what the entries "normalized" and "scaler_sha256" state; DataError "undeclared" unless true or false."""
    scaler = arrays.text(_SCALER) if _SCALER in arrays.names else ""
    if _NORMALIZED not in arrays.names:
        return StatedScaling(None, scaler)
    text = arrays.text(_NORMALIZED)
    if text not in ("True", "False"):
        raise DataError(f"the entry {_NORMALIZED!r} is not a truth value", reason="undeclared",
                        where=str(arrays.path),
                        found=text, allowed="True, False")  # fmt: skip
    return StatedScaling(text == "True", scaler)
