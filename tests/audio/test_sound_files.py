"""Files that decoders read in part, or not at all; of each kind some. `benchmarks/sounds.py` has a hundred."""

import io
import struct
import subprocess
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import soundfile

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError, UsageError
from dancedata.core.implausible import describe_implausible
from dancedata.core.quality import OF_MUSIC, music_flags
from dancedata.music.ffmpeg import ffmpeg_version, find_ffmpeg
from dancedata.music.signal import audio_length, load_audio
from dancedata.music.silence import levels, without_sound
from dancedata.music.sound_files import held
from tests.messages import raises_message

SECONDS = 3
needs_ffmpeg = pytest.mark.skipif(not ffmpeg_version(), reason="without ffmpeg")


def written(form: str, subtype: str | None = None, rate: int = 44_100, channels: int = 1) -> bytes:
    """Return a file with bursts of noise."""
    time = np.arange(SECONDS * rate) / rate
    noise = np.random.default_rng(1).standard_normal(len(time)) * np.exp(-9 * (time % 0.5)) / 5
    buffer = io.BytesIO()
    soundfile.write(buffer, noise[:, None].repeat(channels, axis=1), rate, subtype=subtype, format=form)
    return buffer.getvalue()


def sized(size: int) -> bytes:
    wav = written("WAV")
    return wav[:40] + struct.pack("<I", size) + wav[44:]


def xing(factor: float) -> bytes:
    mp3 = written("MP3")
    at = max(mp3.find(b"Xing", 0, 200), mp3.find(b"Info", 0, 200)) + 8
    return mp3[:at] + struct.pack(">I", int(struct.unpack(">I", mp3[at : at + 4])[0] * factor)) + mp3[at + 4 :]


def flac(total: int) -> bytes:
    whole = written("FLAC")
    return whole[:21] + bytes([whole[21] & 0xF0]) + struct.pack(">I", total) + whole[26:]


def id3(size: int) -> bytes:
    return b"ID3\x03\0\0" + bytes(size >> 7 * k & 0x7F for k in (3, 2, 1, 0)) + bytes(size)


def ape(size: int) -> bytes:
    item = struct.pack("<II", size, 2) + b"Cover\0" + np.random.default_rng(3).bytes(size)
    return item + b"APETAGEX" + struct.pack("<IIII", 2000, len(item) + 32, 1, 0) + bytes(8)


#: The boxes of an m4a file: its type, and some sound that is not looked at.
MP4 = struct.pack(">I4s4sI", 16, b"ftyp", b"M4A ", 0) + struct.pack(">I4s", 508, b"mdat") + bytes(500)


def foreign(flac: bytes) -> bytes:
    """Return a FLAC file that keeps the header of the wav that it was, as flac --keep-foreign-metadata does."""
    block = b"riff" + written("WAV")[:12]
    return flac[:42] + bytes([2]) + len(block).to_bytes(3, "big") + block + flac[42:]


def absent() -> str:
    raise UsageError("ffmpeg is not installed")


def length(path: Path, data: bytes) -> float:
    path.write_bytes(data)
    music = load_audio(path)
    assert audio_length(path) == (music.n_samples, music.sample_rate)
    return music.n_samples / music.sample_rate


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("gsm.wav", lambda: written("WAV", "GSM610", 8000)),
        ("g721.wav", lambda: written("WAV", "G721_32", 8000)),
        ("piped.wav", lambda: sized(0xFFFFFFFF)),
        ("too-long.wav", lambda: sized(2 * 44_100 * SECONDS + 16)),
        ("zeros-behind.wav", lambda: written("WAV") + bytes(5000)),
        ("chunk-behind.wav", lambda: written("WAV") + b"LIST" + struct.pack("<I", 200) + b"INFO" + bytes(196)),
        ("xmp-behind.wav", lambda: written("WAV") + b"<?xpacket?>" + 900 * b"text\n"),
        ("id3-behind.wav", lambda: written("WAV") + id3(900)),
        ("zeros-before.wav", lambda: bytes(512) + written("WAV")),
        ("mark-before.flac", lambda: b"\xef\xbb\xbf" + written("FLAC")),
        ("page-before.ogg", lambda: b"HTTP/1.1 200 OK\r\n\r\n" + written("OGG", "VORBIS")),
        ("rf64.wav", lambda: written("RF64")),
        ("tags.flac", lambda: id3(200) + written("FLAC")),
        ("zeros-behind.flac", lambda: written("FLAC") + bytes(5000)),
        ("zeros-before.mp3", lambda: bytes(3000) + written("MP3")),
        ("page-before.mp3", lambda: b"<html>" * 99 + written("MP3")),
        ("cover-behind.mp3", lambda: written("MP3") + ape(90_000)),
        ("tags.mp3", lambda: id3(50_000) + id3(99) + written("MP3") + b"TAG" + bytes(125)),
        ("mp3-in.wav", lambda: written("MP3")),
        ("zeros-behind.ogg", lambda: written("OGG", "VORBIS") + bytes(9000)),
        ("header-of-wav-within.flac", lambda: foreign(written("FLAC"))),
    ],
)
def test_read_without_ffmpeg(tmp_path, name, make, monkeypatch):
    monkeypatch.setattr("dancedata.music.signal.decode", None)
    assert abs(length(tmp_path / name, make()) - SECONDS) < 0.05


