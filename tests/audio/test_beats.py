"""The feature `beats`: rows of known beats, librosa's and the network's on music with known beats."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.messages import raises_message

pytest.importorskip("safetensors.torch")

import torch
from safetensors.torch import load_file, save_file

from dancedata.audio.beats import Beats
from dancedata.audio.beats.by_network import beats_of, log_mel, song_logits
from dancedata.audio.beats.track import BeatTrack, bar_positions
from dancedata.audio.beats.weights import load_network
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.files.regular_file import sha256_file
from dancedata.music.samples import resample
from dancedata.synthetic import synthesise_song
from dancedata.testing import conformance
from tests.conftest import DATA

WEIGHTS = Path(__file__).parent / "data" / "beat_this_tiny.safetensors"
SONGS = ("mBR0", "mHO3", "mLO2", "mKR5")
FPS = FrameGrid.of(30)
SECOND = AudioSignal(np.zeros(22050, np.float32), 22050)


@pytest.fixture(scope="module")
def songs():
    return {name: synthesise_song(name, length_s=14) for name in SONGS}


def network() -> Beats:
    return Beats(source="beat_this", weights=WEIGHTS)


def f_measure(found: np.ndarray, wanted: np.ndarray, within_s: float = 0.07) -> float:
    """The F-measure of beats, each of which may meet one other beat: MIREX's window of 70 ms."""
    hits, left = 0, list(found)
    for beat in wanted:
        near = [other for other in left if abs(other - beat) <= within_s]
        if near:
            hits += 1
            left.remove(min(near, key=lambda other: abs(other - beat)))
    return 2 * hits / (len(found) + len(wanted))


# Rows of known beats.


def track_of(seconds: list[float], downbeats: list[int], rate: int = 100) -> BeatTrack:
    frames = np.rint(np.array(seconds) * rate).astype(np.int64)
    flags = np.zeros(len(frames), dtype=np.bool_)
    flags[downbeats] = True
    return BeatTrack(frames, flags, FrameGrid.of(rate))


def test_rows_of_a_song_in_four():
    rows = track_of([0.5 + 0.5 * k for k in range(12)], [1, 5, 9]).rows(240, FPS)
    assert np.array_equal(np.flatnonzero(rows[:, 0]), np.arange(15, 195, 15))
    assert np.array_equal(np.flatnonzero(rows[:, 1]), [30, 90, 150])
    assert np.allclose(rows[:, 3], 120)
    # Beyond the beats as well; 0 at the downbeats themselves.
    assert np.allclose(rows[:, 2], ((np.arange(240) - 30) / 60) % 1, atol=1e-5)
    assert rows[30, 2] == rows[90, 2] == 0


@pytest.mark.parametrize(
    ("n", "downbeats", "expected"),
    [
        (12, [2, 5, 9], [-2 / 3, -1 / 3, 0, 1 / 3, 2 / 3, 1, 1.25, 1.5, 1.75, 2, 2.25, 2.5]),
        (6, [1], np.arange(-1, 5) / 4),  # one downbeat begins a bar of four
    ],
)
def test_positions_in_bars(n, downbeats, expected):
    flags = np.zeros(n, dtype=np.bool_)
    flags[downbeats] = True
    assert np.allclose(bar_positions(flags), expected)


@pytest.mark.parametrize(
    ("seconds", "downbeats", "tempo"), [([0.5, 1.0, 1.5], [], 120), ([], [], 0), ([0.5], [0], 0)]
)
def test_unknown_phase_and_tempo(seconds, downbeats, tempo):
    """Without two downbeats there is no phase, without two beats no tempo."""
    rows = track_of(seconds, downbeats).rows(60, FPS)
    assert rows[:, :2].sum() == len(seconds) + len(downbeats)
    assert (rows[:, 2] == -1).all()
    assert np.allclose(rows[:, 3], tempo)


