"""TFRecord files of tf.train.Example, written without tensorflow.

A record is its length (u64, little-endian), the masked CRC-32C of the length, the bytes, and their masked CRC-32C
(tensorflow, tsl/lib/io/record_writer.h). An Example is a protocol buffer: a map from names to lists of bytes, float32
or int64 (tensorflow, core/example/feature.proto).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import numpy.typing as npt

#: Castagnoli's polynomial, bits reversed.
_POLYNOMIAL = 0x82F63B78
#: Bytes that are taken one after another; pieces of so many bytes are taken side by side.
_PIECE = 256
_UInt32Array = npt.NDArray[np.uint32]
Feature = bytes | npt.NDArray[np.float32] | tuple[int, ...]


def record(payload: bytes) -> bytes:
    """Return the record of a payload."""
    length = struct.pack("<Q", len(payload))
    return b"".join((length, _masked(crc32c(length)), payload, _masked(crc32c(payload))))


def example(features: Mapping[str, Feature]) -> bytes:
    """Return a serialised tf.train.Example: bytes as one value, arrays flat as float32, tuples as int64."""
    entries = b"".join(
        _field(1, _field(1, name.encode()) + _field(2, _feature(value))) for name, value in sorted(features.items())
    )
    return _field(1, entries)


def crc32c(data: bytes) -> int:
    """Return the CRC-32C (Castagnoli) of data."""
    n_pieces = 1
    while n_pieces * _PIECE < len(data):
        n_pieces *= 2
    padded = np.zeros(n_pieces * _PIECE, np.uint8)  # zeros in front do not change a remainder
    padded[len(padded) - len(data) :] = np.frombuffer(data, np.uint8)
    table = _table()
    state = np.zeros(n_pieces, np.uint32)
    for column in np.ascontiguousarray(padded.reshape(n_pieces, _PIECE).T):
        state = table[(state ^ column) & 0xFF] ^ (state >> np.uint32(8))
    operator = _zeros_operator(_PIECE)
    while len(state) > 1:  # the remainder of two neighbours: that of the first, moved on by the length of the second
        state = _apply(operator, state[0::2]) ^ state[1::2]
        operator = _apply(operator, operator)
    start = _apply(_zeros_operator(len(data)), np.array([0xFFFFFFFF], np.uint32))
    return int(state[0] ^ start[0]) ^ 0xFFFFFFFF


@lru_cache(maxsize=1)
def _table() -> _UInt32Array:
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> np.uint32(1)) ^ np.uint32(_POLYNOMIAL), table >> np.uint32(1))
    return table


def _zeros_operator(n_bytes: int) -> _UInt32Array:
    """Return the linear map, as the images of 32 bits, that moves a remainder on by zero bytes."""
    bits = np.uint32(1) << np.arange(32, dtype=np.uint32)
    found, power = bits, _table()[bits & 0xFF] ^ (bits >> np.uint32(8))
    while n_bytes:
        if n_bytes & 1:
            found = _apply(power, found)
        power = _apply(power, power)
        n_bytes >>= 1
    return found


def _apply(operator: _UInt32Array, state: _UInt32Array) -> _UInt32Array:
    """Apply a linear map over bits to each of a number of remainders."""
    found = np.zeros_like(state)
    for bit in range(32):
        found ^= np.where(state >> np.uint32(bit) & 1, operator[bit], np.uint32(0))
    return found


def _masked(crc: int) -> bytes:
    rotated = (crc >> 15 | crc << 17) & 0xFFFFFFFF
    return struct.pack("<I", (rotated + 0xA282EAD8) & 0xFFFFFFFF)


def _feature(value: Feature) -> bytes:
    if isinstance(value, bytes):
        return _field(1, _field(1, value))
    if isinstance(value, tuple):
        return _field(3, _field(1, b"".join(map(_varint, value))))
    return _field(2, _field(1, np.ascontiguousarray(value, "<f4").tobytes()))


def _field(number: int, content: bytes) -> bytes:
    """Return a length-delimited field (wire type 2)."""
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])