@needs_ffmpeg
@pytest.mark.parametrize(
    ("name", "make", "seconds"),
    [
        ("size-0.wav", lambda: sized(0), SECONDS),
        ("unknown.flac", lambda: flac(0), SECONDS),
        ("half.flac", lambda: flac(22_050 * SECONDS), SECONDS),
        ("joined.mp3", lambda: 2 * written("MP3"), 2 * SECONDS),
        ("rates.mp3", lambda: written("MP3") + written("MP3", rate=16_000), 2 * SECONDS),
        ("count.mp3", lambda: xing(0.9), SECONDS),
        ("bw64.wav", lambda: b"BW64" + written("RF64")[4:], SECONDS),
    ],
)
def test_read_to_the_end_by_ffmpeg(tmp_path: Path, name: str, make: Callable[[], bytes], seconds: float) -> None:
    assert abs(length(tmp_path / name, make()) - seconds) < 0.15  # the delay of a second mp3 stays in
    assert "decoded_by_ffmpeg" in dict(load_audio(tmp_path / name).findings)


@needs_ffmpeg
@pytest.mark.parametrize(
    ("name", "options", "findings"),
    [
        ("a.m4a", "-c:a aac", {"decoded_by_ffmpeg"}),
        ("a.aac", "-c:a aac -f adts", {"decoded_by_ffmpeg", "late_music"}),
        ("a.mp4", "-f lavfi -i color=c=red:s=16x16:r=5:d=3 -c:a aac -c:v mpeg4", {"decoded_by_ffmpeg"}),
        (
            "late.mp4",
            "-f lavfi -i color=c=red:s=16x16:r=5:d=3 -af asetpts=PTS+0.5/TB -c:a aac -c:v mpeg4",
            {"decoded_by_ffmpeg", "early_music"},
        ),
        ("a.webm", "-c:a libopus", {"decoded_by_ffmpeg"}),
        ("a.mka", "-c:a flac", {"decoded_by_ffmpeg"}),
        ("a.mp3", "-c:a libmp3lame -write_xing 0", {"late_music"}),
        ("a.opus", "-c:a libopus", set()),
    ],
)
def test_formats_of_ffmpeg(tmp_path: Path, name: str, options: str, findings: set[str]) -> None:
    (tmp_path / "a.wav").write_bytes(written("WAV"))
    command = [find_ffmpeg(), "-v", "error", "-i", str(tmp_path / "a.wav"), *options.split(), str(tmp_path / name)]
    subprocess.run(command, check=True)
    assert abs(length(tmp_path / name, (tmp_path / name).read_bytes()) - SECONDS) < 0.06
    assert set(dict(load_audio(tmp_path / name).findings)) == findings


@pytest.mark.parametrize(
    ("name", "make", "word"),
    [
        ("half.wav", lambda: sized(44_100 * SECONDS), "no chunk"),
        ("nearly.wav", lambda: sized(2 * 44_100 * SECONDS - 900), "no chunk"),
        ("joined.wav", lambda: 2 * written("WAV"), "another sound file"),
        ("joined.aiff", lambda: 2 * written("AIFF"), "another sound file"),
        ("half.au", lambda: written("AU")[:8] + struct.pack(">I", 90_000) + written("AU")[12:], "no chunk"),
        ("joined.flac", lambda: 2 * written("FLAC"), "another sound file"),
        ("mp3-behind.flac", lambda: written("FLAC") + written("MP3"), "behind the last frame"),
        ("mp3-behind.ogg", lambda: written("OGG", "VORBIS") + written("MP3"), "another sound file"),
        ("wav-behind.mp3", lambda: written("MP3") + written("WAV"), "another sound file"),
        ("wav-behind.m4a", lambda: MP4 + written("WAV"), "another sound file"),
        ("mp3-behind.m4a", lambda: MP4 + id3(9) + written("MP3"), "another sound file"),
        ("joined.w64", lambda: 2 * written("W64"), "another sound file"),
    ],
)
def test_further_sound_is_refused(tmp_path: Path, name: str, make: Callable[[], bytes], word: str) -> None:
    (tmp_path / name).write_bytes(make())
    for read in (load_audio, audio_length):
        with raises_message(DataError, word, where=name, reason="broken_audio"):
            read(tmp_path / name)


