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
from itertools import islice
from pathlib import Path
from stat import S_ISREG
from typing import Any
from uuid import uuid4

import numpy as np
import numpy.typing as npt

from dancedata.core.hashing import canonical_bytes
from dancedata.core.locks import is_abandoned, left_behind, lock_file, open_held, unlock

#: Folders of the cache: those of entries, and those of what is being written and who computes what.
STAGES = ("features", "motion", "clips", "signals", "files")
TEMPORARY, LOCKS = "tmp", "locks"
#: What says that a folder is a cache, at its top.
MARKER = "dancedata-cache.txt"
_MARK = b"A cache of dancedata, format 1. It only saves time: it may be deleted when nothing runs.\n"
#: Names of entries: <stage>/<two digits>/<sha256>.npy or .json; of temporary files; of locks. Nothing else is ever
#: removed, for a cache may lie in a folder that holds other things too.
ENTRY = re.compile(r"(?P<two>[0-9a-f]{2})[0-9a-f]{62}\.(npy|json)")
_TWO_DIGITS = re.compile(r"[0-9a-f]{2}")
_TEMPORARY_NAME = re.compile(r"dancedata-[0-9a-f]{32}(\.tmp|\.token|-[0-9]+\.unit)")
_LOCK_NAME = re.compile(rf"({'|'.join(STAGES)})-[0-9a-f]{{64}}|build-[0-9a-f]{{32}}")
#: How the names of files in LOCKS begin that builds hold as long as they run.
RUNNING = "build-"
#: Files looked at in a stage at most, to find out whether a folder is a cache that has no marker.
_LOOKED_AT = 16
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
    fd, temporary = _open_held(root / TEMPORARY, f"{temporary_name()}.tmp")
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
        unlock(fd)


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
        unlock(fd)


@contextmanager
def running(root: Path) -> Iterator[None]:
    """Say, within the context, that a build is running: `cache prune` leaves alone what it may be using."""
    with ExitStack() as stack:
        with suppress(OSError):  # a cache that may only be read is enough for a build that finds all in it
            stack.enter_context(held(root / LOCKS, f"{RUNNING}{uuid4().hex}"))
            mark(root)
        yield


def oldest_running(root: Path) -> float | None:
    """Return when the oldest of the builds began that are running now, seconds since 1970."""
    begun = []
    for name in _listed(root / LOCKS):
        if name.startswith(RUNNING) and _LOCK_NAME.fullmatch(name):
            path = root / LOCKS / name
            with suppress(FileNotFoundError):
                since = path.stat().st_mtime
                if not left_behind(path):
                    begun.append(since)
    return min(begun, default=None)


def mark_in_use(fd: int) -> None:
    """Mark an open entry as in use until the last copy of `fd` is closed; FileNotFoundError if it is removed."""
    lock_file(fd, fcntl.LOCK_SH)
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
        if os.fstat(fd).st_mtime != used or lock_file(fd, fcntl.LOCK_EX | fcntl.LOCK_NB) is False:
            return False
        path.unlink(missing_ok=True)
    finally:
        os.close(fd)
    return True


def is_cache(root: Path) -> bool:
    """Tell whether a folder is known as a cache: by its marker, or by entries in it, as before there were markers."""
    return _is_marked(root) or any(_is_entry(path) for path in _first_entries(root))


def mark(root: Path) -> None:
    """Say in a folder that it is a cache, unless something has the marker's name already."""
    with suppress(OSError):  # a cache may be read-only
        fd = os.open(root / MARKER, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        try:
            os.write(fd, _MARK)
        finally:
            os.close(fd)


def _is_marked(root: Path) -> bool:
    marker = root / MARKER
    try:
        if not S_ISREG(marker.lstat().st_mode) or marker.stat().st_size > len(_MARK):
            return False
        # Empty: a process was killed in the midst of `mark`.
        return marker.read_bytes() in (_MARK, b"")
    except OSError:
        return False


def _first_entries(root: Path) -> Iterator[Path]:
    """List some files that have an entry's name and place."""
    for stage in STAGES:
        named = (
            root / stage / two / name
            for two in _listed(root / stage)
            if _TWO_DIGITS.fullmatch(two)
            for name in _listed(root / stage / two)
            if (found := ENTRY.fullmatch(name)) and found["two"] == two
        )
        yield from islice(named, _LOOKED_AT)


def _is_entry(path: Path) -> bool:
    """Tell whether a file begins and ends as entries do."""
    try:
        if not S_ISREG(path.lstat().st_mode):
            return False
        if path.suffix == ".json":
            read_json(path)
        else:
            with open(path, "rb") as file:
                read_head(file.fileno())
    except (OSError, ValueError):
        return False
    return True


def sweep(root: Path) -> int:
    """Remove temporary files and locks that killed processes left; returns how many. Marks a cache without marker.

    Only names that the cache gives, and only in a folder that is known as a cache.
    """
    if not is_cache(root):
        return 0
    mark(root)
    removed = 0
    for folder, own in ((root / TEMPORARY, _TEMPORARY_NAME), (root / LOCKS, _LOCK_NAME)):
        removed += sum(_remove_abandoned(folder / name) for name in _listed(folder) if own.fullmatch(name))
    return removed


def _remove_abandoned(path: Path) -> bool:
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        if not S_ISREG(os.fstat(fd).st_mode) or not is_abandoned(fd):
            return False
        path.unlink()  # while it is held: a process that was about to hold it finds out and makes a new one
    except OSError:
        return False
    finally:
        unlock(fd)
    return True


def temporary_name() -> str:
    """Return how the name of a new temporary file begins."""
    return f"dancedata-{uuid4().hex}"


def _listed(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def _open_held(folder: Path, name: str) -> tuple[int, Path]:
    """Open a file and lock it, see `open_held`; its folder is made, and the cache marked, if it is missing."""
    try:
        return open_held(folder, name)
    except FileNotFoundError:
        folder.mkdir(parents=True, exist_ok=True)
        if folder.name in (TEMPORARY, LOCKS):
            mark(folder.parent)
        return open_held(folder, name)