def test_a_missed_beat_does_not_halve_the_tempo():
    seconds = [0.5 * k for k in range(20) if k != 8]
    assert np.allclose(track_of(seconds, []).rows(300, FPS)[:, 3], 120)


def test_the_tempo_follows_the_song():
    seconds = np.concatenate([np.arange(0, 10, 0.5), np.arange(10, 20, 0.4)]).tolist()
    tempo = track_of(seconds, []).rows(600, FPS)[:, 3]
    assert np.allclose(tempo[:200], 120)
    assert np.allclose(tempo[400:], 150)


def test_a_beat_after_the_last_row_is_in_the_last_row():
    rows = track_of([0.0, 0.5, 0.99], [0]).rows(30, FPS)
    assert np.array_equal(np.flatnonzero(rows[:, 0]), [0, 15, 29])


@settings(max_examples=40)
@given(
    frames=st.lists(st.integers(0, 4000), min_size=2, max_size=60, unique=True).map(sorted),
    flags=st.lists(st.booleans(), min_size=60, max_size=60),
    rate=st.sampled_from(["1/7", "30000/1001", "24", "30", "60"]),
)
def test_rows_of_any_beats_are_within_their_ranges(frames, flags, rate):
    grid = FrameGrid.of(rate)
    track = BeatTrack(np.array(frames), np.array(flags[: len(frames)]), FrameGrid.of(100))
    n_rows = FrameGrid.of(100).resampled_length(4001, grid)
    rows = track.rows(n_rows, grid)
    assert np.isfinite(rows).all()
    assert ((rows[:, 0] >= rows[:, 1]) & (rows[:, 3] > 0)).all()
    assert ((rows[:, 2] == -1) | ((rows[:, 2] >= 0) & (rows[:, 2] < 1))).all()
    # A beat is at most half a row from its row; after the last row it may be a whole one.
    at = np.flatnonzero(rows[:, 0]) / float(grid.rate)
    off = np.abs(at[:, None] - np.array(frames) / 100).min(axis=1)
    assert (off[:-1] <= 0.5 / float(grid.rate) + 1e-9).all()
    assert off[-1] < 1 / float(grid.rate)


# Music with known beats.


@pytest.mark.parametrize("name", SONGS)
def test_librosa_finds_the_beats_within_a_frame(songs, name):
    song = songs[name]
    rows = Beats().extract(song.signal, FPS, start_bpm=song.tempo_bpm)
    found = np.flatnonzero(rows[:, 0])
    inner = song.beat_times_s[2:-2]
    off = np.abs(found[:, None] - np.rint(inner * 30)).min(axis=0)
    assert off.max() <= 1
    assert not rows[:, 1].any()
    assert (rows[:, 2] == -1).all()
    seconds = Beats().track(song.signal, start_bpm=song.tempo_bpm).frames / 50
    assert np.abs(seconds[:, None] - inner).min(axis=0).max() < 0.016
    assert f_measure(seconds, song.beat_times_s) > 0.96
    assert np.median(rows[:, 3]) == pytest.approx(song.tempo_bpm, rel=0.01)


@pytest.mark.parametrize("name", SONGS)
def test_the_network_finds_beats_and_downbeats_within_a_frame(songs, name):
    song = songs[name]
    rows = network().extract(song.signal, FPS)
    for column, times in ((0, song.beat_times_s), (1, song.downbeat_times_s)):
        found = np.flatnonzero(rows[:, column])
        inner = times[(times > 0.5) & (times < 13)]
        assert np.abs(found[:, None] - np.rint(inner * 30)).min(axis=0).max() <= 1
        assert f_measure(found / 30, times) > 0.96
    instants = np.arange(30, 390) / 30
    bars = np.interp(instants, song.downbeat_times_s, np.arange(len(song.downbeat_times_s)))
    off = (rows[30:390, 2] - bars + 0.5) % 1 - 0.5
    assert np.abs(off[instants < song.downbeat_times_s[-1]]).max() < 0.05
    assert np.median(rows[:, 3]) == pytest.approx(song.tempo_bpm, rel=0.01)