def test_a_flac_without_all_its_frames_is_refused(tmp_path: Path) -> None:
    """Also where it is cut between two frames, which no decoder minds."""
    whole = written("FLAC")
    cuts = [k for k in range(50_000, len(whole)) if whole[k : k + 2] == whole[42:44]][:3]
    for cut in (*cuts, len(whole) // 2, len(whole) - 3000):
        (tmp_path / "a.flac").write_bytes(whole[:cut])
        with raises_message(DataError, "flac decoder", where="a.flac", reason="broken_audio"):
            load_audio(tmp_path / "a.flac")


@needs_ffmpeg
@pytest.mark.parametrize(
    ("name", "inputs", "word"),
    [("two.mp4", 2, "2 streams.*-map 0:a:0"), ("two.ogg", 2, "2 streams"), ("none.mp4", 0, "no stream")],
)
def test_streams_to_choose_from(tmp_path: Path, name: str, inputs: int, word: str) -> None:
    (tmp_path / "a.wav").write_bytes(written("WAV"))
    sources = inputs * ["-i", str(tmp_path / "a.wav")] or ["-f", "lavfi", "-i", "color=c=red:s=16x16:r=5:d=1"]
    maps = [part for k in range(max(1, inputs)) for part in ("-map", str(k))]
    subprocess.run([find_ffmpeg(), "-v", "error", *sources, *maps, str(tmp_path / name)], check=True)
    with raises_message(DataError, word, where=name, reason="broken_audio"):
        load_audio(tmp_path / name)


def test_without_ffmpeg_the_command_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.music.ffmpeg.find_ffmpeg", absent)
    (tmp_path / "my song.wav").write_bytes(sized(0))
    with raises_message(DataError, "ffmpeg -n -i 'my song.wav'", where="my song.wav", reason="broken_audio"):
        load_audio(tmp_path / "my song.wav")


@pytest.mark.parametrize("what", [ValueError("odd"), RuntimeError("odd"), KeyError("odd")])
def test_an_exception_of_soundfile_is_the_files(tmp_path, what, monkeypatch):
    def fail(*arguments: object, **options: object) -> None:
        raise what

    (tmp_path / "a.wav").write_bytes(sized(44_100 * SECONDS * 2))
    monkeypatch.setattr("soundfile.SoundFile.read", fail)
    monkeypatch.setattr("dancedata.music.ffmpeg.find_ffmpeg", absent)
    with raises_message(DataError, "odd", where="a.wav", reason="broken_audio"):
        load_audio(tmp_path / "a.wav")


@pytest.mark.parametrize(("channels", "seconds_of_ogg"), [(1, 0.9), (2, 1.2)])
def test_what_a_cut_file_lacks_is_noted(tmp_path: Path, channels: int, seconds_of_ogg: float) -> None:
    for kind in ("WAV", "MP3", "AIFF", "AU", "W64", "OGG"):
        path, data = tmp_path / f"a.{kind.lower()}", written(kind, channels=channels)
        seconds = seconds_of_ogg if kind == "OGG" else SECONDS / 2  # codebooks precede it; its last page is cut
        assert length(path, data[: len(data) // 2]) == pytest.approx(seconds, abs=0.2)
        if kind != "OGG":  # its header states no length
            assert dict(load_audio(path).findings)["cut_music"] == pytest.approx(SECONDS / 2, abs=0.2)


def test_what_damage_has_taken_from_mp3_is_noted() -> None:
    """What follows is earlier than it was. Tags between joined files are no sound."""
    whole = written("MP3")
    half, lost = len(whole) // 2, len(whole) // 5
    damaged = held(whole[:half] + bytes(lost) + whole[half + lost :])
    assert damaged.cut_s == pytest.approx(SECONDS / 5, abs=0.1)
    assert held(whole + id3(900) + whole).cut_s == 0


RATE = 22_050
SECOND = np.arange(RATE) / RATE
CLICKS = np.exp(-20 * (SECOND % 0.5)) * np.sin(2000 * SECOND)


@pytest.mark.parametrize(
    ("music", "kind"),
    [(np.zeros(RATE), "silent_music"), (np.full(RATE, 0.5), "silent_music"),
     (1e-7 * np.random.default_rng(0).standard_normal(RATE), "silent_music"),
     (np.sin(2 * np.pi * 50 * SECOND), "steady_music"),
     (0.1 * np.random.default_rng(0).standard_normal(RATE), None), (CLICKS, None), (1e-3 * CLICKS, None),
     (0.5 + CLICKS / 4, None)],
)  # fmt: skip
@pytest.mark.parametrize("start", ["4", "4.6", "-0.5", "4.9"])
def test_music_without_sound(music: np.ndarray, kind: str | None, start: str) -> None:
    """Judged in the clip's part alone: the song sounds before and after it."""
    n = 3 if Fraction(start) > 0 else 0
    around = np.concatenate([*[CLICKS] * n, *[music] * 6, *[CLICKS] * 3])
    found = without_sound(levels(AudioSignal(around.astype(np.float32), RATE)), Fraction(start), Fraction(3))
    assert [flag for flag, _ in found] == ([kind] if kind else [])


def test_music_that_a_clip_does_not_reach_has_no_flag() -> None:
    assert without_sound(levels(AudioSignal(np.zeros(RATE, np.float32), RATE)), Fraction(9), Fraction(2)) == []


def test_every_flag_of_music_is_described() -> None:
    rows = [{"clip": "a", **flag.to_json()} for flag in music_flags([(kind, 0.5) for kind in OF_MUSIC])]
    text = "\n".join(describe_implausible(rows))
    assert all(kind in text for kind in OF_MUSIC)
