"""Calls of the operating system that not every one has, each with a portable way beside it.

Everything in dancedata that Linux, macOS and Windows do differently is here, and nowhere else: a test searches the
package. Which way is taken is decided once, when the module is imported, by whether the call exists.
docs/platforms.md lists the calls; `tests/platforms` takes them away and runs the suite.
"""

import errno
import mmap
import os
import platform
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        return None


_fcntl, _msvcrt = _module("fcntl"), _module("msvcrt")

#: Name of the system, as Python has it.
SYSTEM = sys.platform
#: Whether a file that is open can be removed, replaced, and moved with its folder. Windows refuses all three.
REMOVES_OPEN = os.name != "nt"
#: Whether a folder can be opened, and with that locked and flushed.
OPENS_FOLDERS = hasattr(os, "O_DIRECTORY")
#: Never blocks, as at a named pipe; bytes as they are, where the C library would translate line ends.
_ALWAYS = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_NOFOLLOW = getattr(os, "O_NOFOLLOW", 0)


def open_file(path: str | Path, flags: int, *, follow: bool = True) -> int:
    """Open a file as os.open does, without blocking and with untranslated bytes; return the descriptor.

    Raises
    ------
    OSError
        As os.open; and if not `follow` and the path is a symbolic link.
    """
    if follow:
        return os.open(path, flags | _ALWAYS, 0o666)
    if _NOFOLLOW:
        return os.open(path, flags | _ALWAYS | _NOFOLLOW, 0o666)
    _require_no_link(path)
    descriptor = os.open(path, flags | _ALWAYS, 0o666)
    try:
        _require_no_link(path)  # it may have become one in between
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _require_no_link(path: str | Path) -> None:
    if os.path.islink(path):
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))


#: Names of Windows' devices, with any suffix; and characters that no name there has, one of which names a stream.
_DEVICE = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])( *\..*)?", re.IGNORECASE)
_NO_NAME = re.compile(r'[<>:"|?*\\\x00-\x1f]|[. ]\Z')


def why_no_file_name(name: str) -> str:
    """Return what names this system allows, if it does not allow this one; "" if it does."""
    if REMOVES_OPEN or not (_DEVICE.fullmatch(name) or _NO_NAME.search(name)):
        return ""
    return 'names without < > : " | ? * \\ and without a point or space at the end, not those of devices (CON, NUL)'


def open_folder(path: Path) -> int:
    """Open a folder, to lock or to flush it; OSError where the system opens files only."""
    return os.open(path, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))


_pread, _preadv, _pwrite = (getattr(os, name, None) for name in ("pread", "preadv", "pwrite"))
#: Flags of a map whose bytes are read from the disk at once; 0 where there are none.
_POPULATED = (
    mmap.MAP_PRIVATE | mmap.MAP_POPULATE
    if all(hasattr(mmap, name) for name in ("MAP_POPULATE", "MAP_PRIVATE", "PROT_READ"))
    else 0
)
_WILL_NEED: int | None = getattr(mmap, "MADV_WILLNEED", None)
_memfd_create = getattr(os, "memfd_create", None)
#: Reads and writes without the calls for a position move that of the descriptor, which its threads share.
_moving = threading.Lock()


def read_at(descriptor: int, n_bytes: int, position: int) -> bytes:
    """Return at most `n_bytes` bytes of a file from a position on; the end of the file may come before."""
    if _pread is not None:
        data: bytes = _pread(descriptor, n_bytes, position)
        return data
    with _moved(descriptor, position):
        return os.read(descriptor, n_bytes)


def read_into(descriptor: int, view: memoryview, position: int) -> int:
    """Read from a position of a file into a view of bytes; return how many were read, 0 at the end of the file."""
    if _preadv is not None:
        n: int = _preadv(descriptor, [view], position)
        return n
    data = read_at(descriptor, view.nbytes, position)
    view[: len(data)] = data
    return len(data)


