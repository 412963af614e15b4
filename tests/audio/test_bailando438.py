"""bailando438 against Bailando's own preparation script, and against plain calls of librosa.

Gates are those of the reference outputs' README. Measured with librosa 0.11: MFCC 1.9e-4 at values to 500, their
derivative 1.0e-4, chroma 3.0e-7, onset envelope 9.6e-6, tempogram 9.8e-8; beats are equal.
"""

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import librosa
import numpy as np
import pytest
from numpy.typing import NDArray

from dancedata.audio import _bailando
from dancedata.audio.bailando54 import Bailando54
from dancedata.audio.bailando55 import Bailando55
from dancedata.audio.bailando438 import Bailando438
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.audio.stft193 import Stft193
from dancedata.core.audio_signal import AudioSignal, pcm16
from dancedata.core.errors import DataError, RecipeError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.music.samples import resample
from dancedata.music.signal import load_audio
from dancedata.recipes.parse import parse_recipe
from tests.conftest import DATA, HAS_SHARED, Arrays, unpack
from tests.features import assert_within
from tests.messages import raises_message

GATES = {"mfcc": 1e-3, "mfcc_delta": 1e-3, "chroma_cqt": 1e-6, "onset_envelope": 1e-4, "beat": 0.0, "tempogram": 1e-4}
FEATURE = Bailando438()
RHYTHM = slice(FEATURE.columns.slice("onset_envelope").start, 438)


def _assert_all_within_gates(arrays: Arrays, feature: Bailando438) -> None:
    names = [name for name in arrays if not name.endswith(".audio")]
    assert names
    for name in names:
        fps = "60" if name.endswith(".60fps") else "7.5"
        grid = FrameGrid.of(fps)
        signal = AudioSignal(arrays[f"{name}.audio"], int(512 * grid.rate))
        assert_within(GATES, FEATURE.columns, *arrays.pair(name, feature.extract(signal, grid)))


@pytest.mark.skipif(HAS_SHARED, reason="a part of the whole set, which is next")
def test_a_song_at_7_5_rows_per_second(tmp_path: Path) -> None:
    folder = unpack(DATA / "bailando438", tmp_path)
    _assert_all_within_gates(Arrays(folder / "modern_librosa0110_soxr.npz"), Bailando438(onset_fmax="nyquist"))


def test_songs_at_both_rates(shared: Path) -> None:
    path = shared / "golden" / "bailando438" / "modern_librosa0110_soxr.npz"
    _assert_all_within_gates(Arrays(path), Bailando438(onset_fmax="nyquist"))


def test_the_era_has_no_rhythm_at_7_5(shared: Path) -> None:
    arrays = Arrays(shared / "golden" / "bailando438" / "era_librosa081_essentia.npz")
    names = [name for name in arrays if name.endswith("7.5fps")]
    assert len(names) == 3
    for name in names:
        rows = FEATURE.extract(AudioSignal(arrays[f"{name}.audio"], 3840), FrameGrid.of("7.5"))
        assert not arrays[name][:, RHYTHM].any()
        assert not rows[:, RHYTHM].any()
        assert rows[:, : RHYTHM.start].any(axis=0).all()


def _plain_librosa(y: NDArray[np.float32], sr: int, onset: dict[str, Any]) -> NDArray[np.floating[Any]]:
    """The specification's steps, one plain call each."""
    mel = librosa.feature.melspectrogram(y=y, sr=sr, hop_length=512)
    mfcc = librosa.feature.mfcc(S=librosa.power_to_db(mel, ref=np.max), n_mfcc=20)
    harmonic, percussive = librosa.effects.hpss(y)
    chroma = librosa.feature.chroma_cqt(y=harmonic, sr=sr, hop_length=512, n_octaves=7 if sr == 30720 else 5)
    envelope = librosa.onset.onset_strength(y=percussive, sr=sr, hop_length=512, aggregate=np.median, **onset)
    beats = np.zeros(len(envelope))
    beats[librosa.beat.beat_track(onset_envelope=envelope, sr=sr, hop_length=512)[1]] = 1
    tempogram = librosa.feature.tempogram(onset_envelope=envelope, sr=sr, hop_length=512)
    delta = librosa.feature.delta(mfcc, width=3)
    return np.concatenate([mfcc, delta, chroma, [envelope], [beats], tempogram]).T


