"""Decoding, lengths, quantising and resampling, on files that the tests write."""

import io
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile
from numpy.typing import NDArray

from dancedata.audio.signal import audio_length, load_audio, pcm16, resample, resampled_length
from dancedata.core.errors import DataError
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


def _reason(error: pytest.ExceptionInfo[DataError]) -> str:
    return error.value.reason


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


def test_51_channels_are_averaged_as_librosa_does(tmp_path, librosa_load):
    source = np.random.default_rng(1).uniform(-1, 1, (5000, 6)).astype(np.float32)
    soundfile.write(tmp_path / "surround.wav", source, 48000, subtype="FLOAT")
    signal = load_audio(tmp_path / "surround.wav")
    np.testing.assert_allclose(signal.samples, source.mean(axis=1), rtol=0, atol=1e-6)
    assert np.array_equal(signal.samples, librosa_load(tmp_path / "surround.wav"))


def test_float_beyond_full_scale_is_kept(tmp_path: Path) -> None:
    source = np.array([0.0, 1.5, -2.0], dtype=np.float32)
    soundfile.write(tmp_path / "loud.wav", source, 44100, subtype="FLOAT")
    assert np.array_equal(load_audio(tmp_path / "loud.wav").samples, source)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_number(tmp_path: Path, value: float) -> None:
    source = np.zeros((44100, 2), dtype=np.float32)
    source[11025, 1] = value
    soundfile.write(tmp_path / "bad.wav", source, 44100, subtype="FLOAT")
    with raises_message(DataError, "example", where="bad.wav", reason="nan") as error:
        load_audio(tmp_path / "bad.wav")
    assert _reason(error) == "nan"


@pytest.mark.parametrize("read", [load_audio, audio_length])
class TestBadFiles:
    @pytest.mark.parametrize("name", ["empty.wav", "empty.ogg"])
    def test_no_samples(self, tmp_path: Path, read: Callable[[Path], object], name: str) -> None:
        soundfile.write(tmp_path / name, np.zeros(0, dtype=np.float32), 44100)
        with raises_message(DataError, "samples", reason="empty_audio") as error:
            read(tmp_path / name)
        assert _reason(error) == "empty_audio"

    @pytest.mark.parametrize("name", ["zero.wav", "zero.mp3", "zero.ogg", "zero.flac"])
    def test_no_bytes(self, tmp_path: Path, read: Callable[[Path], object], name: str) -> None:
        (tmp_path / name).touch()
        with raises_message(DataError, "doubt", reason="broken_audio") as error:
            read(tmp_path / name)
        assert _reason(error) == "broken_audio"

    def test_no_audio(self, tmp_path: Path, read: Callable[[Path], object]) -> None:
        (tmp_path / "page.wav").write_text("<html>404</html>")
        with pytest.raises(DataError, match=r"page\.wav.*Format not recognised") as error:
            read(tmp_path / "page.wav")
        assert _reason(error) == "broken_audio"

    def test_headerless(self, tmp_path: Path, read: Callable[[Path], object]) -> None:
        (tmp_path / "a.raw").write_bytes(bytes(1000))
        with pytest.raises(DataError, match=r"a\.raw.*samplerate") as error:
            read(tmp_path / "a.raw")
        assert _reason(error) == "broken_audio"

    def test_header_cut_short(self, tmp_path: Path, read: Callable[[Path], object]) -> None:
        soundfile.write(tmp_path / "a.wav", np.zeros(100), 44100)
        (tmp_path / "cut.wav").write_bytes((tmp_path / "a.wav").read_bytes()[:30])
        with pytest.raises(DataError, match=r"cut\.wav") as error:
            read(tmp_path / "cut.wav")
        assert _reason(error) == "broken_audio"

    @pytest.mark.parametrize("rate", [1, 7, 3999, 400_001, 2_000_000_000])
    def test_rates_that_no_sound_has(self, tmp_path: Path, read: Callable[[Path], object], rate: int) -> None:
        """A low one makes hours of a small file, and gigabytes once it is resampled."""
        soundfile.write(tmp_path / "a.wav", np.zeros(100_000), rate)
        with raises_message(DataError, "decoded", where="a.wav", reason="broken_audio") as error:
            read(tmp_path / "a.wav")
        assert _reason(error) == "broken_audio"

    @pytest.mark.parametrize("rate", [4000, 400_000])
    def test_rates_at_the_bounds(self, tmp_path: Path, read: Callable[[Path], object], rate: int) -> None:
        soundfile.write(tmp_path / "a.wav", np.zeros(100), rate)
        read(tmp_path / "a.wav")

    def test_silence_that_is_long_once_resampled(self, tmp_path: Path, read: Callable[[Path], object]) -> None:
        """Half an hour at 4 kHz: 29 MB unchanged, 346 MB at 48 kHz, in a file of some kilobytes."""
        soundfile.write(tmp_path / "a.flac", np.zeros(4000 * 1800, np.int16), 4000)
        assert (tmp_path / "a.flac").stat().st_size < 200_000
        with raises_message(DataError, "doubt", where="a.flac", reason="broken_audio") as error:
            read(tmp_path / "a.flac")
        assert _reason(error) == "broken_audio"

    def test_music_that_is_too_long_once_resampled(self, tmp_path, read, monkeypatch):
        monkeypatch.setattr("dancedata.audio.signal.MAX_BYTES", 4 * 48_000)
        soundfile.write(tmp_path / "a.wav", np.zeros(8000), 8000)
        read(tmp_path / "a.wav")
        soundfile.write(tmp_path / "a.wav", np.zeros(8001), 8000)
        with raises_message(DataError, "doubt", where="a.wav", reason="broken_audio"):
            read(tmp_path / "a.wav")

    def test_a_pipe(self, tmp_path: Path, read: Callable[[Path], object]) -> None:
        os.mkfifo(tmp_path / "a.wav")
        with raises_message(DataError, "doubt", where="a.wav", reason="broken_audio") as error:
            read(tmp_path / "a.wav")
        assert _reason(error) == "broken_audio"

    @pytest.mark.parametrize("name", ["nowhere.wav", "."])
    def test_missing(self, tmp_path: Path, read: Callable[[Path], object], name: str) -> None:
        with raises_message(DataError, "exist", reason="missing_file") as error:
            read(tmp_path / name)
        assert _reason(error) == "missing_file"


