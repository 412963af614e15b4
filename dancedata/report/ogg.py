"""Ogg files with equal bytes for equal sound: the encoder numbers its streams at random."""

from __future__ import annotations

import struct

__all__ = ["without_serial"]

_POLYNOMIAL = 0x04C11DB7
#: Places in the header of a page: serial number, checksum, number of lacing values, these.
_SERIAL, _CHECKSUM, _SEGMENTS, _LACING = 14, 22, 26, 27


def without_serial(data: bytes) -> bytes:
    """Return an Ogg file of one stream with the serial number 1 (RFC 3533, section 6)."""
    pages = bytearray(data)
    place = 0
    while place < len(pages):
        lacing = pages[place + _LACING : place + _LACING + pages[place + _SEGMENTS]]
        end = place + _LACING + len(lacing) + sum(lacing)
        pages[place + _SERIAL : place + _SERIAL + 4] = struct.pack("<I", 1)
        pages[place + _CHECKSUM : place + _CHECKSUM + 4] = bytes(4)
        checksum = _crc(pages[place:end])
        pages[place + _CHECKSUM : place + _CHECKSUM + 4] = struct.pack("<I", checksum)
        place = end
    return bytes(pages)


def _table() -> list[int]:
    table = []
    for byte in range(256):
        value = byte << 24
        for _ in range(8):
            value = (value << 1) ^ (_POLYNOMIAL if value & 0x80000000 else 0)
        table.append(value & 0xFFFFFFFF)
    return table


_TABLE = _table()


def _crc(data: bytearray) -> int:
    value = 0
    for byte in data:
        value = ((value << 8) & 0xFFFFFFFF) ^ _TABLE[(value >> 24) ^ byte]
    return value
