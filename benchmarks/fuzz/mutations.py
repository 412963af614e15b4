"""Broken copies of valid files: bytes, lengths and words changed by a seeded generator."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable, Sequence
from random import Random

#: Values that length fields break at.
_NUMBERS = (0, 1, -1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63)
_WORDS = (
    b"0 1 -1 1e999 nan -inf 0x10 99999999999999999999 1e-400 1e999999999 1_000 null true [] {} "
    b"{ } [ ] \" ' , ; : # & * ! | > - "
    b".. / \\ ~ %s \x00 \xff \xef\xbb\xbf \xe2\x80\xa8 \r \t !!python/object/apply:os.system &a *a << "
    b"End\tSite JOINT ROOT MOTION OFFSET CHANNELS Frames: (1e9,) 'O' '<f8' |O"
).split(b" ")
MAX_BYTES = 1 << 20


def mutated(seeds: Sequence[bytes], rng: Random, *, text: bool) -> bytes:
    """Return a seed after one to four changes; those of text move lines and words more than bits."""
    data = bytearray(rng.choice(seeds))
    kinds = _OF_TEXT if text else _OF_BYTES
    for _ in range(rng.randint(1, 4)):
        rng.choice(kinds)(data, seeds, rng)
    return bytes(data[:MAX_BYTES])


def mutated_members(archive: bytes, rng: Random) -> bytes:
    """Change what is in a zip file, and pack it again with sizes and checksums that fit."""
    with zipfile.ZipFile(io.BytesIO(archive)) as old:
        members = [(info.filename, old.read(info)) for info in old.infolist()]
    contents = [content for _, content in members]
    chosen = rng.randrange(len(members))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as new:
        for k, (name, content) in enumerate(members):
            new.writestr(name, mutated([content, *contents], rng, text=False) if k == chosen else content)
    return packed.getvalue()


def with_ogg_checksums(data: bytes) -> bytes:
    """Make the checksums of all pages of an Ogg file right again, so that decoders look further."""
    out, at = bytearray(data), 0
    while (at := out.find(b"OggS", at)) >= 0:
        if len(out) < at + 27:
            break
        n_segments = out[at + 26]
        end = at + 27 + n_segments + sum(out[at + 27 : at + 27 + n_segments])
        out[at + 22 : at + 26] = bytes(4)
        struct.pack_into("<I", out, at + 22, _ogg_crc(bytes(out[at:end])))
        at += 27
    return bytes(out)


def _ogg_crc(page: bytes) -> int:
    crc = 0
    for byte in page:
        crc = (crc << 8 & 0xFFFFFFFF) ^ _OGG_TABLE[(crc >> 24) ^ byte]
    return crc


def _ogg_row(value: int) -> int:
    value <<= 24
    for _ in range(8):
        value = (value << 1 ^ (0x04C11DB7 if value >> 31 else 0)) & 0xFFFFFFFF
    return value


_OGG_TABLE = [_ogg_row(k) for k in range(256)]

_Change = Callable[[bytearray, Sequence[bytes], Random], None]


def _span(data: bytearray, rng: Random) -> tuple[int, int]:
    begin = rng.randrange(len(data) + 1)
    return begin, min(len(data), begin + rng.choice((1, 2, 4, 8, 32, 200, 2000)))


def _flip(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    for _ in range(rng.choice((1, 1, 2, 8))):
        if data:
            data[_place(data, rng)] ^= 1 << rng.randrange(8)


def _number(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    size = rng.choice((1, 2, 4, 8))
    if len(data) >= size:
        at = min(_place(data, rng), len(data) - size)
        value = rng.choice(_NUMBERS) % (1 << 8 * size)
        data[at : at + size] = value.to_bytes(size, rng.choice(("little", "big")))


def _place(data: bytearray, rng: Random) -> int:
    # Headers are short and decide most.
    return rng.randrange(min(len(data), rng.choice((64, 512, len(data)))))


def _cut(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    del data[rng.randrange(len(data) + 1) :]


def _remove(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    begin, end = _span(data, rng)
    del data[begin:end]


def _repeat(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    begin, end = _span(data, rng)
    data[begin:begin] = data[begin:end] * rng.choice((1, 1, 3, 50))


def _insert(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    begin, end = _span(data, rng)
    data[begin:begin] = rng.randbytes(end - begin)


def _splice(data: bytearray, seeds: Sequence[bytes], rng: Random) -> None:
    other = rng.choice(seeds)
    begin, end = _span(bytearray(other), rng)
    at = rng.randrange(len(data) + 1)
    data[at : at + rng.choice((0, end - begin))] = other[begin:end]


def _word(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    words = bytes(data).split(b" ")
    words[rng.randrange(len(words))] = rng.choice(_WORDS)
    data[:] = b" ".join(words)


def _insert_word(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    at = rng.randrange(len(data) + 1)
    data[at:at] = rng.choice(_WORDS) * rng.choice((1, 1, 1, 40))


def _lines(data: bytearray, _: Sequence[bytes], rng: Random) -> None:
    lines = bytes(data).split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(3)
    if kind == 0:
        lines[a], lines[b] = lines[b], lines[a]
    elif kind == 1:
        lines[a:a] = [lines[b]] * rng.choice((1, 2, 30))
    else:
        del lines[a]
    data[:] = b"\n".join(lines)


_OF_BYTES: tuple[_Change, ...] = (_flip, _flip, _number, _number, _number, _cut, _remove, _repeat, _insert, _splice)
_OF_TEXT: tuple[_Change, ...] = (_flip, _cut, _remove, _repeat, _splice, _word, _word, _insert_word, _lines, _lines)
