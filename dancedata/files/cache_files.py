"""Files of the cache: entries with a checksum, which appear whole, temporary files and locks.

Every writer holds a lock (see `files.locks`) on its temporary file, and on a file of the unit that it computes. So
`sweep` tells leftovers of killed processes from files that living ones are writing, on every machine that shares the
folder.
"""

import errno
import io
import json
import math
import os
import re
import struct
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from stat import S_ISREG
from typing import Any, cast
from uuid import uuid4

import numpy as np
import numpy.typing as npt

from dancedata.core.hashing import canonical_bytes
from dancedata.core.system import open_file
from dancedata.files.locks import file_lock, lock_abandoned, lock_file, open_locked, remove_locked, unlock

#: Folders of the cache: entries by stage, files that are being written, and locks of units that are being computed.
STAGES = (
    "features", "motion", "segments", "times", "signals", "onsets", "rhythm", "offsets", "evaluate", "files",
)  # fmt: skip
TEMPORARY, LOCKS = "tmp", "locks"
#: Folder of datasets that were fetched from addresses: <self_sha256>/ with the files of each.
DATASETS = "datasets"
FETCHED = re.compile(r"(?P<sha256>[0-9a-f]{64})(\.parts)?")
#: File at the top of a folder that marks it as a cache.
MARKER = "dancedata-cache.txt"
_MARK = b"A cache of dancedata, format 1. It only saves time: it may be deleted when nothing runs.\n"
#: Names of entries: <stage>/<two digits>/<sha256>.npy or .json; of temporary files; of locks. Nothing else is ever
#: removed, since the folder may hold other files too.
ENTRY = re.compile(r"(?P<two>[0-9a-f]{2})[0-9a-f]{62}\.(npy|json)")
_TEMPORARY_NAME = re.compile(r"dancedata-[0-9a-f]{32}\.(tmp|token)")
_LOCK_NAME = re.compile(rf"({'|'.join(('units', *STAGES, DATASETS))})-[0-9a-f]{{64}}|build-[0-9a-f]{{32}}")
#: Prefix of the locks in LOCKS that builds hold as long as they run.
RUNNING = "build-"
#: Resolution of the time of last use: a use sooner after the last one writes nothing.
USE_GRANULARITY_S = 3600.0
_HEAD_BYTES = 512
#: After the bytes of a .npy file: a magic word, and the CRC-32 of everything before it.
_TRAILER = struct.Struct("<8sQ")
_WORD = b"ddcache1"
_HEAD = re.compile(
    rb"\x93NUMPY\x01\x00(?P<length>..)\{'descr': '(?P<dtype>[<>|=][a-z][0-9]+)', 'fortran_order': False, "
    rb"'shape': \((?P<shape>[0-9, ]*)\), \} *\n",
    re.DOTALL,
)
_JSON_HEAD = re.compile(rb'\{"crc32": (?P<crc>[0-9]{1,10}), "content": ')


def array_parts(array: npt.NDArray[Any]) -> list[bytes | memoryview]:
    """Return the bytes of an array's entry: a .npy file, and a checksum after it that .npy readers ignore."""
    array = np.asarray(array, order="C")
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, np.lib.format.header_data_from_array_1_0(array))
    data = memoryview(array.reshape(-1).view(np.uint8).data)
    checksum = zlib.crc32(data, zlib.crc32(head.getvalue()))
    return [head.getvalue(), data, _TRAILER.pack(_WORD, checksum)]


def read_head(fd: int) -> tuple[tuple[int, ...], np.dtype[Any], int]:
    """Return shape, dtype and offset of an entry's values; ValueError if its length does not match."""
    head = os.pread(fd, _HEAD_BYTES, 0)
    # As `array_parts` writes it, and numpy since version 1: numpy's own reader takes longer than the rest of this.
    header = _HEAD.match(head)
    if header is None:
        raise ValueError("bad entry header")
    shape = tuple(int(n) for n in header["shape"].split(b",") if n.strip())
    dtype = np.dtype(header["dtype"].decode())
    begin = 10 + int.from_bytes(header["length"], "little")
    end = begin + math.prod(shape) * dtype.itemsize
    size = os.fstat(fd).st_size
    if size != end + _TRAILER.size or os.pread(fd, len(_WORD), end) != _WORD:
        raise ValueError(f"{size} bytes, not {end + _TRAILER.size} with a checksum at the end")
    return shape, dtype, begin


def read_array(path: Path) -> npt.NDArray[Any]:
    """Read an entry and compare its checksum; ValueError if it is damaged, OSError if it cannot be read."""
    with open(path, "rb") as file:
        shape, dtype, begin = read_head(file.fileno())
        # Not a bytearray: its bytes would be set to 0 first.
        data = np.empty(os.fstat(file.fileno()).st_size, np.uint8)
        if file.readinto(data.data) != len(data):
            raise ValueError("truncated entry")
    view = data.data
    _, checksum = _TRAILER.unpack(view[-_TRAILER.size :])
    if zlib.crc32(view[: -_TRAILER.size]) != checksum:
        raise ValueError("checksum mismatch")
    return np.frombuffer(data, dtype, math.prod(shape), begin).reshape(shape)


