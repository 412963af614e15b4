"""Music in pages: Opus in an Ogg file whose bytes are the same each time."""

import io
import struct
import zlib

import numpy as np

from dancedata.core.audio_signal import AudioSignal

#: Bytes with their bits in reverse order.
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
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
        checksum = _crc(bytes(pages[place:end]))
        pages[place + _CHECKSUM : place + _CHECKSUM + 4] = struct.pack("<I", checksum)
        place = end
    return bytes(pages)


def _crc(data: bytes) -> int:
    """Return the checksum of RFC 3533: zlib's polynomial, with the bits of each byte the other way round."""
    value = zlib.crc32(data.translate(_REVERSED), 0xFFFFFFFF) ^ 0xFFFFFFFF
    return int(f"{value:032b}"[::-1], 2)


#: Sample rate of the music in a page, of those that Opus has.
_OPUS_RATE = 24_000


def opus(signal: AudioSignal) -> bytes:
    """Encode a signal; the same signal gives the same bytes."""
    import soundfile
    import soxr

    samples = np.clip(soxr.resample(signal.samples, signal.sample_rate, _OPUS_RATE), -1, 1)
    data = io.BytesIO()
    soundfile.write(data, samples, _OPUS_RATE, format="OGG", subtype="OPUS")
    return without_serial(data.getvalue())
