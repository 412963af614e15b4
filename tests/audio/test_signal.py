"""Decoding, lengths, quantising and resampling, on files that the tests write."""

import io
import os
from pathlib import Path

import numpy as np
import pytest
import soundfile

from dancedata.core.audio_signal import pcm16, resampled_length
from dancedata.core.errors import DataError
from dancedata.music.samples import resample
from dancedata.music.signal import audio_length, load_audio
from tests.messages import raises_message

FORMATS = [
    # file, subtype, rate, largest decoding error: half a step (float sources are rounded), None where lossy
    ("a.wav", "PCM_U8", 44100, 1 / 127),
    ("a.wav", "PCM_16", 48000, 1 / 32768),
    ("a.wav", "PCM_24", 44100, 1 / 2**23),
    ("a.wav", "PCM_32", 96000, 1e-7),
    ("a.wav", "FLOAT", 22050, 0.0),
    ("a.wav", "DOUBLE", 44100, 0.0),
    ("a.flac", "PCM_16", 44100, 1 / 32768),
    ("a.flac", "PCM_24", 48000, 1 / 2**23),
    ("a.ogg", "VORBIS", 44100, None),
    ("a.ogg", "OPUS", 48000, None),
    ("a.mp3", "MPEG_LAYER_III", 44100, None),
    ("a.mp3", "MPEG_LAYER_III", 22050, None),
    ("Ünï 舞 (mix) #1.flac", "PCM_16", 44100, 1 / 32768),
]


@pytest.mark.parametrize(("name", "subtype", "rate", "tolerance"), FORMATS)
@pytest.mark.parametrize("channels", [1, 2])
def test_formats(tmp_path, stereo_noise, name, subtype, rate, tolerance, channels, librosa_load):
    path = tmp_path / name
    source = stereo_noise[:, :channels]
    soundfile.write(path, source, rate, subtype=subtype)
    signal = load_audio(path)
    assert signal.samples.dtype == np.float32
    assert signal.samples.shape == (len(source),)
    assert signal.sample_rate == rate
    assert audio_length(path) == (len(source), rate)
    assert np.array_equal(signal.samples, librosa_load(path))
    if tolerance is not None:
        np.testing.assert_allclose(signal.samples, np.mean(source.T, axis=0), rtol=0, atol=tolerance)


def test_float_beyond_full_scale_is_kept(tmp_path: Path) -> None:
    source = np.array([0.0, 1.5, -2.0], dtype=np.float32)
    soundfile.write(tmp_path / "loud.wav", source, 44100, subtype="FLOAT")
    assert np.array_equal(load_audio(tmp_path / "loud.wav").samples, source)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_number(tmp_path: Path, value: float) -> None:
    source = np.zeros((44100, 2), dtype=np.float32)
    source[11025, 1] = value
    soundfile.write(tmp_path / "bad.wav", source, 44100, subtype="FLOAT")
    with raises_message(DataError, "example", where="bad.wav", reason="nan"):
        load_audio(tmp_path / "bad.wav")


def wav(samples=100, rate=44100):
    return lambda path: soundfile.write(path, np.zeros(samples), rate)


def cut_wav(path):
    soundfile.write(path, np.zeros(100), 44100)
    path.write_bytes(path.read_bytes()[:30])