def json_parts(obj: Any) -> list[bytes | memoryview]:
    """Return the bytes of a JSON entry, which contains its own checksum."""
    text = canonical_bytes(obj)
    return [b'{"crc32": %d, "content": ' % zlib.crc32(text), text, b"}\n"]


def read_json(path: str | Path) -> tuple[Any, float]:
    """Read a JSON entry, and when it was last used; ValueError if it is damaged, OSError if it cannot be read."""
    fd = open_file(path, os.O_RDONLY)  # takes half the time of open()
    try:
        stat = os.fstat(fd)
        entry = os.pread(fd, stat.st_size, 0)
    finally:
        os.close(fd)
    head = _JSON_HEAD.match(entry)
    if head is None or entry[-2:] != b"}\n":
        raise ValueError("bad entry header")
    text = entry[head.end() : -2]
    if zlib.crc32(text) != int(head["crc"]):
        raise ValueError("checksum mismatch")
    return json.loads(text), stat.st_mtime


def touch(path: str, used: float) -> None:
    """Record the use of an entry, for `prune`, as its modification time: access times are updated late or never."""
    # Also if the last use is in the future: the clock was set back.
    if abs(time.time() - used) > USE_GRANULARITY_S:
        with suppress(OSError):  # another user's entry, or a read-only cache
            os.utime(path)


def publish(root: Path, path: Path, parts: Sequence[bytes | memoryview], *, durable: bool) -> None:
    """Write a file that appears whole at `path`; with `durable` it is flushed to disk before it appears."""
    fd, temporary = _open_temporary(root)
    try:
        for part in parts:
            _write_all(fd, part)
        if durable:
            os.fsync(fd)
        _put_in_place(root, temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    finally:
        unlock(fd)


def _put_in_place(root: Path, temporary: Path, path: Path) -> None:
    try:
        os.replace(temporary, path)
    except FileNotFoundError:
        path.parent.mkdir(parents=True, exist_ok=True)
        mark(root)  # folders for temporary files and locks may have been there
        os.replace(temporary, path)


def _write_all(fd: int, part: bytes | memoryview) -> None:
    view = memoryview(part)
    while view:
        view = view[os.write(fd, view) :]


@contextmanager
def locked_file(folder: Path, name: str) -> Iterator[Path]:
    """Hold a file in a folder of the cache and its lock, see `file_lock`; the folder is made if it is missing."""
    with ExitStack() as stack:
        try:
            stack.enter_context(file_lock(folder / name))
        except FileNotFoundError:
            _make_folder(folder)
            stack.enter_context(file_lock(folder / name))
        yield folder / name


@contextmanager
def running(root: Path) -> Iterator[None]:
    """Mark, within the context, that a build is running: `cache prune` keeps the entries that it may be using."""
    with ExitStack() as stack:
        with suppress(OSError):  # a read-only cache suffices for a build that finds everything in it
            stack.enter_context(locked_file(root / LOCKS, f"{RUNNING}{uuid4().hex}"))
            mark(root)
        yield


def mark_in_use(fd: int) -> None:
    """Mark an open entry as in use until the last copy of `fd` is closed; FileNotFoundError if it was removed."""
    lock_file(fd, shared=True)
    if not os.fstat(fd).st_nlink:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))


def is_cache(root: Path) -> bool:
    """Return whether a folder is a cache: it has a marker."""
    marker = root / MARKER
    try:
        if not S_ISREG(marker.lstat().st_mode) or marker.stat().st_size > len(_MARK):
            return False
        # Empty: a process was killed during `mark`.
        return marker.read_bytes() in (_MARK, b"")
    except OSError:
        return False


def mark(root: Path) -> None:
    """Mark a folder as a cache, unless a file with the marker's name exists."""
    with suppress(OSError):  # a cache may be read-only
        fd = open_file(root / MARKER, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
        try:
            os.write(fd, _MARK)
        finally:
            os.close(fd)


def sweep(root: Path) -> int:
    """Remove temporary files and locks that killed processes left in a cache; return how many."""
    if not is_cache(root):
        return 0
    removed = 0
    for folder, pattern in ((root / TEMPORARY, _TEMPORARY_NAME), (root / LOCKS, _LOCK_NAME)):
        removed += sum(_remove_abandoned(folder / name) for name in _listed(folder) if pattern.fullmatch(name))
    return removed


def _remove_abandoned(path: Path) -> bool:
    try:
        fd = open_file(path, os.O_RDWR, follow=False)
    except OSError:
        return False
    try:
        abandoned = S_ISREG(os.fstat(fd).st_mode) and lock_abandoned(fd)
    except OSError:
        abandoned = False
    if not abandoned:
        unlock(fd)
        return False
    try:
        remove_locked(path, fd)
    except OSError:
        return False
    return True


def temporary_name() -> str:
    """Return the beginning of the name of a new temporary file."""
    return f"dancedata-{uuid4().hex}"


def _listed(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def _open_temporary(root: Path) -> tuple[int, Path]:
    """Make a temporary file in the cache, and lock it; return its descriptor and its path."""
    path = root / TEMPORARY / f"{temporary_name()}.tmp"
    try:
        fd = open_locked(path)
    except FileNotFoundError:
        _make_folder(path.parent)
        fd = open_locked(path)
    return cast(int, fd), path  # it waits


def _make_folder(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if folder.name in (TEMPORARY, LOCKS):
        mark(folder.parent)
