"""The structure of sound files: how much sound there is, and what a decoder would leave unread without a word.

Decoders stop where the first of several joined files ends, where a header counts less than there is, or where an mp3
changes its rate. So the parts of a file are counted here: chunks of wav, AIFF, CAF, W64 and AU, pages of Ogg (RFC
3533), frames of FLAC (RFC 9639) and MPEG audio, boxes of MP4 (ISO 14496-12). Tags and padding do not count.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from dancedata.music.mpeg_frames import mpeg_audio

_MATROSKA = b"\x1aE\xdf\xa3"
#: Where another file begins: bytes to look for, their distance from its first byte, and what it begins with.
_FILES = tuple(
    (sought, back, re.compile(head, re.DOTALL))
    for sought, back, head in (
        (b"WAVE", 8, rb"(?:RIF[FX]|RF64|BW64)...."),
        (b"AIF", 8, rb"FORM....AIF[FC]"),
        (b"OggS\x00\x02", 0, rb"OggS"),
        (b"fLaC", 0, rb"....[\x00\x80]\x00\x00\x22"),
        (b"caff", 0, rb"....\x00\x01\x00\x00"),
        (b"ftyp", 4, rb"........(?:M4[ABVP] |mp4[12]|iso[m2-6]|qt  |dash|3gp.)"),
        (_MATROSKA, 0, rb".{5,44}(?:webm|matroska)"),
        (b"\x30\x26\xb2\x75\x8e\x66\xcf\x11", 0, rb".{8}\xa6\xd9\x00\xaa\x00\x62\xce\x6c"),
    )
)
#: Sizes from here on stand for "unknown" in a header that was written to a pipe.
_UNKNOWN = (1 << 31) - (1 << 17)
#: Fewer bytes behind the last chunk are not taken for sound.
_FEW = 64
#: A stream of Ogg whose first page ends later than this is a part of a longer one, seconds.
_PART_S = 10
_MP3_IN_WAV = 0x55
_ID3_HEAD = 10
#: Bytes in front of a file that are skipped, at most.
_MOST_JUNK = 1 << 20
#: What no chunk within a file is called, but a file behind it.
_HEADS = (b"RIFF", b"RIFX", b"RF64", b"BW64", b"FORM", b"riff", b"caff", b"fLaC", b"OggS")
#: Formats that are known by their first bytes, and not examined.
_KNOWN = (_MATROSKA, b"\x30\x26\xb2\x75", b"wvpk", b"TTA1", b"#EXT", b"\x0b\x77")
#: Samples by which AAC is late: a frame, of most encoders two; sample rates by their number in ADTS (ISO 13818-7).
_AAC_DELAY = 1024
_AAC_RATES = (96_000, 88_200, 64_000, 48_000, 44_100, 32_000, 24_000, 22_050, 16_000, 12_000, 11_025, 8_000, 7_350)
#: Signature, header of a block, STREAMINFO.
_FLAC_HEAD = 42

_Chunk = tuple[bytes, int, int]  # name, first byte and size of its content


@dataclass(frozen=True)
class Held:
    """What a file holds."""

    problem: str = ""  # why decoders do not read all of it
    refused: bool = False  # whether none is known to
    seconds: float = 0.0  # least length of sound to decode; 0 if unknown
    delay_s: float = 0.0  # the encoder's, which no tag states, so that it is kept
    begin: int = 0  # first byte of the sound, where no tag is before it
    exact: bool = False  # whether `seconds` is the length itself
    cut_s: float = 0.0  # seconds that the header announces and the file lacks
    cut: float = 0.0  # the same, of chunks, as a multiple of the sound

    def is_cut(self, n_samples: int, rate: int) -> bool:
        """Return whether so many samples are fewer than the file has."""
        return n_samples + 0.5 < self.seconds * rate


def held(data: bytes) -> Held:
    """Examine the bytes, or a memory map, of a file; of unknown formats nothing is known."""
    begin, end = _without_tags(data)
    head, kind = data[begin : begin + 4], data[begin + 8 : begin + 12]
    if head == b"OggS":
        return _ogg(data, begin, end)
    if head in (b"RIFF", b"RIFX", b"RF64", b"BW64") and kind == b"WAVE":
        return _wav(data, begin, end, "big" if head == b"RIFX" else "little")
    if head == b"FORM" and kind in (b"AIFF", b"AIFC"):
        return _behind(data, end, [*_riff(data, begin, end, "big", b"SSND")], b"SSND")
    if head in (b"caff", b"riff", b".snd"):
        read = {b"caff": _caf, b"riff": _w64, b".snd": _au}[head]
        return _behind(data, end, [*read(data, begin, end)], b"data")
    known, sought = head.startswith(_KNOWN), begin
    if head == b"fLaC":
        # flac --keep-foreign-metadata keeps the header of the wav that it was.
        found, known, sought = _flac(data, begin, end), True, _flac_frames(data, begin, end)
    elif data[begin + 4 : begin + 8] == b"ftyp":
        found, known = _mp4(data, begin, end), True
    else:
        found = Held() if known else _mpeg(data, begin, end)
    other = -1 if found.refused else _another(data, sought, end)
    if found == Held() and not known and 0 <= other - begin < _MOST_JUNK:  # no frame of mp3 either
        within = held(data[other:])
        return replace(within, begin=other + within.begin)
    return (
        found if other < 0 else replace(found, problem=f"another sound file begins at byte {other:,}", refused=True)
    )


def _another(data: bytes, begin: int, end: int) -> int:
    """Return the first byte of a file behind the one that begins at `begin`; -1 if there is none."""
    held_in = (b"fLaC",) if data[begin : begin + 4] == _MATROSKA else ()  # such a header is a part of its own
    first = end
    for sought, back, head in _FILES:
        at = -1 if sought in held_in else data.find(sought, begin + back + 1, end)
        while 0 <= at - back < first:
            if head.match(data, at - back):
                first = at - back
            at = data.find(sought, at + 1, end)
    return first if first < end else -1


def _without_tags(data: bytes) -> tuple[int, int]:
    """Return begin and end of a file without its tags: ID3v2 in front; ID3v1, APE and Lyrics3 behind."""
    begin, end = 0, len(data)
    while data[begin : begin + 3] == b"ID3" and end - begin >= _ID3_HEAD:
        begin = min(end, begin + _id3_size(data, begin))
    while True:
        if data[end - 128 : end - 125] == b"TAG":
            size = 128
        elif data[end - 32 : end - 24] == b"APETAGEX":
            size = int.from_bytes(data[end - 20 : end - 16], "little") + (32 if data[end - 9] & 0x80 else 0)
        elif data[end - 9 : end] == b"LYRICS200" and data[end - 15 : end - 9].isdigit():
            size = int(data[end - 15 : end - 9]) + 15
        else:
            return begin, end
        if not 0 < size <= end - begin:
            return begin, end
        end -= size


def _id3_size(data: bytes, at: int) -> int:
    size = sum(data[at + 6 + k] << 7 * (3 - k) for k in range(4))
    return size + (2 if data[at + 5] & 0x10 else 1) * _ID3_HEAD


def _is_text(rest: bytes) -> bool:
    """Return whether bytes are a text, such as XMP: samples are not."""
    try:
        return all(c.isprintable() or c.isspace() for c in rest.decode())
    except UnicodeDecodeError:
        return False


def _mpeg(data: bytes, begin: int, end: int) -> Held:
    header = data[begin : begin + 4]
    if len(header) == 4 and header[0] == 0xFF and header[1] & 0xF6 == 0xF0:  # ADTS, which has no tag of a delay
        return Held(delay_s=_AAC_DELAY / _AAC_RATES[min(header[2] >> 2 & 0xF, len(_AAC_RATES) - 1)])
    audio = mpeg_audio(data, begin, end)
    if audio is None:
        return Held()
    problem = f"a sample rate that changes: {', '.join(map(str, audio.rates))} Hz" if len(audio.rates) > 1 else ""
    return Held(
        problem, seconds=audio.least_s, delay_s=audio.delay_s, cut_s=audio.cut_s, begin=0 if begin else audio.begin
    )


# Files of chunks


def _wav(data: bytes, begin: int, end: int, order: Literal["little", "big"]) -> Held:
    chunks = list(_riff(data, begin, end, order, b"data"))
    found = _behind(data, end, chunks, b"data")
    first = {name: (start, size) for name, start, size in reversed(chunks)}
    if b"fmt " not in first or b"data" not in first:
        return found
    (form, _), (start, size) = first[b"fmt "], first[b"data"]
    tag, per_second = (int.from_bytes(data[form + k : form + k + n], order) for k, n in ((0, 2), (8, 4)))
    if tag == _MP3_IN_WAV:
        return replace(
            _mpeg(data, start, min(end, start + size)), problem=found.problem, refused=found.refused, begin=0
        )
    if not per_second:
        return found
    seconds = (end - start) / per_second if not size else 0.0
    return replace(found, seconds=0.95 * seconds)


def _behind(data: bytes, end: int, chunks: list[_Chunk], sound: bytes) -> Held:
    """Examine what is behind the chunks of a file."""
    sounds = [(start, size) for name, start, size in chunks if name == sound and size]
    if len(sounds) > 1:
        return Held(f"{len(sounds)} chunks of sound", refused=True)
    last = max((start + size + size % 2 for _, start, size in chunks), default=end)
    while data[last : last + 3] == b"ID3" and end - last >= _ID3_HEAD:
        last += _id3_size(data, last)
    rest = data[last:end]
    if len(sounds) == 1 and (start := sounds[0][0]) < end < start + sounds[0][1]:
        return Held(cut=(start + sounds[0][1] - end) / (end - start))
    if len(rest) < _FEW or _is_text(rest.strip(b"\0")):
        return Held()
    if not sounds:
        return Held(f"a header with a length of 0 before {len(rest):,} bytes of sound")
    what = "that begin another sound file" if rest[:4] in _HEADS else "that are no chunk"
    return Held(
        f"a header that announces {sounds[0][1]:,} bytes of sound, and {len(rest):,} bytes after it {what}",
        refused=True,
    )


def _riff(data: bytes, at: int, end: int, order: Literal["little", "big"], sound: bytes) -> Iterator[_Chunk]:
    at, ds64 = at + 12, 0
    while at + 8 <= end and (name := data[at : at + 4]).isascii() and name.decode().isprintable():
        size = int.from_bytes(data[at + 4 : at + 8], order)
        if name == b"ds64":
            ds64 = int.from_bytes(data[at + 16 : at + 24], "little")
        if name == sound and size >= _UNKNOWN:
            size = ds64 or end - at - 8
        elif name in _HEADS or (name != sound and at + 8 + size > end):
            return
        yield name, at + 8, size
        at += 8 + size
        # Some writers do not pad chunks of odd sizes.
        at += size % 2 and not (data[at : at + 4].isalpha() and data[at : at + 1] != b"\0")


def _caf(data: bytes, at: int, end: int) -> Iterator[_Chunk]:
    at += 8
    while at + 12 <= end:
        size = int.from_bytes(data[at + 4 : at + 12], "big", signed=True)
        size = end - at - 12 if size < 0 else size
        if data[at : at + 4] != b"data" and at + 12 + size > end:
            return
        yield data[at : at + 4], at + 12, size
        at += 12 + size


def _w64(data: bytes, at: int, end: int) -> Iterator[_Chunk]:
    at += 40  # the identifier of 16 bytes, the size, the identifier of waves
    while at + 24 <= end:
        size = int.from_bytes(data[at + 16 : at + 24], "little")
        if size < 24 or data[at : at + 4] in _HEADS or (data[at : at + 4] != b"data" and at + size > end):
            return
        yield data[at : at + 4], at + 24, size - 24 + -size % 8
        at += size + -size % 8


def _au(data: bytes, at: int, end: int) -> Iterator[_Chunk]:
    first, size = (int.from_bytes(data[at + k : at + k + 4], "big") for k in (4, 8))
    yield b"data", at + first, end - at - first if size >= _UNKNOWN else size


def _mp4(data: bytes, at: int, end: int) -> Held:
    boxes = []
    while at + 8 <= end:
        size, name = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        size = int.from_bytes(data[at + 8 : at + 16], "big") if size == 1 else size or end - at
        if size < 8 or not name.decode("latin1").isprintable():
            break
        boxes.append(name)
        at += size
    if at < end and mpeg_audio(data, at, end):
        return Held(f"another sound file begins at byte {at:,}", refused=True)
    if boxes.count(b"moov") > 1:
        return Held(f"{boxes.count(b'moov')} files, one behind the other", refused=True)
    return Held()


# Ogg


@dataclass
class _Stream:
    """A logical stream of Ogg: granules are counted at `rate`, `late` of them before the sound."""

    rate: int
    late: int = 0
    first: int = 0
    last: int = 0
    open_ended: bool = False

    @property
    def seconds(self) -> float:
        begin = self.first if self.first > _PART_S * self.rate else self.late
        return max(0.0, (self.last - begin) / self.rate)


def _ogg(data: bytes, at: int, end: int) -> Held:
    """Count the sound of an Ogg file: streams of one time are others to choose from, links follow each other."""
    links: list[dict[int, _Stream]] = []
    in_head = False
    while at + 27 <= end:
        if data[at : at + 4] != b"OggS":
            page = data.find(b"OggS", at, end)
            if page < 0:
                break
            at = page
        n = data[at + 26]
        body = at + 27 + n
        following = body + sum(data[at + 27 : body])
        if following > end:
            break
        if data[at + 5] & 2:
            if not in_head:
                links.append({})
            in_head = True
            if (stream := _stream(data[body : body + 64])) is not None:
                links[-1][_serial(data, at)] = stream
        else:
            in_head = False
            granule = int.from_bytes(data[at + 6 : at + 14], "little", signed=True)
            if links and granule > 0 and (known := links[-1].get(_serial(data, at))) is not None:
                known.first, known.last = known.first or granule, max(known.last, granule)
                # Of Opus, libsndfile refuses the last page without the flag of the end; Vorbis it reads.
                known.open_ended = known.late > 0 and not data[at + 5] & 4
        at = following
    several = max((len(link) for link in links), default=0)
    if several > 1:
        return Held(f"{several} streams of sound at once", refused=True)
    if at < end and (_another(data, at - 1, end) >= 0 or mpeg_audio(data, at, end)):
        return Held(f"another sound file begins at byte {at:,}", refused=True)
    streams = [stream for link in links for stream in link.values()]
    problem = f"{len(streams)} streams, one behind the other" if len(streams) > 1 else ""
    if not problem and any(stream.open_ended for stream in streams):
        problem = "a stream whose end is not marked"
    return Held(problem, seconds=sum(stream.seconds for stream in streams) - 0.02)


def _serial(data: bytes, at: int) -> int:
    return int.from_bytes(data[at + 14 : at + 18], "little")


def _stream(packet: bytes) -> _Stream | None:
    """Return the stream that begins with a packet; None if it is not sound."""
    if packet[:7] == b"\x01vorbis":
        return _Stream(int.from_bytes(packet[12:16], "little") or 1)
    if packet[:8] == b"OpusHead":
        return _Stream(48_000, int.from_bytes(packet[10:12], "little"))
    if packet[:8] == b"Speex   ":
        return _Stream(int.from_bytes(packet[36:40], "little") or 1)
    if packet[:5] == b"\x7fFLAC":
        return _Stream(int.from_bytes(packet[27:30], "big") >> 4 or 1)
    return None


# FLAC


def _flac(data: bytes, begin: int, end: int) -> Held:
    """Compare the samples in the header of a FLAC file, where 0 is unknown, with the number of its last frame."""
    info = data[begin + 8 : begin + _FLAC_HEAD]
    fixed, longest = int.from_bytes(info[:2], "big"), int.from_bytes(info[7:10], "big")
    rate, total = int.from_bytes(info[10:13], "big") >> 4 or 1, int.from_bytes(info[13:18], "big") & (1 << 36) - 1
    at = _flac_frames(data, begin, end)
    head = data[at : at + 4]
    place, n_samples = end, 0
    while len(head) == 4 and (place := data.rfind(head[:2], at, place)) >= 0:
        n_samples = _samples_up_to(data[place : place + 17].ljust(17, b"\0"), head, fixed)
        if n_samples:
            break
    if not n_samples:
        return Held()
    if longest and end - place > longest + _FEW and data[place + longest : end].strip(b"\0"):
        return Held(f"{end - place - longest:,} bytes behind the last frame", refused=True)
    if not total:
        return Held("a header of unknown length", seconds=n_samples / rate, exact=True)
    problem = f"a header with {total:,} of {n_samples:,} samples" if n_samples > total else ""
    return Held(problem, seconds=max(n_samples, total) / rate, exact=True)


def _flac_frames(data: bytes, begin: int, end: int) -> int:
    """Return the first byte behind the metadata of a FLAC file."""
    at, is_last = begin + 4, 0
    while at + 4 <= end and not is_last:
        is_last, at = data[at] & 0x80, at + 4 + int.from_bytes(data[at + 1 : at + 4], "big")
    return at


def _samples_up_to(header: bytes, like: bytes, fixed: int) -> int:
    """Return the samples up to the end of the frame with this header; 0 if it is none of the file."""
    if (header[2] ^ like[2]) & 0x0F or (header[3] ^ like[3]) & 0x0F or header[3] >> 4 > 10:
        return 0
    # The number of the frame, or of its first sample, is coded as in UTF-8.
    n_more = next((k for k in range(7) if not header[4] & 0x80 >> k), 7) - 1
    number, at = (header[4], 5) if n_more < 0 else (header[4] & 0x3F >> n_more, 5 + n_more)
    for byte in header[5:at]:
        number = number << 6 | byte & 0x3F
    code = header[2] >> 4
    if code in (6, 7):
        n_samples, at = int.from_bytes(header[at : at + code - 5], "big") + 1, at + code - 5
    else:
        n_samples = 0 if not code else 192 if code == 1 else 576 << code - 2 if code < 6 else 256 << code - 8
    at += {12: 1, 13: 2, 14: 2}.get(header[2] & 0x0F, 0)
    if n_more == 0 or _crc8(header[:at]) != header[at]:
        return 0
    return (number if header[1] & 1 else number * fixed) + n_samples


def _crc8(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x07 if crc & 0x80 else crc << 1) & 0xFF
    return crc