@pytest.mark.parametrize(
    ("name", "make", "word", "reason"),
    [
        ("empty.wav", wav(0), "samples", "empty_audio"),
        ("empty.ogg", wav(0), "samples", "empty_audio"),
        *((f"zero.{form}", Path.touch, "doubt", "broken_audio") for form in ("wav", "mp3", "ogg", "flac")),
        ("page.wav", lambda path: path.write_text("<html>404</html>"), "Format not recognised", "broken_audio"),
        ("a.raw", lambda path: path.write_bytes(bytes(1000)), "samplerate", "broken_audio"),
        ("cut.wav", cut_wav, "", "broken_audio"),
        # A low rate makes hours of a small file, and gigabytes once it is resampled.
        *(("a.wav", wav(100_000, r), "decoded", "broken_audio") for r in (1, 3999, 400_001, 2_000_000_000)),
        # Half an hour at 4 kHz: 29 MB unchanged, 346 MB at 48 kHz, in a file of some kilobytes.
        ("a.flac", wav(4000 * 1800, 4000), "doubt", "broken_audio"),
        ("a.wav", os.mkfifo, "doubt", "broken_audio"),
        ("nowhere.wav", lambda path: None, "exist", "missing_file"),
        (".", lambda path: None, "exist", "missing_file"),
    ],
)
@pytest.mark.parametrize("read", [load_audio, audio_length])
def test_bad_files(tmp_path, read, name, make, word, reason):
    make(tmp_path / name)
    with raises_message(DataError, word, where=name.strip("."), reason=reason):
        read(tmp_path / name)


@pytest.mark.parametrize("read", [load_audio, audio_length])
def test_bounds_of_rates_and_lengths(tmp_path, read, monkeypatch):
    for rate in (4000, 400_000):
        wav(rate=rate)(tmp_path / "a.wav")
        read(tmp_path / "a.wav")
    monkeypatch.setattr("dancedata.music.signal.MAX_BYTES", 4 * 48_000)
    wav(8000, 8000)(tmp_path / "a.wav")
    read(tmp_path / "a.wav")
    wav(8001, 8000)(tmp_path / "a.wav")
    with raises_message(DataError, "doubt", where="a.wav", reason="broken_audio"):
        read(tmp_path / "a.wav")


@pytest.mark.parametrize("first", ["quiet", "loud"])
def test_mp3_whose_header_misjudges_the_length(tmp_path, first):
    """Of small first frames the estimate is too long; of large ones too short, and libsndfile would stop there."""
    source = np.random.default_rng(2).uniform(-0.5, 0.5, 88200).astype(np.float32)
    if first == "quiet":
        source = np.concatenate([0 * source, source, 0 * source])
    buffer = io.BytesIO()
    soundfile.write(buffer, source, 44100, format="MP3", bitrate_mode="VARIABLE", compression_level=0.3)
    mp3, path = buffer.getvalue(), tmp_path / "a.mp3"
    # The first frame holds the Xing or Info header.
    path.write_bytes(mp3[mp3.find(b"\xff\xfb", 4) :] if first == "quiet" else mp3 * 2)
    if first == "quiet":
        assert soundfile.info(path).frames > 1.5 * len(source)
    n_samples, rate = audio_length(path)
    assert (load_audio(path).n_samples, 44100) == (n_samples, rate)
    # Without the header, encoder delay and padding stay in.
    assert abs(n_samples - len(source) * (1 if first == "quiet" else 2)) < 4 * 1152


def test_a_damaged_mp3_has_the_length_that_decodes() -> None:
    # Found by fuzzing (seed 20262): the decoder skips damaged bytes, and a seek into the file then misses its place.
    path = Path(__file__).parent / "data" / "resync.mp3"
    signal = load_audio(path)
    assert audio_length(path) == (signal.n_samples, signal.sample_rate)


def test_pcm16_equals_libsndfiles_output() -> None:
    rng = np.random.default_rng(5)
    steps = np.arange(-32770, 32771, dtype=np.float32) / 32768
    near = [steps, np.nextafter(steps, np.float32(9)), np.nextafter(steps, np.float32(-9))]
    halves = (np.arange(-65540, 65541) / 65536).astype(np.float32)
    tiny = np.array([0.0, -0.0, *(s * 2.0**-k for k in range(14, 150) for s in (1, -1, 1.5, -1.5))], dtype=np.float32)
    spread = rng.uniform(-1.5, 1.5, 100_000).astype(np.float32)
    small = (rng.standard_normal(100_000) * 1e-4).astype(np.float32)
    huge = np.array([1e3, -1e3, 3e38, -3e38], dtype=np.float32)
    samples = np.concatenate([*near, halves, tiny, spread, small, huge])
    quantised = pcm16(samples)
    assert quantised.dtype == np.float32
    buffer = io.BytesIO()
    soundfile.write(buffer, samples, 48000, format="WAV", subtype="PCM_16")
    buffer.seek(0)
    assert np.array_equal(quantised, soundfile.read(buffer, dtype="float32")[0])