def test_windows_are_computed_from_their_own_samples(songs):
    signal = songs["mLO2"].signal
    starts, length = np.array([0, 100_000]), 5 * signal.sample_rate
    for feature in (Beats(), network()):
        windows = feature.extract_windows(signal, starts, length, FPS, 150, start_bpm=100.0)
        alone = feature.extract(signal.part(100_000, 100_000 + length), FPS, start_bpm=100.0)
        assert np.array_equal(windows[1], alone[:150])
        assert windows.shape == (2, 150, 4)


def test_conformance_of_the_network(monkeypatch):
    monkeypatch.setattr(Beats, "make_example", classmethod(lambda cls, folder: network()))
    conformance.check_audio_feature(Beats)


def test_23_ms_of_music_are_too_short_for_the_network():
    signal = AudioSignal(np.zeros(500, np.float32), 22050)
    with raises_message(DataError, "spectrum", reason="short_audio"):
        network().extract(signal, FPS)
    assert Beats().extract(signal, FPS).shape == (1, 4)


# Weights.


def test_the_hash_of_the_weights_is_resolved_and_compared(tmp_path):
    made = network().resolved(sha256_file)
    assert made.weights_sha256 == sha256_file(WEIGHTS)
    other = tmp_path / "other.safetensors"
    other.write_bytes(WEIGHTS.read_bytes()[:-1] + b"\1")
    with raises_message(UsageError, "omit", where="other.safetensors"):
        Beats(source="beat_this", weights=other, weights_sha256=made.weights_sha256).resolved(sha256_file)
    with raises_message(SourceError, "weights", where="none.ckpt"):
        Beats(source="beat_this", weights=tmp_path / "none.ckpt").resolved(sha256_file)


def test_the_weights_are_named_by_the_environment(monkeypatch):
    monkeypatch.delenv("DANCEDATA_BEAT_THIS", raising=False)
    with raises_message(UsageError, "DANCEDATA_BEAT_THIS"):
        Beats(source="beat_this").resolved(sha256_file)
    monkeypatch.setenv("DANCEDATA_BEAT_THIS", str(WEIGHTS))
    assert Beats(source="beat_this").resolved(sha256_file).weights == WEIGHTS


@pytest.mark.parametrize("given", [{"source": "madmom"}, {"weights": WEIGHTS}, {"weights_sha256": "0" * 64}])
def test_impossible_settings_are_errors(given):
    with raises_message(UsageError, "beat_this"):
        Beats(**given)


@pytest.mark.parametrize("bpm", [0.0, -1.0, float("nan"), float("inf")])
def test_a_tempo_that_cannot_be_is_an_error(bpm):
    with raises_message(UsageError, "start_bpm"):
        Beats().extract(SECOND, FPS, start_bpm=bpm)


class Evil:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def checkpoint(path: Path, **entries: object) -> Path:
    state = {f"model._orig_mod.{name}": value.float() for name, value in load_file(WEIGHTS).items()}
    hyper_parameters = {"transformer_dim": 32, "sum_head": True, "lr": 8e-4, "dropout": {"frontend": 0.1}}
    torch.save({"state_dict": state, "hyper_parameters": hyper_parameters, "epoch": 99, **entries}, path)
    return path


def test_a_checkpoint_in_the_published_layout(tmp_path, songs):
    made = Beats(source="beat_this", weights=checkpoint(tmp_path / "final0.ckpt"))
    signal = songs["mLO2"].signal
    assert np.array_equal(made.extract(signal, FPS), network().extract(signal, FPS))
    apart = Beats(
        source="beat_this", weights=checkpoint(tmp_path / "apart.ckpt", hyper_parameters={"sum_head": False})
    )
    assert not np.array_equal(apart.extract(signal, FPS), made.extract(signal, FPS))


