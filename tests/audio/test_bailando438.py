"""bailando438 against Bailando's own preparation script, and against plain calls of librosa.

Gates are those of the reference outputs' README. Measured with librosa 0.11: MFCC 1.9e-4 at values to 500, their
derivative 1.0e-4, chroma 3.0e-7, onset envelope 9.6e-6, tempogram 9.8e-8; beats are equal.
"""

import warnings
from pathlib import Path
from typing import Any

import librosa
import numpy as np
import pytest
from numpy.typing import NDArray

from dancedata.audio import _bailando
from dancedata.audio.bailando438 import Bailando438
from dancedata.core.audio_signal import AudioSignal, pcm16
from dancedata.core.errors import DataError, RecipeError
from dancedata.core.grid import FrameGrid
from dancedata.music.samples import resample
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