@pytest.mark.parametrize(
    ("onset_fmax", "fps", "onset"),
    [("era", "60", {"fmax": 11025}), ("nyquist", "60", {}), ("nyquist", "30", {}), ("nyquist", "7.5", {})],
)
def test_it_is_plain_librosa(clicks: AudioSignal, onset_fmax: Any, fps: str, onset: dict[str, Any]) -> None:
    _bailando.compile_kernels()
    signal, grid = clicks.part(0, 3 * clicks.sample_rate), FrameGrid.of(fps)
    rate = int(512 * grid.rate)
    rows = Bailando438(onset_fmax=onset_fmax).extract(signal, grid)
    expected = _plain_librosa(resample(signal.samples, signal.sample_rate, rate), rate, onset)
    np.testing.assert_array_equal(rows, expected.astype(np.float32))
    assert len(rows) == FEATURE.n_rows(signal.n_samples, signal.sample_rate, grid) == 1 + int(3 * grid.rate)


def test_columns_and_their_meaning(clicks: AudioSignal) -> None:
    columns = FEATURE.columns
    assert [columns.slice(group.name).start for group in columns.groups] == [0, 20, 40, 52, 53, 54]
    assert columns.width == 438
    clicks = clicks.part(0, 4 * clicks.sample_rate)
    rows = FEATURE.extract(clicks, FrameGrid.of(60), start_bpm=77.0)
    expected_s = np.arange(0.25, 4, 0.5)
    beats_s = np.flatnonzero(rows[:, 53]) / 60
    assert len(beats_s) >= 5
    assert np.abs(beats_s[:, None] - expected_s).min(axis=1).max() <= 3.01 / 60
    chroma = rows[60:-60, columns.slice("chroma_cqt")].mean(axis=0)
    assert set(np.argsort(chroma)[-3:]) == {0, 4, 7}  # C, E, G
    assert rows[120, 54] == 1  # lag 0 of the tempogram
    assert np.array_equal(rows, FEATURE.extract(clicks, FrameGrid.of(60)))  # for any tempo


def test_windows_are_pieces_by_themselves(clicks: AudioSignal) -> None:
    grid, starts = FrameGrid.of(30), np.array([0, 48000])
    windows = FEATURE.extract_windows(clicks, starts, 96000, grid, 60)
    for window, start in zip(windows, starts, strict=True):
        piece = AudioSignal(pcm16(clicks.samples[start : start + 96000]), 48000)
        assert np.array_equal(window, FEATURE.extract(piece, grid)[:60])


def test_short_and_silent_audio_gives_no_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for n_samples in (1024, 9000):
            for fps in ("7.5", "60") if n_samples > 1024 else ("60",):
                silence = AudioSignal(np.zeros(n_samples, dtype=np.float32), int(512 * float(fps)))
                assert not FEATURE.extract(silence, FrameGrid.of(fps)).any()


@pytest.mark.parametrize(("fps", "n_samples"), [("60", 1023), ("7.5", 1023), ("60", 1)])
def test_audio_of_fewer_than_three_rows_is_refused(fps: str, n_samples: int) -> None:
    signal = AudioSignal(np.ones(n_samples, dtype=np.float32), int(512 * float(fps)))
    with raises_message(DataError, "derivative", reason="short_audio") as caught:
        FEATURE.extract(signal, FrameGrid.of(fps))
    assert "at least 3 rows" in str(caught.value)


def test_a_window_of_5_s_is_not_a_whole_number_of_rows_at_7_5() -> None:
    document = {
        "recipe": 1, "name": "gpt", "dataset": {"synthetic": {}}, "fps": 60, "motion": {"bailando72": {}},
        "windows": {"length_s": 5, "stride_s": 0.5}, "audio": {"bailando438": {"fps": 7.5}},
    }  # fmt: skip
    with raises_message(RecipeError, "multiples", where="recipe"):
        parse_recipe(document)