def write_at(descriptor: int, data: memoryview, position: int) -> int:
    """Write to a position of a file; return how many bytes were written."""
    if _pwrite is not None:
        n: int = _pwrite(descriptor, data, position)
        return n
    with _moved(descriptor, position):
        return os.write(descriptor, data)


@contextmanager
def _moved(descriptor: int, position: int) -> Iterator[None]:
    """Move the position of a descriptor within the context, which one thread at a time enters."""
    with _moving:
        before = os.lseek(descriptor, 0, os.SEEK_CUR)
        os.lseek(descriptor, position, os.SEEK_SET)
        try:
            yield
        finally:
            os.lseek(descriptor, before, os.SEEK_SET)


def map_now(descriptor: int, n_bytes: int, offset: int) -> mmap.mmap:
    """Map bytes of a file read-only, to be read at once: Linux reads them from the disk in this call."""
    if _POPULATED:
        return mmap.mmap(descriptor, n_bytes, flags=_POPULATED, prot=mmap.PROT_READ, offset=offset)
    return mmap.mmap(descriptor, n_bytes, access=mmap.ACCESS_READ, offset=offset)


def read_ahead(memory: mmap.mmap, position: int, n_bytes: int) -> None:
    """Ask the system to read bytes of a mapped file from the disk; returns at once. Does nothing without the call."""
    if _WILL_NEED is not None:
        page = position - position % mmap.PAGESIZE
        memory.madvise(_WILL_NEED, page, position + n_bytes - page)


def memory_file(name: str) -> int | None:
    """Return the descriptor of a new file in memory; None where there are none, or none is left."""
    if _memfd_create is None:
        return None
    try:
        descriptor: int = _memfd_create(name)
    except OSError:  # not allowed here, or no descriptor is left
        return None
    return descriptor


#: Errors of file systems without locks.
_NO_LOCKS = {errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL}
#: Windows locks ranges of bytes: this one lies beyond the data of files of locks, and within its C library's offsets.
_LOCKED_BYTE = 2**31 - 2
#: Seconds between two tries, where the system does not wait for a lock.
_RETRY_S = 0.02


def lock(descriptor: int, *, shared: bool = False, wait: bool = True) -> bool | None:
    """Lock an open file; the system releases the lock when its holder dies.

    Returns
    -------
    bool or None
        False if another process holds the lock and `wait` is False; None if the file system has no locks.

    Raises
    ------
    OSError
        EBADF: NFS locks nothing exclusively that is open for reading only.
    """
    if _fcntl is not None:
        operation = _fcntl.LOCK_SH if shared else _fcntl.LOCK_EX
        return _locked(lambda: _fcntl.flock(descriptor, operation | (0 if wait else _fcntl.LOCK_NB)))
    if _msvcrt is None:
        return None
    if shared:
        return True  # such a lock keeps a file from being removed, and no open file can be
    while (held := _locked(lambda: _lock_byte(descriptor, _msvcrt.LK_NBLCK))) is False and wait:
        time.sleep(_RETRY_S)
    return held


def _locked(call: Callable[[], None]) -> bool | None:
    try:
        call()
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            return False
        if error.errno in _NO_LOCKS:
            return None
        raise
    return True


def _lock_byte(descriptor: int, operation: int) -> None:
    with _moved(descriptor, _LOCKED_BYTE):
        _msvcrt.locking(descriptor, operation, 1)


def release(descriptor: int) -> None:
    """Release the lock of an open file, also for processes that were forked since and have it open."""
    if _fcntl is not None:
        _fcntl.flock(descriptor, _fcntl.LOCK_UN)
    elif _msvcrt is not None:
        _lock_byte(descriptor, _msvcrt.LK_UNLCK)


def changed_ns(status: os.stat_result) -> int:
    """Return the time of a file's last change, ns, which only the system sets; else that of its last modification.

    Windows has the time of creation in its place, which tells nothing.
    """
    return status.st_ctime_ns if REMOVES_OPEN else status.st_mtime_ns


def disk_bytes(status: os.stat_result) -> int:
    """Return the bytes that a file takes on the disk; its length where the system does not count blocks."""
    return max(status.st_size, getattr(status, "st_blocks", 0) * 512)


