"""Untrusted paths, opened only if they are regular files: opening a named pipe could block forever."""

import errno
import hashlib
import os
import stat
from io import BufferedReader
from pathlib import Path

from dancedata.core.system import open_file

_KINDS = {stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


class NotRegularError(OSError):
    """The path is a pipe, socket or device instead of a regular file."""


def open_regular(path: str | Path) -> BufferedReader:
    """Open a regular file for reading bytes; links are followed. Never blocks."""
    # Checked before opening, because opening a device may have side effects, and after, because it may have changed.
    _require_regular(os.stat(path).st_mode, path)
    file = open(path, "rb", opener=open_file)  # noqa: SIM115 -- the caller closes it
    try:
        _require_regular(os.fstat(file.fileno()).st_mode, path)
    except BaseException:
        file.close()
        raise
    return file


def read_regular(path: str | Path, limit: int) -> bytes:
    """Read a regular file of at most `limit` bytes; OSError as `open_regular`, and if it is larger."""
    with open_regular(path) as file:
        # read() allocates the full requested size.
        size = os.fstat(file.fileno()).st_size
        data = file.read(min(size, limit) + 1)
    if max(size, len(data)) > limit:
        raise OSError(f"larger than {limit:,} bytes")
    return data


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, as hex; NotRegularError (an OSError) if it is not a regular file."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _require_regular(mode: int, path: str | Path) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise NotRegularError(f"it is {_KINDS.get(stat.S_IFMT(mode), 'another kind of entry')}, not a regular file")
