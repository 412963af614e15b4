"""Opens, reads and writes HDF5 files. h5py has no type annotations, so its objects are typed Any."""

import io
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.core.text import shown
from dancedata.store.schema import ALIGNMENT

_PAGE = 1 << 16


class SparseFile(io.RawIOBase):
    """A seekable file of any size; unwritten parts are zero and take no memory."""

    def __init__(self) -> None:
        super().__init__()
        self._pages: dict[int, bytearray] = {}
        self._position = 0
        self._size = 0

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Move to a position."""
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
        self._position = base + offset
        return self._position

    def truncate(self, size: int | None = None) -> int:
        """Set the size; HDF5 cuts off only parts that it has not written."""
        self._size = self._position if size is None else size
        return self._size

    def write(self, data: Any) -> int:
        """Write bytes at the position."""
        view = memoryview(data).cast("B")
        done = 0
        while done < len(view):
            page, begin = divmod(self._position, _PAGE)
            piece = view[done : done + _PAGE - begin]
            self._pages.setdefault(page, bytearray(_PAGE))[begin : begin + len(piece)] = piece
            self._position += len(piece)
            done += len(piece)
        self._size = max(self._size, self._position)
        return done

    def readinto(self, buffer: Any) -> int:
        """Read bytes at the position."""
        view = memoryview(buffer).cast("B")
        size = max(0, min(len(view), self._size - self._position))
        done = 0
        while done < size:
            page, begin = divmod(self._position, _PAGE)
            n = min(size - done, _PAGE - begin)
            data = self._pages.get(page)
            view[done : done + n] = bytes(n) if data is None else data[begin : begin + n]
            self._position += n
            done += n
        return done

    def copy_to(self, file: IO[bytes]) -> None:
        """Write everything to a real file, leaving holes where nothing was written."""
        file.truncate(self._size)
        for page, data in sorted(self._pages.items()):
            file.seek(page * _PAGE)
            file.write(data[: max(0, self._size - page * _PAGE)])


#: Kinds of links, as h5py calls their classes.
_LINKS = {h5py.h5l.TYPE_HARD: "HardLink", h5py.h5l.TYPE_SOFT: "SoftLink", h5py.h5l.TYPE_EXTERNAL: "ExternalLink"}


@contextmanager
def create_file(target: SparseFile) -> Iterator[Any]:
    """Create an HDF5 file whose bytes depend on its content only: fixed versions, no times, aligned data."""
    with h5py.File(
        target,
        "w",
        libver=("earliest", "v110"),
        track_order=False,
        alignment_threshold=1,
        alignment_interval=ALIGNMENT,
    ) as file:
        yield file


@contextmanager
def open_file(path: Path, require: Callable[[int], None] | None = None) -> Iterator[Any]:
    """Open a shard without file locks (network file systems), and pass its descriptor to `require`."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            if require is not None:
                require(file.id.get_vfd_handle())
            yield file
    except FileNotFoundError as error:
        raise StoreError("a shard is missing", where=str(path), fix="build the dataset again") from error
    except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:  # raised by h5py for a damaged file
        fix = "run dancedata check on the dataset"
        if "locking flag" in str(error):
            fix = "this process has the file open with locks: close it, or open it with h5py.File(..., locking=False)"
        raise StoreError("a shard cannot be read", where=str(path), found=shown(str(error), 600), fix=fix) from error


def find_object(file: Any, name: str, opened: dict[str, Any] | None = None) -> Any:
    """Return the identifier of a group or dataset, or None; StoreError for links. `opened` remembers identifiers."""
    # h5py's own look-up makes an object of every group on the way, which is most of the time to open a dataset.
    path, item, opened = "", file.id, {} if opened is None else opened
    for part in name.strip("/").split("/"):
        path += f"/{part}"
        if path not in opened:
            opened[path] = _child(item, part.encode(), f"{file.filename}, {path}")
        item = opened[path]
    return item


def _child(parent: Any, name: bytes, where: str) -> Any:
    if not isinstance(parent, h5py.h5g.GroupID) or not parent.links.exists(name):
        return None
    kind = _LINKS.get(parent.links.get_info(name).type, "UserLink")
    if kind != "HardLink":
        raise _refused("a link is not followed", where, kind, "a dataset in the file itself")
    return h5py.h5o.open(parent, name)