# ---- columns of TCDiff, Duolando, POPDG, InfiniteDance and GCDance


#: Of the reference outputs' README: beats and peaks are equal.
CROWD_GATES = {
    "mfcc": 1e-3, "mfcc_delta": 1e-3, "chroma_cqt": 1e-4, "chroma_cens": 1e-4, "onset_envelope": 1e-4,
    "onset_peak": 0.0, "beat": 0.0,
}  # fmt: skip


def assert_within_gates(feature: Any, rows: np.ndarray, expected: np.ndarray) -> None:
    names = {group.name for group in feature.columns.groups} - {"tempogram"}
    width = expected.shape[1]
    assert_within({name: CROWD_GATES[name] for name in names}, feature.columns, rows[:, :width], expected)


def slice_1(path: Path) -> AudioSignal:
    """Return the second slice: 5 s from second 0.5 on."""
    signal = load_audio(path)
    rate = signal.sample_rate
    return signal.part(rate // 2, rate // 2 + 5 * rate)


def test_tcdiffs_columns_of_a_slice(shared: Path) -> None:
    crowd = shared / "golden" / "crowd"
    golden = np.load(crowd / "tcdiff" / "music438.npz")
    feature = Bailando438(onset_fmax="nyquist")
    song = slice_1(crowd / "inputs" / "aioz_gdance" / "musics" / "-Ab_cdEf123_02_187_367.wav")
    rows = feature.extract(song, FrameGrid.of(60))
    assert rows.shape == (301, 438)
    assert_within_gates(feature, rows, golden["cols_0_53"])
    np.testing.assert_allclose(rows[:, golden["tempogram_cols"]], golden["tempogram"], rtol=0, atol=1e-3)


def dd100(shared: Path, name: str) -> AudioSignal:
    return load_audio(shared / "golden" / "crowd" / "inputs" / "dd100" / "music" / "mp3" / "all" / f"{name}.wav")


@pytest.mark.parametrize("name", ["Waltz_5_0", "Waltz_6_0"])
def test_duolandos_columns(shared: Path, name: str) -> None:
    expected = np.load(shared / "golden" / "crowd" / "duolando" / "dd100.npz")[f"{name}.music54"]
    song = dd100(shared, name)
    rows = Bailando54().extract(song, FrameGrid.of(30))
    assert rows.shape == expected.shape == (song.n_samples // 512 + 1, 54)
    assert_within_gates(Bailando54(), rows, expected)


def test_popdgs_columns_of_a_slice(shared: Path) -> None:
    crowd = shared / "golden" / "crowd"
    expected = np.load(crowd / "popdg" / "music35.npz")["slice1"]
    song = slice_1(crowd / "inputs" / "popdanceset" / "wavs" / "BV1aaaaaaaa1_Clip_1.wav")
    rows = Librosa35().extract(song, FrameGrid.of(30))[:150]
    assert_within_gates(Librosa35(), rows, expected)


@pytest.mark.parametrize(
    ("feature", "of", "fps", "width"),
    [(Bailando54(onset_fmax="era"), Bailando438(), 60, 54), (Bailando55(), Bailando438("nyquist"), 30, 55)],
)
def test_columns_are_the_first_of_bailando438(clicks, feature, of, fps, width):
    song = clicks.part(0, 3 * clicks.sample_rate)
    rows = feature.extract(song, FrameGrid.of(fps))
    np.testing.assert_array_equal(rows, of.extract(song, FrameGrid.of(fps))[:, :width])


@pytest.mark.parametrize(("split", "name"), [("train", "Qiaqiaqia_12_1"), ("test", "Ballet_9_0")])
def test_duolandos_first_row_of_other_songs(shared: Path, split: str, name: str) -> None:
    crowd = shared / "golden" / "crowd"
    expected = np.load(crowd / "duolando" / "dd100.npz")[f"window.{split}.music_row0"]
    facts = json.loads((crowd / "duolando" / "facts.json").read_text())
    rows = Bailando54().extract(dd100(shared, name), FrameGrid.of(30))
    assert len(rows) == facts["music_rows"][name]
    assert_within_gates(Bailando54(), rows[:1], expected[None])


#: Row 40 of the chroma, and the rows with beats, by extract_music55.py of InfiniteDance's repository (0f46a3f), with
#: librosa 0.11, of Waltz_6_0.wav.
CHROMA_40 = (
    0.127705, 0.012904, 0.010634, 0.03257, 1.0, 0.026884, 0.013477, 0.030722, 0.230026, 0.141886, 0.224769, 0.614826,
)  # fmt: skip
BEATS = [3, 21, 40, 58, 77]


def test_infinitedances_columns(shared: Path) -> None:
    """They are Duolando's but for the octaves of chroma, and the tempogram at lag 0."""
    duolandos = np.load(shared / "golden" / "crowd" / "duolando" / "dd100.npz")["Waltz_6_0.music54"]
    feature = Bailando55()
    rows = feature.extract(dd100(shared, "Waltz_6_0"), FrameGrid.of(30))
    assert rows.shape == (81, 55)
    for name in ("mfcc", "mfcc_delta", "onset_envelope", "beat"):
        part = feature.columns.slice(name)
        np.testing.assert_allclose(rows[:, part], duolandos[:, part], rtol=0, atol=CROWD_GATES[name], err_msg=name)
    np.testing.assert_allclose(rows[40, feature.columns.slice("chroma_cqt")], CHROMA_40, rtol=0, atol=1e-4)
    assert np.flatnonzero(rows[:, 53]).tolist() == BEATS, "column 53 is the beat"
    np.testing.assert_array_equal(rows[:, 54], 1)


#: Row 40, the first columns, of what preprocess/pre_music.py of GC_Dance (a8dde2c) writes for Waltz_6_0.wav: the real
#: part, which its loader keeps, and the absolute value; librosa 0.11.
REAL_40 = (0.351186, -0.313267, -0.158879, 4.336408, -8.204192, 5.841755)
MAGNITUDE_40 = (0.351186, 0.352196, 1.699371, 4.870341, 8.218758, 5.979174)


@pytest.mark.parametrize(("part", "expected"), [("real", REAL_40), ("magnitude", MAGNITUDE_40)])
def test_gcdances_columns(shared: Path, part: Any, expected: tuple[float, ...]) -> None:
    rows = Stft193(part).extract(dd100(shared, "Waltz_6_0"), FrameGrid.of(30))
    assert rows.shape == (81, 193)
    np.testing.assert_allclose(rows[40, :6], expected, rtol=0, atol=1e-4)


def test_a_tone_is_in_its_column() -> None:
    """Columns are 40 Hz apart at 30 rows per second; a window of 384 samples at each hop of 512, from the first."""
    rate, samples = 15_360, np.arange(15_360 * 2)
    tone = AudioSignal(np.sin(2 * np.pi * 1_000 / rate * samples).astype(np.float32), rate)
    rows = Stft193("magnitude").extract(tone, FrameGrid.of(30))
    assert rows.shape == (61, 193)
    assert set(rows[1:-1].argmax(axis=1)) == {25}
    np.testing.assert_allclose(rows[1:-1].max(axis=1), 384 / 4, rtol=1e-3)
    gap = np.zeros(rate * 2, np.float32)
    gap[512 * 7 + 200 : 512 * 7 + 300] = 1  # between the windows of two rows
    assert not Stft193().extract(AudioSignal(gap, rate), FrameGrid.of(30)).any()


@pytest.mark.parametrize(("call", "word"), [
    (lambda: Bailando55("sr"), "onset_fmax"), (lambda: Stft193("imaginary"), "magnitude"),
    (lambda: Bailando54().n_rows(1, 48_000, FrameGrid.of(17)), "bailando54"),  # seven octaves need more
    (lambda: Stft193().n_rows(48_000, 48_000, FrameGrid.of("30000/1001")), "GCDance"),
])  # fmt: skip
def test_settings_and_rates_that_cannot_be(call: Callable[[], object], word: str) -> None:
    with raises_message(UsageError, word):
        call()
