"""Files that are compressed as a whole, as joblib.dump(..., compress=...) writes them, with limits of their size."""

from __future__ import annotations

import bz2
import lzma
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from dancedata.core.regular_file import read_regular

__all__ = ["BOMB_BYTES", "BOMB_RATIO", "read_unpacked"]

#: Something above this size with a higher compression ratio than this is not a motion.
BOMB_BYTES = 1 << 26
BOMB_RATIO = 100
#: Memory of lzma's dictionary; its highest preset needs 64 MiB.
_LZMA_BYTES = 80 << 20


class _Decompressor(Protocol):
    @property
    def eof(self) -> bool: ...

    def decompress(self, data: bytes, max_length: int, /) -> bytes: ...


def _lzma(kind: int) -> Callable[[], Any]:
    return lambda: lzma.LZMADecompressor(kind, memlimit=_LZMA_BYTES)


#: First bytes -> what unpacks; no pickle begins so.
_KINDS: dict[bytes, Callable[[], _Decompressor]] = {
    b"\x78": zlib.decompressobj,
    b"\x1f\x8b": lambda: zlib.decompressobj(wbits=31),
    b"BZh": bz2.BZ2Decompressor,
    b"\xfd7zXZ\x00": _lzma(lzma.FORMAT_XZ),
    b"\x5d\x00": _lzma(lzma.FORMAT_ALONE),
}
_LZ4 = b"\x04\x22\x4d\x18"


def read_unpacked(path: Path, limit: int) -> tuple[bytes, int]:
    """Return the content of a file, unpacked if zlib, gzip, bz2, lzma or xz has packed it, and the file's size.

    Raises
    ------
    ValueError
        If it is larger than the limit, truncated, or packed more than 100-fold.
    OSError
        If it cannot be read.
    """
    data = read_regular(path, limit)
    kind = next((make for head, make in _KINDS.items() if data.startswith(head)), None)
    if data.startswith(_LZ4):
        raise ValueError("compressed by lz4; write it with compress='zlib', or without compression")
    if kind is None:
        return data, len(data)
    allowed = min(limit, max(BOMB_BYTES, BOMB_RATIO * len(data)))
    unpacker = kind()
    content = unpacker.decompress(data, allowed + 1)
    if len(content) > allowed:
        raise ValueError(f"{len(data):,} bytes unpack to more than {allowed:,}")
    if not unpacker.eof:
        raise ValueError("the compressed data are truncated")
    return content, len(data)
