"""Sound files of every kind that people have: what dancedata reads of each, beside what ffmpeg decodes.

    python benchmarks/sounds.py                     # makes them in a temporary folder
    python benchmarks/sounds.py --keep DIR

Six seconds of noise bursts are written in many codecs, containers and odd forms. A file is right if what is read has
the length that ffmpeg decodes within a frame, or that was written where ffmpeg gives less; or if it is refused by
name. Ends with 1 if one is neither. It needs ffmpeg.
"""

from __future__ import annotations

import argparse
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile

from dancedata.core.errors import DataError
from dancedata.music.ffmpeg import find_ffmpeg
from dancedata.music.signal import audio_length, load_audio

RATE, SECONDS = 44_100, 6.0
#: Longest frame of a codec, seconds; ADPCM has blocks, opus at 48 kHz and AAC at low rates have long frames.
FRAME_S = 0.06


@dataclass(frozen=True)
class Row:
    """A file: what ffmpeg decodes, what dancedata reads, and its error; lengths in seconds."""

    name: str
    ffmpeg_s: float
    true_s: float
    read_s: float
    message: str
    findings: str

    @property
    def right(self) -> bool:
        """Whether the length is right, or the file was refused."""
        return bool(self.message) or abs(self.read_s - self.true_s) <= FRAME_S