def test_cut_flac_is_broken(tmp_path: Path, stereo_noise: NDArray[np.float32]) -> None:
    soundfile.write(tmp_path / "a.flac", stereo_noise, 44100)
    whole = (tmp_path / "a.flac").read_bytes()
    (tmp_path / "cut.flac").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DataError, match=r"cut\.flac.*flac decoder") as error:
        load_audio(tmp_path / "cut.flac")
    assert _reason(error) == "broken_audio"


@pytest.mark.parametrize("name", ["cut.wav", "cut.ogg", "cut.mp3"])
def test_cut_files_have_the_length_that_decodes(tmp_path: Path, name: str) -> None:
    source = np.random.default_rng(2).uniform(-0.5, 0.5, (88200, 2))
    soundfile.write(tmp_path / f"whole-{name}", source, 44100)
    whole = (tmp_path / f"whole-{name}").read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    n_samples = load_audio(tmp_path / name).n_samples
    assert 30000 < n_samples < 50000
    assert audio_length(tmp_path / name) == (n_samples, 44100)


def _without_length_header(mp3: bytes) -> bytes:
    """Drop the first frame, which holds the Xing or Info header."""
    assert b"Xing" in mp3[:200] or b"Info" in mp3[:200]
    return mp3[mp3.find(b"\xff\xfb", 4) :]


def test_mp3_whose_header_overestimates(tmp_path: Path) -> None:
    # Quiet first, so that the first frames are small... and the estimate from them too long.
    noise = np.random.default_rng(2).uniform(-0.5, 0.5, 88200).astype(np.float32)
    source = np.concatenate([0 * noise, noise, 0 * noise])
    buffer = io.BytesIO()
    soundfile.write(buffer, source, 44100, format="MP3", bitrate_mode="VARIABLE", compression_level=0.3)
    path = tmp_path / "estimated.mp3"
    path.write_bytes(_without_length_header(buffer.getvalue()))
    assert soundfile.info(path).frames > 1.5 * len(source)
    n_samples, rate = audio_length(path)
    assert (load_audio(path).n_samples, 44100) == (n_samples, rate)
    assert abs(n_samples - len(source)) < 3 * 1152  # encoder delay and padding, untrimmed without the header


