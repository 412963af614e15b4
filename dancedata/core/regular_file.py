"""Opens files of other people that have to be files: a named pipe in their place would be waited for without end."""

from __future__ import annotations

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

__all__ = ["NotRegularError", "open_regular", "read_regular"]

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class NotRegularError(OSError):
    """A pipe, socket or device lies where a file should be."""


def open_regular(path: str | Path) -> BufferedReader:
    """Open a regular file for reading bytes; links are followed. Returns at once, whatever lies there.

    Raises
    ------
    OSError
        If it cannot be opened; NotRegularError if it is no regular file, IsADirectoryError if it is a folder.
    """
    # Looked at before it is opened, for opening a device may already do something; and after, for it may be another.
    _require_regular(os.stat(path).st_mode, path)
    file = open(path, "rb", opener=_without_waiting)  # noqa: SIM115 -- it is the caller's
    try:
        _require_regular(os.fstat(file.fileno()).st_mode, path)
    except BaseException:
        file.close()
        raise
    return file


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)


def read_regular(path: str | Path, limit: int) -> bytes:
    """Read a regular file of at most `limit` bytes; OSError as `open_regular`, and if it is larger."""
    with open_regular(path) as file:
        # Python makes room for all that is asked for.
        size = os.fstat(file.fileno()).st_size
        data = file.read(min(size, limit) + 1)
    if max(size, len(data)) > limit:
        raise OSError(f"it is bigger than {limit:,} bytes")
    return data


def _require_regular(mode: int, path: str | Path) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise NotRegularError(f"it is {_KINDS.get(stat.S_IFMT(mode), 'something else')}, not a regular file")