def signal(seconds: float = SECONDS, rate: int = RATE, channels: int = 2, seed: int = 0) -> np.ndarray:
    """Return (n, channels) float64: bursts of noise, 120 to a minute, and a quiet chord."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    burst = 0.4 * rng.standard_normal((len(time), channels)) * np.exp(-12 * (time % 0.5))[:, None]
    chord = sum(0.05 * np.sin(2 * np.pi * hz * time) for hz in (220, 277.2, 329.6))
    return np.clip(burst + chord[:, None], -0.95, 0.95)


def _run(*arguments: str | Path) -> None:
    subprocess.run([find_ffmpeg(), "-v", "error", "-nostdin", "-y", *map(str, arguments)], check=True)


def ffmpeg_seconds(path: Path) -> float:
    """Return the seconds that ffmpeg decodes of the first stream of sound, as `ffmpeg -i FILE out.wav` does."""
    command = [find_ffmpeg(), "-v", "quiet", "-nostdin", "-i", str(path), "-map", "0:a:0", "-ac", "1", "-ar", "16000"]
    done = subprocess.run([*command, "-f", "s16le", "-"], capture_output=True, check=False)
    return len(done.stdout) / 2 / 16_000


def _chunk(name: bytes, content: bytes, pad: bool = True) -> bytes:
    return name + struct.pack("<I", len(content)) + content + (b"\0" if pad and len(content) % 2 else b"")


def _ape_tag(size: int) -> bytes:
    item = struct.pack("<II", size, 2) + b"Cover Art (Front)\0" + bytes(np.random.default_rng(3).bytes(size))
    return item + b"APETAGEX" + struct.pack("<IIII", 2000, len(item) + 32, 1, 0) + bytes(8)


def _id3_tag(size: int) -> bytes:
    return b"ID3\x03\0\0" + bytes(size >> 7 * k & 0x7F for k in (3, 2, 1, 0)) + bytes(size)


#: Files that soundfile writes: subtype and format.
BY_SOUNDFILE = {
    "u8.wav": ("PCM_U8", "WAV"), "s24.wav": ("PCM_24", "WAV"), "s32.wav": ("PCM_32", "WAV"),
    "f32.wav": ("FLOAT", "WAV"), "f64.wav": ("DOUBLE", "WAV"), "ulaw.wav": ("ULAW", "WAV"),
    "alaw.wav": ("ALAW", "WAV"), "ima-adpcm.wav": ("IMA_ADPCM", "WAV"), "ms-adpcm.wav": ("MS_ADPCM", "WAV"),
    "extensible.wav": ("PCM_24", "WAVEX"), "rf64.wav": ("PCM_16", "RF64"),
    "w64.w64": ("PCM_16", "W64"), "pcm.aiff": ("PCM_16", "AIFF"), "float.aifc": ("FLOAT", "AIFF"),
    "ulaw.aifc": ("ULAW", "AIFF"), "pcm.caf": ("PCM_16", "CAF"), "alac.caf": ("ALAC_16", "CAF"),
    "pcm.au": ("PCM_16", "AU"), "s16.flac": ("PCM_16", "FLAC"), "s24.flac": ("PCM_24", "FLAC"),
    "vorbis.ogg": ("VORBIS", "OGG"), "lame.mp3": ("MPEG_LAYER_III", "MP3"), "g721.wav": ("G721_32", "WAV"),
    "gsm.wav": ("GSM610", "WAV"), "opus.opus": ("OPUS", "OGG"), "51.wav": ("PCM_16", "WAVEX"),
}  # fmt: skip
#: Rate and channels of some of them.
LIKE = {"g721.wav": (8000, 1), "gsm.wav": (8000, 1), "opus.opus": (48_000, 2), "51.wav": (RATE, 6)}
_PICTURE = "-f lavfi -i color=c=red:s=64x64:r=10:d=6"
#: Files that ffmpeg writes from IN: its options.
BY_FFMPEG = {
    "aac.m4a": "IN -c:a aac", "alac.m4a": "IN -c:a alac", "adts.aac": "IN -c:a aac -f adts",
    "edit-list.m4a": "-ss 1.234 IN -c:a aac", "mono-22k.m4a": "IN -ac 1 -ar 22050 -c:a aac",
    "sound.mov": "IN -c:a pcm_s16le", "matroska.mka": "IN -c:a flac", "webm.webm": "IN -c:a libopus",
    "wma.wma": "IN -c:a wmav2", "mp2.mp2": "IN -c:a mp2", "ac3.ac3": "IN -c:a ac3", "wavpack.wv": "IN -c:a wavpack",
    "tta.tta": "IN -c:a tta", "flac-in.ogg": "IN -c:a flac -f ogg",
    "cbr-no-tag.mp3": "IN -c:a libmp3lame -write_xing 0", "vbr-no-tag.mp3": "IN -c:a libmp3lame -q:a 4 -write_xing 0",
    "fragmented.mp4": "IN -c:a aac -movflags frag_keyframe+empty_moov", "mp3-in.wav": "IN -c:a libmp3lame -f wav",
    "fast.m4a": "IN -c:a aac -movflags +faststart",
    "video.mp4": f"IN {_PICTURE} -c:a aac -c:v mpeg4 -shortest", "silent-video.mp4": f"{_PICTURE} -c:v mpeg4",
    "two-streams.mp4": "IN IN -map 0 -map 1 -c:a aac", "two-streams.ogg": "IN IN -map 0 -map 1 -c:a libvorbis",
}  # fmt: skip


def make(folder: Path) -> Iterator[tuple[str, float | None]]:
    """Write the files; yield name and true length, None where ffmpeg's is the truth."""
    base = folder / "base.wav"
    soundfile.write(base, signal(), RATE, subtype="PCM_16")
    for name, (subtype, form) in BY_SOUNDFILE.items():
        rate, channels = LIKE.get(name, (RATE, 2))
        if soundfile.check_format(form, subtype):
            soundfile.write(folder / name, signal(SECONDS, rate, channels), rate, subtype=subtype, format=form)
            yield name, None if "adpcm" in name or "gsm" in name else SECONDS
    for name, options in BY_FFMPEG.items():
        _run(*options.replace("IN", f"-i {base}").split(), folder / name)
        yield name, None
    for name, (content, length) in {**changed_wav(base.read_bytes()), **changed(folder)}.items():
        (folder / name).write_bytes(content)
        yield name, length


