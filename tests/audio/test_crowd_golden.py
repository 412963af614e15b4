"""Columns of music against what the code of TCDiff, Duolando and POPDG computed."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.audio.bailando54 import Bailando54
from dancedata.audio.bailando438 import Bailando438
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.audio.signal import load_audio
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from tests.messages import raises_message

#: Of the reference outputs' README: beats and peaks are equal.
GATES = {
    "mfcc": 1e-3, "mfcc_delta": 1e-3, "chroma_cqt": 1e-4, "chroma_cens": 1e-4, "onset_envelope": 1e-4,
    "onset_peak": 0.0, "beat": 0.0,
}  # fmt: skip


def assert_within_gates(feature: Any, rows: np.ndarray, expected: np.ndarray) -> None:
    columns = feature.columns
    for group in columns.groups:
        if group.name != "tempogram":
            part, gate = columns.slice(group.name), GATES[group.name]
            np.testing.assert_allclose(rows[:, part], expected[:, part], rtol=0, atol=gate, err_msg=group.name)


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


@pytest.mark.parametrize("name", ["Waltz_5_0", "Waltz_6_0"])
def test_duolandos_columns(shared: Path, name: str) -> None:
    crowd = shared / "golden" / "crowd"
    expected = np.load(crowd / "duolando" / "dd100.npz")[f"{name}.music54"]
    song = load_audio(crowd / "inputs" / "dd100" / "music" / "mp3" / "all" / f"{name}.wav")
    rows = Bailando54().extract(song, FrameGrid.of(30))
    assert rows.shape == expected.shape == (song.n_samples // 512 + 1, 54)
    assert_within_gates(Bailando54(), rows, expected)


def test_popdgs_columns_of_a_slice(shared: Path) -> None:
    crowd = shared / "golden" / "crowd"
    expected = np.load(crowd / "popdg" / "music35.npz")["slice1"]
    song = slice_1(crowd / "inputs" / "popdanceset" / "wavs" / "BV1aaaaaaaa1_Clip_1.wav")
    rows = Librosa35().extract(song, FrameGrid.of(30))[:150]
    assert_within_gates(Librosa35(), rows, expected)


def test_seven_octaves_need_a_rate() -> None:
    with raises_message(UsageError):
        Bailando54().n_rows(1, 48_000, FrameGrid.of(17))


def test_the_columns_are_the_first_of_bailando438(clicks: AudioSignal) -> None:
    song = clicks.part(0, 3 * clicks.sample_rate)
    rows = Bailando54(onset_fmax="era").extract(song, FrameGrid.of(60))
    np.testing.assert_array_equal(rows, Bailando438().extract(song, FrameGrid.of(60))[:, :54])


@pytest.mark.parametrize(("split", "name"), [("train", "Qiaqiaqia_12_1"), ("test", "Ballet_9_0")])
def test_duolandos_first_row_of_other_songs(shared: Path, split: str, name: str) -> None:
    crowd = shared / "golden" / "crowd"
    expected = np.load(crowd / "duolando" / "dd100.npz")[f"window.{split}.music_row0"]
    song = load_audio(crowd / "inputs" / "dd100" / "music" / "mp3" / "all" / f"{name}.wav")
    facts = json.loads((crowd / "duolando" / "facts.json").read_text())
    rows = Bailando54().extract(song, FrameGrid.of(30))
    assert len(rows) == facts["music_rows"][name]
    assert_within_gates(Bailando54(), rows[:1], expected[None])
