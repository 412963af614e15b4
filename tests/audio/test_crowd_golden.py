"""Columns of music against what the code of TCDiff, Duolando, POPDG, InfiniteDance and GCDance computed."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.audio.bailando54 import Bailando54
from dancedata.audio.bailando55 import Bailando55
from dancedata.audio.bailando438 import Bailando438
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.audio.stft193 import Stft193
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.music.signal import load_audio
from tests.features import assert_within
from tests.messages import raises_message

#: Of the reference outputs' README: beats and peaks are equal.
GATES = {
    "mfcc": 1e-3, "mfcc_delta": 1e-3, "chroma_cqt": 1e-4, "chroma_cens": 1e-4, "onset_envelope": 1e-4,
    "onset_peak": 0.0, "beat": 0.0,
}  # fmt: skip


def assert_within_gates(feature: Any, rows: np.ndarray, expected: np.ndarray) -> None:
    names = {group.name for group in feature.columns.groups} - {"tempogram"}
    width = expected.shape[1]
    assert_within({name: GATES[name] for name in names}, feature.columns, rows[:, :width], expected)


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
        np.testing.assert_allclose(rows[:, part], duolandos[:, part], rtol=0, atol=GATES[name], err_msg=name)
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