def changed_wav(wav: bytes) -> dict[str, tuple[bytes, float | None]]:
    """Return wav files with odd headers, and their length."""
    data = wav[44:]
    half = len(data) // 8 * 4

    def sizes(riff: int, size: int) -> bytes:
        return wav[:4] + struct.pack("<I", riff) + wav[8:40] + struct.pack("<I", size) + data

    before, behind = _chunk(b"LIST", b"INFOabc"), _chunk(b"LIST", b"INFOIART\3\0\0\0ab\0")
    return {
        "data-size-0.wav": (sizes(36, 0), SECONDS),
        "data-size-minus-1.wav": (sizes(0xFFFFFFFF, 0xFFFFFFFF), SECONDS),
        "data-size-7fffffff.wav": (sizes(0x7FFFFFFF, 0x7FFFFFFF - 36), SECONDS),
        "data-size-half.wav": (sizes(36 + half, half), SECONDS),
        "data-size-99-percent.wav": (sizes(len(wav), len(data) * 99 // 400 * 4), SECONDS),
        "data-size-16-too-many.wav": (sizes(len(wav), len(data) + 16), SECONDS),
        "odd-chunks.wav": (wav[:12] + before + wav[12:] + behind, SECONDS),
        "odd-chunks-unpadded.wav": (wav[:36] + _chunk(b"junk", b"abc", pad=False) + wav[36:], SECONDS),
        "id3-chunk-behind.wav": (wav + _chunk(b"id3 ", _id3_tag(101)), SECONDS),
        "id3v1-behind.wav": (wav + b"TAG" + bytes(125), SECONDS),
        "joined.wav": (wav + wav, 2 * SECONDS),
        "truncated.wav": (wav[: 44 + half], SECONDS / 2),
        "page.wav": (b"<html>404</html>", None),
        "empty.wav": (wav[:40] + bytes(4), None),
    }


def changed(folder: Path) -> dict[str, tuple[bytes, float | None]]:
    """Return other files with odd headers, further parts and tags, and their length."""
    names = ("rf64.wav", "s16.flac", "vorbis.ogg", "opus.opus", "lame.mp3", "aac.m4a", "adts.aac", "pcm.aiff")
    rf64, flac, ogg, opus, mp3, m4a, aac, aiff = ((folder / name).read_bytes() for name in names)
    fast, au = (folder / "fast.m4a").read_bytes(), (folder / "pcm.au").read_bytes()
    noise = np.random.default_rng(5).bytes(50_000)
    lyrics = b"LYRICSBEGIN" + b"LYR00020" + b"words " * 3 + b"xx"
    id3v1 = b"TAG" + bytes(125)
    return {
        "bw64.wav": (b"BW64" + rf64[4:], SECONDS),
        "zeros-behind.flac": (flac + bytes(5000), SECONDS),
        "unknown-length.flac": (_flac_total(flac, 0), SECONDS),
        "length-half.flac": (_flac_total(flac, round(SECONDS * RATE / 2)), SECONDS),
        "joined.flac": (flac + flac, 2 * SECONDS),
        "mp3-behind.flac": (flac + mp3, None),
        "truncated.flac": (flac[: len(flac) // 2], SECONDS / 2),
        "id3-before.flac": (_id3_tag(300) + flac, SECONDS),
        "chained.ogg": (ogg + _other_serial(ogg), 2 * SECONDS),
        "chained-short.ogg": (ogg + _other_serial(_part(folder, 0.5, RATE, "VORBIS", "OGG")), SECONDS + 0.5),
        "chained-rates.ogg": (ogg + _other_serial(_part(folder, 2, 22_050, "VORBIS", "OGG")), SECONDS + 2),
        "chained.opus": (opus + _other_serial(opus), 2 * SECONDS),
        "no-end-flag.opus": (_without_end(opus), SECONDS),
        "no-end-flag.ogg": (_without_end(ogg), SECONDS),
        "mp3-behind.ogg": (ogg + mp3, None),
        "junk-before.mp3": (bytes(3000) + mp3, SECONDS),
        "html-before.mp3": (b"<html>moved</html>\r\n" * 40 + mp3, SECONDS),
        "ape-cover-behind.mp3": (mp3 + _ape_tag(60_000), SECONDS),
        "lyrics-and-id3v1-behind.mp3": (mp3 + lyrics + b"%06d" % len(lyrics) + b"LYRICS200" + id3v1, SECONDS),
        "id3-55kB-twice.mp3": (_id3_tag(55_000) + _id3_tag(1000) + mp3, SECONDS),
        "joined.mp3": (mp3 + mp3, None),
        "two-rates.mp3": (mp3 + _part(folder, 4, 16_000), None),
        "two-channel-counts.mp3": (mp3 + _part(folder, 4, RATE, channels=1), None),
        "xing-0.mp3": (_xing(mp3, 0), None),
        "xing-95-percent.mp3": (_xing(mp3, 0.95), SECONDS),
        "xing-half.mp3": (_xing(mp3, 0.5), SECONDS),
        "xing-double.mp3": (_xing(mp3, 2), SECONDS),
        "truncated.mp3": (mp3[: len(mp3) // 2], SECONDS / 2),
        "wav-behind.mp3": (mp3 + rf64, None),
        "mp3-named.wav": (mp3, SECONDS),
        "m4a-named.mp3": (m4a, None),
        "joined.m4a": (m4a + m4a, 2 * SECONDS),
        "joined.aac": (aac + aac, None),
        "truncated.m4a": (fast[: len(fast) * 2 // 3], None),
        "junk-behind.aiff": (aiff + noise, None),
        "data-size-half.au": (au[:8] + struct.pack(">I", len(au) // 8 * 4) + au[12:], None),
        "playlist.mp3": (b"#EXTM3U\n#EXTINF:6,\nlame.mp3\n", None),
    }


def _flac_total(flac: bytes, total: int) -> bytes:
    """Return a FLAC file whose STREAMINFO counts `total` samples."""
    return flac[:21] + bytes([flac[21] & 0xF0 | total >> 32]) + struct.pack(">I", total & 0xFFFFFFFF) + flac[26:]


def _pages(ogg: bytes) -> Iterator[bytearray]:
    at = 0
    while at < len(ogg):
        n = ogg[at + 26]
        size = 27 + n + sum(ogg[at + 27 : at + 27 + n])
        yield bytearray(ogg[at : at + size])
        at += size


def _with_crc(page: bytearray) -> bytearray:
    page[22:26] = bytes(4)
    crc = 0
    for byte in page:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
    page[22:26] = struct.pack("<I", crc)
    return page


def _other_serial(ogg: bytes) -> bytes:
    pages = list(_pages(ogg))
    for page in pages:
        page[14:18] = struct.pack("<I", 4711)
    return b"".join(map(_with_crc, pages))


def _without_end(ogg: bytes) -> bytes:
    pages = list(_pages(ogg))
    pages[-1][5] &= ~4
    return b"".join(map(_with_crc, pages))


def _part(
    folder: Path, seconds: float, rate: int, subtype: str = "MPEG_LAYER_III", form: str = "MP3", channels: int = 2
) -> bytes:
    soundfile.write(folder / "part", signal(seconds, rate, channels, seed=1), rate, subtype=subtype, format=form)
    return (folder / "part").read_bytes()


def _xing(mp3: bytes, factor: float) -> bytes:
    at = max(mp3.find(b"Xing", 0, 300), mp3.find(b"Info", 0, 300)) + 8
    (count,) = struct.unpack(">I", mp3[at : at + 4])
    return mp3[:at] + struct.pack(">I", int(count * factor)) + mp3[at + 4 :]


def rows(folder: Path) -> Iterator[Row]:
    """Make the files, and read each in both ways."""
    for name, true_s in make(folder):
        path, read_s, message, findings = folder / name, 0.0, "", ""
        ffmpeg_s = ffmpeg_seconds(path)
        try:
            music = load_audio(path)
            read_s = music.n_samples / music.sample_rate
            findings = ", ".join(kind for kind, _ in music.findings)
            if audio_length(path) != (music.n_samples, music.sample_rate):
                findings += f" BUT audio_length {audio_length(path)}"
                read_s = -1
        except DataError as error:
            message = f"{error.reason}: {error.found}"
        yield Row(name, ffmpeg_s, ffmpeg_s if true_s is None else true_s, read_s, message, findings)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, help="folder for the files")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        made = list(rows(folder))
    for row in made:
        what = f"{row.read_s:7.3f}" if not row.message else "refused"
        note = row.message or row.findings
        print(f"{'' if row.right else 'WRONG ':6}{row.name:28} true {row.true_s:7.3f}  ffmpeg {row.ffmpeg_s:7.3f}  "
              f"read {what}  {note[:150]}")  # fmt: skip
    wrong = [row.name for row in made if not row.right]
    refused = sum(bool(row.message) for row in made)
    print(
        f"{len(made)} files: {len(made) - refused - len(wrong)} read, {refused} refused by name, {len(wrong)} wrong"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