def find_dataset(file: Any, name: str, opened: dict[str, Any] | None = None) -> Any:
    """Return a dataset of numbers or fixed-length texts that lies in the file and fits its size; else StoreError."""
    filename = file.filename
    where = f"{filename}, /{name.strip('/')}"
    identifier = find_object(file, name, opened)
    dataset = h5py.Dataset(identifier) if isinstance(identifier, h5py.h5d.DatasetID) else None
    shape = dataset.shape if dataset is not None else None
    if dataset is None or shape is None:
        kind = "nothing" if identifier is None else type(identifier).__name__.removesuffix("ID")
        raise _refused("a dataset is missing", where, kind, "a dataset")
    dtype = dataset.dtype
    if dtype.kind not in "iufS" or dtype.subdtype is not None:
        raise _refused(
            "a dataset has a type that the store does not use", where, dtype, "numbers or fixed-length text"
        )
    storage = identifier.get_create_plist()
    if storage.get_layout() != h5py.h5d.CONTIGUOUS or storage.get_external_count():
        actual = "chunks, or virtual or external storage"
        raise _refused("a dataset is not contiguous in its file", where, actual, "rows in one piece, uncompressed")
    n_bytes = math.prod(shape) * dtype.itemsize
    n_left = max(0, os.path.getsize(filename) - (identifier.get_offset() or 0))
    if n_bytes > n_left:
        raise _refused("a dataset is larger than its file", where, f"{n_bytes:,} bytes", f"{n_left:,}")
    return dataset


def _refused(problem: str, where: str, actual: object, allowed: str) -> StoreError:
    return StoreError(
        problem, where=where, found=str(actual), allowed=allowed, fix="get the dataset again from its source"
    )


def create_dataset(group: Any, name: str, shape: tuple[int, ...], dtype: Any) -> Any:
    """Create a contiguous dataset and allocate its place in the file; nothing is written to it yet."""
    options = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    options.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    options.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    options.set_obj_track_times(False)
    return group.create_dataset(name, shape=shape, dtype=dtype, dcpl=options)


def write_array(group: Any, name: str, array: npt.NDArray[Any]) -> None:
    """Write a whole numeric array, little-endian."""
    dataset = create_dataset(group, name, array.shape, array.dtype.newbyteorder("<"))
    if array.size:
        dataset.id.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(array))


def write_strings(group: Any, name: str, texts: Sequence[str], longest: int) -> None:
    """Write UTF-8 texts: of fixed length, padded with NUL; offsets and bytes if one is longer than `longest`."""
    raw = [t.encode() for t in texts]
    size = max([1, *map(len, raw)])
    if size > longest:
        write_array(group, f"{name}/offset", np.cumsum([0, *map(len, raw)], dtype=np.int64))
        write_array(group, f"{name}/values", np.frombuffer(b"".join(raw), dtype=np.uint8))
        return
    dtype = h5py.string_dtype("utf-8", size)
    dataset = create_dataset(group, name, (len(raw),), dtype)
    if raw:
        dataset[...] = np.array(raw, dtype=dtype)


def write_attributes(item: Any, **attributes: str | int) -> None:
    """Write whole numbers, and texts of fixed length, as attributes."""
    for name, value in attributes.items():
        if isinstance(value, str):
            raw = value.encode()
            item.attrs.create(name, np.array(raw, dtype=h5py.string_dtype("utf-8", max(1, len(raw)))))
        else:
            item.attrs.create(name, np.int64(value), dtype="<i8")


def wrong_attributes(item: Any, needed: Iterable[str], **expected: str | int) -> Iterator[str]:
    """Yield how attributes differ from those that `write_attributes` writes; only `needed` ones have to be there."""
    for name, value in expected.items():
        stated: object = None
        if name in item.attrs:
            # Texts of variable length are not read: a damaged heap of them makes HDF5 hang.
            kind = item.attrs.get_id(name).dtype.kind
            stated = item.attrs[name] if kind in "Siu" else f"of type {item.attrs.get_id(name).dtype}"
            stated = stated.decode(errors="replace") if isinstance(stated, bytes) else stated
        if stated != value and (name in needed or stated is not None):
            yield f"{item.name}: attribute {name} is {stated}, not {value}"