def refused(path: Path) -> str:
    with raises_message(SourceError, "weights") as caught:
        Beats(source="beat_this", weights=path).extract(SECOND, FPS)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_a_pickle_is_not_executed(tmp_path):
    planted = tmp_path / "planted"
    path = checkpoint(tmp_path / "evil.ckpt", callbacks=Evil(planted))
    assert "cannot be read" in refused(path)
    plain = tmp_path / "plain.ckpt"
    plain.write_bytes(pickle.dumps(Evil(planted), protocol=2))
    assert "cannot be read" in refused(plain)
    assert not planted.exists()


def test_damaged_files_are_errors(tmp_path):
    whole = checkpoint(tmp_path / "whole.ckpt").read_bytes()
    cut, cut_safe = whole[: len(whole) // 2], WEIGHTS.read_bytes()[:9000]
    for name, data in (("cut.ckpt", cut), ("empty.ckpt", b""), ("cut.safetensors", cut_safe)):
        (tmp_path / name).write_bytes(data)
        assert "cannot be read; found" in refused(tmp_path / name)
    assert "does not exist" in refused(tmp_path / "none.ckpt")
    assert "cannot be read" in refused(tmp_path)


def test_other_networks_are_errors(tmp_path):
    state = load_file(WEIGHTS)
    torch.save([1, 2], tmp_path / "list.ckpt")
    assert "no state_dict" in refused(tmp_path / "list.ckpt")
    gate, bias = "frontend.blocks.0.partial.attnF.to_gates.weight", "frontend.linear.bias"
    cases = {
        f'Missing key(s) in state_dict: "{bias}"': {k: v for k, v in state.items() if k != bias},
        "no tensor": {k: v for k, v in state.items() if k != "frontend.linear.weight"},
        'Unexpected key(s) in state_dict: "extra"': {**state, "extra": torch.zeros(1)},
        f"size mismatch for {gate}": {**state, gate: torch.zeros(2, 8)},
        "not finite in task_heads": {**state, "task_heads.beat_downbeat_lin.bias": torch.tensor([0.0, torch.nan])},
        "bands=8": {**state, "frontend.stem.bn1d.weight": torch.zeros(8)},
    }
    for number, (text, tensors) in enumerate(cases.items()):
        path = tmp_path / f"{number}.safetensors"
        save_file(tensors, path)
        assert text in refused(path)


# The package beat_this; tests/golden/against_beat_this.py made these outputs with it, and compares all of them.


@pytest.fixture(scope="module")
def reference():
    with np.load(DATA / "beat_this" / "reference.npz") as file:
        return dict(file)


def test_the_outputs_of_the_package(reference):
    song = synthesise_song("mLO3", length_s=34.0).signal
    spectrum = log_mel(torch.from_numpy(resample(song.samples, song.sample_rate, 22050).copy()))
    assert np.abs(spectrum[100:200].numpy() - reference["log_mel"]).max() < 1e-4
    with torch.inference_mode():
        logits = song_logits(load_network(WEIGHTS), spectrum).numpy()
    assert np.abs(logits - reference["logits"]).max() < 1e-4
    found = beats_of(logits)
    assert np.array_equal(found.frames, np.rint(reference["beats"] * 100))
    assert np.array_equal(found.frames[found.downbeats], np.rint(reference["downbeats"] * 100))


def test_neighbouring_peaks_are_one_beat_between_them():
    logits = np.full((100, 2), -5.0, dtype=np.float32)
    logits[[10, 11, 40, 60, 63], 0] = [2, 2, 3, 1, 4]
    logits[[38, 90], 1] = 1
    found = beats_of(logits)
    assert found.frames.tolist() == [21, 80, 126]
    assert found.downbeats.tolist() == [False, True, True]
    assert not len(beats_of(np.full((5, 2), -1.0, dtype=np.float32)).frames)