def flush_folder(folder: Path) -> None:
    """Flush a folder to disk: a rename is only there when its folder is. Some systems and file systems refuse."""
    with suppress(OSError):
        handle = open_folder(folder)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


_reading_umask = threading.Lock()


def umask() -> int:
    """Return the permissions that new files of this process do not get."""
    with suppress(OSError), open("/proc/self/status", encoding="utf-8", errors="replace") as status:
        for line in status:
            if line.startswith("Umask:"):
                return int(line.split()[1], 8)
    # On other systems the mask is read by setting it: by one thread at a time, or one would read that of another.
    with _reading_umask:
        mask = os.umask(0o022)
        os.umask(mask)
        return mask


def n_cores() -> int:
    """Return the number of cores that this process may use; those of the machine where that is unknown."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def memory_bytes() -> int:
    """Return the bytes of memory of this machine; 0 if unknown."""
    sysconf = getattr(os, "sysconf", None)
    try:
        return int(sysconf("SC_PHYS_PAGES") * sysconf("SC_PAGE_SIZE")) if sysconf is not None else 0
    except (OSError, ValueError):  # a name that this system does not have
        return 0


def processor_flags() -> set[str]:
    """Return the features of the processor by Linux's names; none where Linux does not list them."""
    return set(_cpuinfo("flags").split())


def processor() -> str:
    """Return a name of the processor."""
    return platform.processor() or _cpuinfo("model name") or "unknown"


def _cpuinfo(field: str) -> str:
    """Return the first value of a field of /proc/cpuinfo; "" if there is none."""
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if line.startswith(field):
                return line.partition(":")[2].strip()
    return ""


def started_with() -> list[str]:
    """Return the variables, NAME=VALUE, that this process was started with; it may have changed them since."""
    with suppress(OSError), open("/proc/self/environ", "rb") as file:
        return file.read().decode("utf-8", "replace").split("\0")
    return _AT_IMPORT


#: Elsewhere: those of the moment in which this module is imported, before anything of dancedata changes them.
_AT_IMPORT = [f"{name}={value}" for name, value in os.environ.items()]


def at_fork(before: Callable[[], object], after: Callable[[], object]) -> None:
    """Call `before` whenever this process forks, and `after` in parent and child; nothing forks without the call."""
    register = getattr(os, "register_at_fork", None)
    if register is not None:
        register(before=before, after_in_parent=after, after_in_child=after)


@contextmanager
def interrupts_blocked_in_children() -> Iterator[None]:
    """Start processes within the context so that they never receive SIGINT.

    By the mask, which they inherit. Windows has a switch of its console for it: a signal within the context is raised
    at its end there, too, but a Ctrl-C of the console is dropped.
    """
    set_mask = getattr(signal, "pthread_sigmask", None)
    if set_mask is not None:
        mask = set_mask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            set_mask(signal.SIG_SETMASK, mask)
        return
    in_main = threading.current_thread() is threading.main_thread()
    missed: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: missed.append(number)) if in_main else None
    _ignore_console_interrupts(True)
    try:
        yield
    finally:
        _ignore_console_interrupts(False)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
            if missed:
                signal.raise_signal(signal.SIGINT)


def _ignore_console_interrupts(ignore: bool) -> None:
    """Set the switch of Windows' console, which children inherit."""
    import ctypes

    libraries: Any = getattr(ctypes, "windll", None)
    if libraries is not None:
        libraries.kernel32.SetConsoleCtrlHandler(None, ignore)


def start_resource_tracker() -> None:
    """Start multiprocessing's process that removes semaphores of dead ones; Windows removes them itself."""
    if os.name != "nt":
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()


def is_file_too_large(code: int) -> bool:
    """Return whether a process with this exit code ended because a file became larger than this user may write."""
    number = getattr(signal, "SIGXFSZ", None)
    return number is not None and code == -number


def has_display() -> bool:
    """Return whether a browser could be shown: by the variables of a desktop of Linux; others have one."""
    if SYSTEM in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
