"""Files of the cache: entries that carry a checksum and appear whole, and locks that die with their holder.

Every writer holds a lock (flock) on its temporary file, and on a file of the unit that it computes. The kernel
gives both back when a process dies, however it dies, so that `sweep` can tell what a killed process left from
what a living one is writing, on every machine that shares the folder.
"""

from __future__ import annotations

import errno
import fcntl
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
from typing import Any
from uuid import uuid4

import numpy as np
import numpy.typing as npt

from dancedata.core.hashing import canonical_bytes

#: Folders of the cache that hold no entries.
TEMPORARY, LOCKS = "tmp", "locks"
#: How the names of files in LOCKS begin that builds hold as long as they run.
RUNNING = "build-"
#: Where the file system knows no locks: what has not been touched for this long was left by a killed process.
ABANDONED_S = 24 * 3600.0
#: How exactly the time of the last use is kept: a use sooner after the last one writes nothing.
USE_GRANULARITY_S = 3600.0
_HEAD_BYTES = 512
#: After the bytes of a .npy file: a word that says what follows, and the CRC-32 of all before it.
_TRAILER = struct.Struct("<8sQ")
_WORD = b"ddcache1"
_HEAD = re.compile(
    rb"\x93NUMPY\x01\x00(?P<length>..)\{'descr': '(?P<dtype>[<>|=][a-z][0-9]+)', 'fortran_order': False, "
    rb"'shape': \((?P<shape>[0-9, ]*)\), \} *\n",
    re.DOTALL,
)
_JSON_HEAD = re.compile(rb'\{"crc32": (?P<crc>[0-9]{1,10}), "content": ')
_NO_LOCKS = {errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL}


def array_parts(array: npt.NDArray[Any]) -> list[bytes | memoryview]:
    """Return the bytes of an array's entry: a .npy file, and a checksum after it that .npy readers do not see."""
    array = np.asarray(array, order="C")
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, np.lib.format.header_data_from_array_1_0(array))
    data = memoryview(array.reshape(-1).view(np.uint8).data)
    checksum = zlib.crc32(data, zlib.crc32(head.getvalue()))
    return [head.getvalue(), data, _TRAILER.pack(_WORD, checksum)]


def read_head(fd: int) -> tuple[tuple[int, ...], np.dtype[Any], int]:
    """Return shape, dtype and first byte of an entry's values; ValueError if it is not as long as it says."""
    head = os.pread(fd, _HEAD_BYTES, 0)
    # As `array_parts` writes it, and numpy since version 1: numpy's own reader takes longer than the rest of this.
    found = _HEAD.match(head)
    if found is None:
        raise ValueError("it does not begin as entries do")
    shape = tuple(int(n) for n in found["shape"].split(b",") if n.strip())
    dtype = np.dtype(found["dtype"].decode())
    begin = 10 + int.from_bytes(found["length"], "little")
    end = begin + math.prod(shape) * dtype.itemsize
    size = os.fstat(fd).st_size
    if size != end + _TRAILER.size or os.pread(fd, len(_WORD), end) != _WORD:
        raise ValueError(f"{size} bytes, not {end + _TRAILER.size} with a checksum at the end")
    return shape, dtype, begin


def read_array(path: Path) -> npt.NDArray[Any]:
    """Read an entry and compare its checksum; ValueError if it is damaged, OSError if it cannot be read."""
    with open(path, "rb") as file:
        shape, dtype, begin = read_head(file.fileno())
        data = bytearray(os.fstat(file.fileno()).st_size)
        if file.readinto(data) != len(data):
            raise ValueError("it ends before its end")
    view = memoryview(data)
    _, checksum = _TRAILER.unpack(view[-_TRAILER.size :])
    if zlib.crc32(view[: -_TRAILER.size]) != checksum:
        raise ValueError("its checksum is not that of its bytes")
    return np.frombuffer(data, dtype, math.prod(shape), begin).reshape(shape)


def json_parts(obj: Any) -> list[bytes | memoryview]:
    """Return the bytes of a JSON entry, which names its own checksum."""
    text = canonical_bytes(obj)
    return [b'{"crc32": %d, "content": ' % zlib.crc32(text), text, b"}\n"]


def read_json(path: str | Path) -> tuple[Any, float]:
    """Read a JSON entry, and when it was last used; ValueError if it is damaged, OSError if it cannot be read."""
    fd = os.open(path, os.O_RDONLY)  # half the time of an open file of Python's
    try:
        stat = os.fstat(fd)
        entry = os.pread(fd, stat.st_size, 0)
    finally:
        os.close(fd)
    head = _JSON_HEAD.match(entry)
    if head is None or entry[-2:] != b"}\n":
        raise ValueError("it does not begin and end as entries do")
    text = entry[head.end() : -2]
    if zlib.crc32(text) != int(head["crc"]):
        raise ValueError("its checksum is not that of its content")
    return json.loads(text), stat.st_mtime


def note_use(path: str, used: float) -> None:
    """Say that an entry is being used, for `prune`: its time of change is the time of its last use.

    The access time is no good for it: most file systems are mounted so that it is kept late or never.
    """
    # Also where the last use lies in the future: the clock was set back.
    if abs(time.time() - used) > USE_GRANULARITY_S:
        with suppress(OSError):  # somebody else's, or a cache that may only be read
            os.utime(path)


