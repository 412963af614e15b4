"""Locks on files, for all of dancedata. The system releases them when their holder dies, however it dies.

So a file that no process has locked is a leftover of a killed one, on every machine that shares the folder, without
clocks or process numbers.
"""

import errno
import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISREG

from dancedata.core.errors import StoreError
from dancedata.core.system import open_file
from dancedata.files.atomic import PREFIX

#: On file systems without locks: a file that was not changed for this long was left by a killed process.
_ABANDONED_S = 24 * 3600.0
#: Errors of file systems without locks.
_NO_LOCKS = {errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL}


def lock_file(fd: int, *, shared: bool = False, wait: bool = True, unsure: bool | None = False) -> bool | None:
    """Lock an open file; False if another process holds it and not `wait`, None where the file system has no locks.

    NFS cannot tell whether another process holds a file, or a folder, that is open for reading only: `unsure` then.
    """
    try:
        fcntl.flock(fd, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            return False
        if error.errno in _NO_LOCKS:
            return None
        if error.errno == errno.EBADF:
            return unsure
        raise
    return True


def unlock(fd: int) -> None:
    """Release a lock and close the file; closing alone leaves it to a process that was forked in between."""
    try:
        with suppress(OSError):
            fcntl.flock(fd, fcntl.LOCK_UN)
    finally:
        os.close(fd)


def remove_locked(path: Path, fd: int) -> None:
    """Remove a file while it is locked, and release it: a process that waits for it then makes a new one."""
    try:
        path.unlink()
    finally:
        unlock(fd)


def open_locked(path: Path, *, wait: bool = True) -> int | None:
    """Open a file, made if it is missing, and return it locked; if not `wait`, None if another process has it."""
    while True:
        fd = open_file(path, os.O_CREAT | os.O_RDWR, follow=False)
        try:
            locked = lock_file(fd, wait=wait)
            # The holder before may have removed it: a lock on a file without a name excludes no process.
            if locked is not False and os.fstat(fd).st_nlink:
                return fd
        except BaseException:
            unlock(fd)
            raise
        unlock(fd)
        if locked is False:
            return None


@contextmanager
def file_lock(path: Path, *, wait: bool = True) -> Iterator[bool]:
    """Hold a file and its lock within the context; it is removed afterwards. Yields False if another has it."""
    fd = open_locked(path, wait=wait)
    try:
        yield fd is not None
    finally:
        if fd is not None:
            with suppress(OSError):
                remove_locked(path, fd)


def is_abandoned(path: Path) -> bool:
    """Return whether a file exists that no living process has locked."""
    try:
        fd = open_file(path, os.O_RDWR, follow=False)
    except OSError:
        return False
    try:
        return lock_abandoned(fd)
    finally:
        unlock(fd)


def lock_abandoned(fd: int) -> bool:
    """Lock an open file if no living process has; return whether none had. The lock is held until `fd` is closed."""
    locked = lock_file(fd, wait=False)
    if locked is None:
        return time.time() - os.fstat(fd).st_mtime > _ABANDONED_S
    return locked and os.fstat(fd).st_nlink > 0


@contextmanager
def writing_lock(folder: Path, what: str, *, wait: bool = False) -> Iterator[None]:
    """Hold the lock of a folder that is written within the context; the folder need not exist.

    The lock is an empty file next to it, ``.dancedata-NAME.lock``, that is removed afterwards; where none can be
    made, the folder itself. `what`: activity of the lock's holder, for the error; `wait`: wait for it instead.
    """
    fd, path = _open_lock(folder, what, wait=wait)
    try:
        yield
    finally:
        if path is None or os.fstat(fd).st_size:  # a file with content is not a lock
            unlock(fd)
        else:
            with suppress(OSError):
                remove_locked(path, fd)


def _open_regular(path: Path) -> int:
    """Open a file, made if it is missing; OSError if something else has its name."""
    fd = open_file(path, os.O_CREAT | os.O_RDWR, follow=False)
    if not S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return fd


def _open_lock(folder: Path, what: str, *, wait: bool) -> tuple[int, Path | None]:
    real = folder.resolve()
    beside = real.parent / f"{PREFIX}{real.name}.lock"
    while True:
        path: Path | None = beside
        try:
            fd = _open_regular(beside)
        except OSError:
            if not real.is_dir():
                raise
            fd, path = os.open(real, os.O_RDONLY | os.O_DIRECTORY), None
        try:
            if lock_file(fd, wait=wait, unsure=None if path is None else False) is False:
                raise StoreError(f"another {what} is writing there", where=folder,
                                 fix="wait until it has ended, or choose another folder")  # fmt: skip
            if path is None or os.fstat(fd).st_nlink:
                return fd, path
        except BaseException:
            unlock(fd)
            raise
        unlock(fd)