def test_mp3_whose_header_underestimates_is_read_to_its_end(tmp_path: Path) -> None:
    # Loud first: the estimate is too short, and libsndfile would stop there without a word.
    noise = np.random.default_rng(2).uniform(-0.5, 0.5, 88200).astype(np.float32)
    buffer = io.BytesIO()
    soundfile.write(buffer, noise, 44100, format="MP3", bitrate_mode="VARIABLE", compression_level=0.3)
    path = tmp_path / "twice.mp3"
    path.write_bytes(buffer.getvalue() * 2)
    n_samples, _ = audio_length(path)
    assert load_audio(path).n_samples == n_samples
    assert abs(n_samples - 2 * len(noise)) < 4 * 1152


def test_a_damaged_mp3_has_the_length_that_decodes() -> None:
    # Found by fuzzing (seed 20262): the decoder skips damaged bytes, and a seek into the file then misses its place.
    path = Path(__file__).parent / "data" / "resync.mp3"
    signal = load_audio(path)
    assert audio_length(path) == (signal.n_samples, signal.sample_rate)


def _written_and_read(samples: NDArray[np.float32]) -> NDArray[np.float32]:
    buffer = io.BytesIO()
    soundfile.write(buffer, samples, 48000, format="WAV", subtype="PCM_16")
    buffer.seek(0)
    read: NDArray[np.float32] = soundfile.read(buffer, dtype="float32")[0]
    return read


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
    assert np.array_equal(quantised, _written_and_read(samples))


def test_pcm16_rounds_down() -> None:
    samples = np.array([0.9, -0.9, 2.0, -2.0], dtype=np.float32) / np.float32(32768)
    assert np.array_equal(pcm16(samples) * 32768, [0, -1, 2, -2])
    assert np.array_equal(pcm16(pcm16(samples)), pcm16(samples))


@pytest.mark.parametrize("to_rate", [15360, 22050, 30720, 48000])
@pytest.mark.parametrize("from_rate", [8000, 22050, 24000, 44100, 48000, 96000])
def test_resampled_length(from_rate: int, to_rate: int) -> None:
    for n_samples in [1, 2, 3, 10, 511, 512, 1001, 4409, 4410, 7999, 9600, 12345]:
        length = len(resample(np.zeros(n_samples, dtype=np.float32), from_rate, to_rate))
        assert length == resampled_length(n_samples, from_rate, to_rate)


def test_resample_is_librosa_load(tmp_path, stereo_noise, librosa_load):
    soundfile.write(tmp_path / "a.wav", stereo_noise, 44100)
    signal = load_audio(tmp_path / "a.wav")
    for rate in (15360, 22050, 44100):
        expected = librosa_load(tmp_path / "a.wav", sr=rate)
        assert np.array_equal(resample(signal.samples, 44100, rate), expected)


@pytest.mark.parametrize("channels", [1, 2, 3, 5, 7, 8, 11])
def test_channels_are_averaged_as_numpy_does(tmp_path: Path, channels: int) -> None:
    samples = np.random.default_rng(channels).uniform(-1, 1, (20_000, channels)).astype(np.float32)
    soundfile.write(tmp_path / "a.wav", samples, 8000, subtype="FLOAT")
    np.testing.assert_array_equal(load_audio(tmp_path / "a.wav").samples, np.mean(samples.T, axis=0))


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
    with raises_message(DataError, "antiphase", where="a.wav", reason="antiphase") as error:
        load_audio(tmp_path / "a.wav")
    assert _reason(error) == "antiphase"


def test_silence_in_two_channels_and_one_channel_of_two_are_music(tmp_path: Path) -> None:
    """A silent file stays silent, and music on one channel alone keeps half its level."""
    tone = np.sin(np.arange(9000) / 9).astype(np.float32)
    for name, stereo in (("silent", np.zeros((9000, 2))), ("left", np.stack([tone, 0 * tone], axis=1))):
        soundfile.write(tmp_path / f"{name}.wav", stereo, 22_050, "FLOAT")
        np.testing.assert_allclose(load_audio(tmp_path / f"{name}.wav").samples, stereo.mean(axis=1), atol=1e-7)
