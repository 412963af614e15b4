"""Calls of the operating system that Linux has and macOS does not, or that take more than a line."""

import json
import mmap
import os
import platform
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: Name of the system, as Python has it.
SYSTEM = sys.platform


def open_file(path: str | Path, flags: int, *, follow: bool = True) -> int:
    """Open a file without blocking, as a named pipe would; OSError if not `follow` and it is a symbolic link."""
    return os.open(path, flags | os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW), 0o666)


def read_ahead(memory: mmap.mmap, position: int, n_bytes: int) -> None:
    """Ask the system to read bytes of a mapped file from the disk; returns at once."""
    page = position - position % mmap.PAGESIZE
    memory.madvise(mmap.MADV_WILLNEED, page, position + n_bytes - page)


def memory_file(name: str) -> int | None:
    """Return the descriptor of a new file in memory; None where there are none, or none is left."""
    create = getattr(os, "memfd_create", None)
    if create is None:
        return None
    try:
        descriptor: int = create(name)
    except OSError:  # not allowed here, or no descriptor is left
        return None
    return descriptor


def flush_folder(folder: Path) -> None:
    """Flush a folder to disk: a rename is only there when its folder is. Some file systems refuse."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
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
    # On macOS the mask is read by setting it: by one thread at a time, or one would read that of another.
    with _reading_umask:
        mask = os.umask(0o022)
        os.umask(mask)
        return mask


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


#: On macOS: those of the moment in which this module is imported, before anything of dancedata changes them.
_AT_IMPORT = [f"{name}={value}" for name, value in os.environ.items()]


@contextmanager
def shielded() -> Iterator[None]:
    """Start processes within the context: they never get SIGINT; this one gets it, and SIGTERM, at its end.

    A child that is starting would print a traceback, and one whose parent gets an exception would wait for input.
    """
    received: list[int] = []
    in_main = threading.current_thread() is threading.main_thread()
    # A handler that is not Python's is None, and stays.
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM) if in_main and signal.getsignal(n)}
    for number in before:
        signal.signal(number, lambda number, _: received.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which children inherit
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])


def python_command(statements: str, *arguments: str) -> list[str]:
    """Return the command that runs statements with this process's module path, unlike ``python -c``."""
    # The path is an argument: a new process starts with another one. Python ignores entries that are not texts.
    start = "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); "
    folders = [folder for folder in sys.path if isinstance(folder, str)]
    return [sys.executable, "-P", "-c", start + statements, json.dumps(folders), *arguments]


def has_display() -> bool:
    """Return whether a browser could be shown: on Linux by the variables of a desktop; macOS has one."""
    return SYSTEM == "darwin" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