@pytest.mark.parametrize("to_rate", [15360, 22050, 48000])
@pytest.mark.parametrize("from_rate", [8000, 44100, 48000, 96000])
def test_resampled_length(from_rate, to_rate):
    for n in (1, 2, 3, 511, 512, 1001, 4409, 4410, 7999, 12345):
        assert len(resample(np.zeros(n, np.float32), from_rate, to_rate)) == resampled_length(n, from_rate, to_rate)


def test_resample_is_librosa_load(tmp_path, stereo_noise, librosa_load):
    soundfile.write(tmp_path / "a.wav", stereo_noise, 44100)
    signal = load_audio(tmp_path / "a.wav")
    for rate in (15360, 22050, 44100):
        expected = librosa_load(tmp_path / "a.wav", sr=rate)
        assert np.array_equal(resample(signal.samples, 44100, rate), expected)


@pytest.mark.parametrize("channels", [1, 2, 3, 6, 11])
def test_channels_are_averaged_as_numpy_and_librosa_do(tmp_path, channels, librosa_load):
    samples = np.random.default_rng(channels).uniform(-1, 1, (20_000, channels)).astype(np.float32)
    soundfile.write(tmp_path / "a.wav", samples, 8000, subtype="FLOAT")
    found = load_audio(tmp_path / "a.wav").samples
    np.testing.assert_array_equal(found, np.mean(samples.T, axis=0))
    np.testing.assert_array_equal(found, librosa_load(tmp_path / "a.wav"))


@pytest.mark.parametrize(
    ("second", "kept"), [("opposite", False), ("nearly", False), ("equal", True), ("other", True)]
)
def test_channels_that_cancel_are_rejected(tmp_path: Path, second: str, kept: bool) -> None:
    """Stereo in antiphase averages to silence, which would be extracted without a word."""
    rng = np.random.default_rng(0)
    left, other = rng.normal(0, 0.1, (2, 22_050)).astype(np.float32)
    right = {"opposite": -left, "nearly": 0.05 * other - left, "equal": left, "other": other}[second]
    soundfile.write(tmp_path / "a.wav", np.stack([left, right], axis=1), 22_050, "FLOAT")
    # The mix against that of unrelated channels of the same energy, by hand.
    mean = (left.astype(np.float64) + right) / 2
    level = 10 * np.log10(max(1e-30, (mean**2).sum() * 4 / (left.astype(np.float64) ** 2 + right**2).sum()))
    assert (level >= -20) == kept
    if kept:
        np.testing.assert_allclose(load_audio(tmp_path / "a.wav").samples, mean, atol=1e-7)
        return
    with raises_message(DataError, "antiphase", where="a.wav", reason="antiphase"):
        load_audio(tmp_path / "a.wav")


def test_silence_in_two_channels_and_one_channel_of_two_are_music(tmp_path: Path) -> None:
    """A silent file stays silent, and music on one channel alone keeps half its level."""
    tone = np.sin(np.arange(9000) / 9).astype(np.float32)
    for name, stereo in (("silent", np.zeros((9000, 2))), ("left", np.stack([tone, 0 * tone], axis=1))):
        soundfile.write(tmp_path / f"{name}.wav", stereo, 22_050, "FLOAT")
        np.testing.assert_allclose(load_audio(tmp_path / f"{name}.wav").samples, stereo.mean(axis=1), atol=1e-7)