def publish(root: Path, path: Path, parts: Sequence[bytes | memoryview], *, durable: bool) -> None:
    """Make a file appear whole at `path`, a place within the cache `root`.

    With `durable` it is flushed to disk before it appears. Without, a machine that loses power may leave a
    damaged entry, which its checksum gives away.
    """
    fd, temporary = _open_held(root / TEMPORARY, f"{uuid4().hex}.tmp")
    try:
        for part in parts:
            _write_all(fd, part)
        if durable:
            os.fsync(fd)
        try:
            os.replace(temporary, path)
        except FileNotFoundError:
            path.parent.mkdir(parents=True, exist_ok=True)
            os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    finally:
        os.close(fd)


def _write_all(fd: int, part: bytes | memoryview) -> None:
    view = memoryview(part)
    while view:
        view = view[os.write(fd, view) :]


@contextmanager
def held(folder: Path, name: str) -> Iterator[Path]:
    """Hold a file in `folder` and its lock, waiting for whoever holds it; it is gone afterwards.

    Where the file system knows no locks nobody waits.
    """
    fd, path = _open_held(folder, name)
    try:
        yield path
    finally:
        with suppress(OSError):
            path.unlink()  # while it is held: who waits for it finds out and makes a new one
        os.close(fd)


@contextmanager
def running(root: Path) -> Iterator[None]:
    """Say, within the context, that a build is running: `cache prune` leaves alone what it may be using."""
    with ExitStack() as stack:
        with suppress(OSError):  # a cache that may only be read is enough for a build that finds all in it
            stack.enter_context(held(root / LOCKS, f"{RUNNING}{uuid4().hex}"))
        yield


def oldest_running(root: Path) -> float | None:
    """Return when the oldest of the builds began that are running now, seconds since 1970."""
    begun = []
    for path in (root / LOCKS).glob(f"{RUNNING}*"):
        with suppress(FileNotFoundError):
            since = path.stat().st_mtime
            if not left_behind(path):
                begun.append(since)
    return min(begun, default=None)


def mark_in_use(fd: int) -> None:
    """Mark an open entry as in use until the last copy of `fd` is closed; FileNotFoundError if it is removed."""
    _lock(fd, fcntl.LOCK_SH)
    if not os.fstat(fd).st_nlink:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))


def remove_unused(path: Path, used: float) -> bool:
    """Remove an entry, unless it was used after the time `used` or a process has it mapped; tells whether it is gone.

    Raises
    ------
    OSError
        If it may not be removed.
    """
    try:
        fd = os.open(path, os.O_RDWR)
    except FileNotFoundError:
        return True
    except PermissionError:
        fd = os.open(path, os.O_RDONLY)
    try:
        if os.fstat(fd).st_mtime != used or _lock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB) is False:
            return False
        path.unlink(missing_ok=True)
    finally:
        os.close(fd)
    return True


def left_behind(path: Path) -> bool:
    """Tell whether a file is there and the process that held it is dead."""
    try:
        fd = os.open(path, os.O_RDWR)
    except OSError:
        return False
    try:
        return _is_abandoned(fd)
    finally:
        os.close(fd)


def sweep(root: Path) -> int:
    """Remove temporary files and locks that killed processes left; returns how many."""
    removed = 0
    for folder in (root / TEMPORARY, root / LOCKS):
        try:
            names = os.listdir(folder)
        except OSError:
            continue
        for name in names:
            removed += _remove_abandoned(folder / name)
    return removed


def _remove_abandoned(path: Path) -> bool:
    try:
        fd = os.open(path, os.O_RDWR)
    except OSError:
        return False
    try:
        if not _is_abandoned(fd):
            return False
        path.unlink()  # while it is held: a process that was about to hold it finds out and makes a new one
    except OSError:
        return False
    finally:
        os.close(fd)
    return True


def _is_abandoned(fd: int) -> bool:
    """Tell whether nobody holds an open file; if so, the caller holds it until it closes the file."""
    locked = _lock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    if locked is None:
        return time.time() - os.fstat(fd).st_mtime > ABANDONED_S
    return locked and os.fstat(fd).st_nlink > 0


def _open_held(folder: Path, name: str) -> tuple[int, Path]:
    """Open a file, made if it is missing, and lock it."""
    path = folder / name
    made = False
    while True:
        try:
            fd = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)
        except FileNotFoundError:
            if made:
                raise
            folder.mkdir(parents=True, exist_ok=True)
            made = True
            continue
        try:
            _lock(fd, fcntl.LOCK_EX)
            # Whoever held it before has removed it by now: that lock keeps nobody out.
            if os.fstat(fd).st_nlink:
                return fd, path
        except BaseException:
            os.close(fd)
            raise
        os.close(fd)


def _lock(fd: int, operation: int) -> bool | None:
    """Lock an open file; False if another one holds it, None where the file system knows no locks."""
    try:
        fcntl.flock(fd, operation)
    except OSError as error:
        # EBADF: NFS, of a file that may only be read. Whether another one holds it cannot be told.
        if error.errno in (errno.EAGAIN, errno.EACCES, errno.EBADF):
            return False
        if error.errno in _NO_LOCKS:
            return None
        raise
    return True
