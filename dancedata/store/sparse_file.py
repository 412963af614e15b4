"""A file in memory that holds written pages only.

HDF5 writes the layout of a shard into it, and plain writes copy the bytes to the disk. HDF5 itself must not write to
a full disk: if closing a file fails, it keeps a half-closed file in the process and crashes at exit.
"""

from __future__ import annotations

import io
from typing import IO, Any

_PAGE = 1 << 16


class SparseFile(io.RawIOBase):
    """A seekable file of any size; unwritten parts are zero and take no memory."""

    def __init__(self) -> None:
        """Start empty."""
        super().__init__()
        self._pages: dict[int, bytearray] = {}
        self._position = 0
        self._size = 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def writable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the position."""
        return self._position

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
        wanted = max(0, min(len(view), self._size - self._position))
        done = 0
        while done < wanted:
            page, begin = divmod(self._position, _PAGE)
            n = min(wanted - done, _PAGE - begin)
            held = self._pages.get(page)
            view[done : done + n] = bytes(n) if held is None else held[begin : begin + n]
            self._position += n
            done += n
        return done

    def copy_to(self, file: IO[bytes]) -> None:
        """Write everything to a real file, leaving holes where nothing was written."""
        file.truncate(self._size)
        for page, data in sorted(self._pages.items()):
            file.seek(page * _PAGE)
            file.write(data[: max(0, self._size - page * _PAGE)])
