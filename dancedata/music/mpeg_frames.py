"""Frames of MPEG audio, layers I to III (ISO 11172-3, 13818-3), counted without decoding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

#: Bits per second by version and layer, in 1000; index 0 is a free format, whose frames cannot be found.
_STEPS = (32, 40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320)
_LOW = (8, 16, 24, 32, 40, 48, 56, 64, 80, 96, 112, 128, 144, 160)
_KBITS: Mapping[tuple[bool, int], tuple[int, ...]] = {
    (True, 1): tuple(range(32, 449, 32)),
    (True, 2): (32, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320, 384),
    (True, 3): _STEPS,
    (False, 1): (32, 48, 56, 64, 80, 96, 112, 128, 144, 160, 176, 192, 224, 256),
    (False, 2): _LOW,
    (False, 3): _LOW,
}
_RATES = {3: (44_100, 48_000, 32_000), 2: (22_050, 24_000, 16_000), 0: (11_025, 12_000, 8_000)}
#: Frames in a row that show that a sync word is one, and bytes in front of the first one that are searched.
_IN_A_ROW, _SEARCHED = 3, 1 << 20
#: What begins a tag, which joined files have between their frames.
_TAGS = (b"ID3", b"TAG", b"APETAGEX", b"LYRICS")
#: Samples that decoders of layer III add in front, beside those of the encoder.
_DECODER_DELAY = 529
#: Samples by which LAME and its heirs begin later than their input.
_ENCODER_DELAY = 576


@dataclass(frozen=True)
class MpegAudio:
    """The frames of a file."""

    least_s: float  # of all frames but delay, padding and two that decoders may need
    rates: tuple[int, ...]  # sample rates in their order
    cut_s: float  # of frames that a tag counts, or of bytes between frames
    delay_s: float  # of encoder and decoder, where no tag states it
    begin: int  # first byte of the first frame


def mpeg_audio(data: bytes, begin: int, end: int) -> MpegAudio | None:
    """Find and count the frames between two bytes of a file; None if there are none, or only in free format."""
    at, last, first = begin, -1, -1
    seconds = frame_s = lost_s = 0.0
    rates: dict[int, None] = {}
    stated, announced = False, 0.0
    while at + 4 <= end and (first >= 0 or at - begin < _SEARCHED):
        frame = _frame(data[at + 1 : at + 4]) if data[at] == 0xFF else None
        if frame is None or (last != at and not _is_chain(data, at, end)):
            at = data.find(b"\xff", at + 1, end)
            if at < 0:
                break
            continue
        size, n_samples, rate = frame
        if at + size > end:
            break
        rates[rate] = None
        frame_s = n_samples / rate
        if 0 <= last < at and not data[last : last + 8].startswith(_TAGS):
            lost_s += frame_s * (at - last) / size
        tag = _tag(data[at : at + min(size, 256)])
        if tag is None:
            seconds += frame_s
        else:
            seconds -= tag[0] / rate
            stated |= tag[0] > 0
            announced += tag[1] * frame_s - tag[0] / rate
        first = at if first < 0 else first
        at = last = at + size
    if first < 0:
        return None
    delay = 0.0 if stated else (_ENCODER_DELAY + _DECODER_DELAY) / next(iter(rates))
    cut_s = max(0.0, announced - seconds, lost_s)
    return MpegAudio(max(0.0, seconds - 2 * frame_s), tuple(rates), cut_s, delay, first)


@lru_cache(maxsize=4096)
def _frame(header: bytes) -> tuple[int, int, int] | None:
    """Return bytes, samples and rate of a frame from the three bytes behind its first; None for other bytes."""
    if len(header) < 3 or header[0] & 0xE0 != 0xE0:
        return None
    version, layer = header[0] >> 3 & 3, 4 - (header[0] >> 1 & 3)
    kbits, rate = header[1] >> 4, header[1] >> 2 & 3
    if version == 1 or layer == 4 or kbits in (0, 15) or rate == 3 or header[2] & 3 == 2:
        return None
    hz, bits = _RATES[version][rate], 1000 * _KBITS[version == 3, layer][kbits - 1]
    padding = header[1] >> 1 & 1
    if layer == 1:
        return (12 * bits // hz + padding) * 4, 384, hz
    n_samples = 576 if layer == 3 and version != 3 else 1152
    return n_samples // 8 * bits // hz + padding, n_samples, hz


def _is_chain(data: bytes, at: int, end: int) -> bool:
    """Return whether frames follow each other from here on, some or up to the end."""
    for _ in range(_IN_A_ROW):
        frame = _frame(data[at + 1 : at + 4]) if data[at] == 0xFF else None
        if frame is None:
            return False
        at += frame[0]
        if at >= end - 4:
            return True
    return True


def _tag(frame: bytes) -> tuple[int, int] | None:
    """Return samples of delay and padding, and frames, that a tag (Xing, Info, VBRI) states; None for sound.

    It is behind the side information. Decoders use delay and padding where it counts the frames, too.
    """
    at = next((k for k in (36, 21, 13, 38, 23, 15) if frame[k : k + 4] in (b"Xing", b"Info")), -1)
    if at < 0:
        return (0, 0) if frame[36:40] == b"VBRI" else None
    flags = frame[at + 7] if len(frame) > at + 7 else 0
    tag = at + 8 + sum(size for bit, size in ((1, 4), (2, 4), (4, 100), (8, 4)) if flags & bit)
    n_frames = int.from_bytes(frame[at + 8 : at + 12], "big") if flags & 1 else 0
    both = int.from_bytes(frame[tag + 21 : tag + 24], "big")
    return ((both >> 12) + (both & 0xFFF) if n_frames and both >> 12 else 0), n_frames
