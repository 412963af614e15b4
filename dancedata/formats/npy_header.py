"""Looks at the length of an .npy header before numpy reads it."""

from __future__ import annotations

import os
from typing import IO

__all__ = ["MAX_HEADER_BYTES", "require_short_header"]

#: numpy's own limit, which it looks at only after it has made room: a header may announce 4 GB.
MAX_HEADER_BYTES = 10_000


def require_short_header(file: IO[bytes], version: tuple[int, int]) -> None:
    """Raise ValueError for a header that is longer than any array's.

    Parameters
    ----------
    file : just behind the magic number; is left there.
    version : of the format, as the magic number says it.
    """
    field = file.read(2 if version == (1, 0) else 4)
    length = int.from_bytes(field, "little")
    if length > MAX_HEADER_BYTES:
        raise ValueError(f"a header of {length:,} bytes")
    file.seek(-len(field), os.SEEK_CUR)
