"""Music that does not begin with its clip: rows lie on the clip's frames, to the nearest sample."""

import io
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import ClipRef, Scan
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS, FEATURES
from dancedata.core.skeleton import SMPL24
from dancedata.exports._slices import cut_sounds, slices_of
from dancedata.exports.base.job import ExportJob
from dancedata.readers import WindowDataset
from dancedata.store import Store, open_store, verify_store
from dancedata.synthetic import synthesise_song
from tests.messages import raises_message

RATE, SECONDS = 24_000, 8


@dataclass(frozen=True)
class Late(Dataset):
    """One clip of 8 s, whose frame 0 is some second of its song."""

    name: ClassVar[str] = "late"
    version: ClassVar[int] = 1
    licence: ClassVar[str] = "none"
    citation: ClassVar[str] = "none"

    start: str = "0"

    def scan(self, source: Path) -> Scan:
        return Scan(
            "late",
            (ClipRef("a", source / "a.npz", source / "a.wav", "train", music="m", audio_start=Fraction(self.start)),),
        )

    def load(self, ref: ClipRef) -> Motion:
        rng = np.random.default_rng(0)
        n = SECONDS * 30
        poses = np.cumsum(rng.normal(scale=0.01, size=(n, 24, 3)), axis=0)
        return Motion(np.tile([0.0, 0.9, 0.0], (n, 1)), poses, FrameGrid.of(30), SMPL24)

    def make_example(self, folder: Path) -> None:
        folder.mkdir()


@pytest.fixture
def song(tmp_path: Path) -> np.ndarray:
    pcm = synthesise_song("mBR0", length_s=SECONDS, sample_rate=RATE, n_channels=1).pcm
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "a.npz").write_bytes(b"x")
    soundfile.write(tmp_path / "source" / "a.wav", pcm, RATE, subtype="PCM_16")
    return np.asarray(soundfile.read(tmp_path / "source" / "a.wav", dtype="float32")[0])


def build(tmp_path: Path, cache: Path, monkeypatch: Any, start: str, **keys: Any) -> Store:
    DATASETS.names()
    monkeypatch.setitem(DATASETS._classes, "late", Late)
    document = {
        "recipe": 1, "name": "late", "dataset": {"late": {"start": start}}, "fps": 30,
        "windows": {"length_s": 2, "stride_s": "1/2"}, "motion": {"joints": {}}, "audio": {"librosa35": {}},
    } | keys  # fmt: skip
    out = tmp_path / "out"
    return dancedata.build(document, tmp_path / "source", out, jobs=1, cache=cache, progress=False).open()


def rows_of(samples: np.ndarray) -> np.ndarray:
    feature: Any = FEATURES.make("librosa35", {})
    return np.asarray(feature.extract(AudioSignal(samples, RATE), FrameGrid.of(30)))


@pytest.mark.parametrize(("start", "skipped", "row"), [("1/2", 0, 15), ("3/5", 0, 18), ("51/100", 240, 15)])
def test_the_song_begins_before_the_clip(
    tmp_path: Path, cache: Path, monkeypatch: Any, song: np.ndarray, start: str, skipped: int, row: int
) -> None:
    store = build(tmp_path, cache, monkeypatch, start)
    assert verify_store(tmp_path / "out") == []
    expected = rows_of(song[skipped:])
    np.testing.assert_array_equal(store.clip("a").read("librosa35"), expected[row:][: SECONDS * 30])
    assert store.clip("a").audio_start == Fraction(start)
    assert store.music_offset("a") == Fraction(start)
    windows = store.windows("train")
    assert [w.start for w in windows] == list(range(0, SECONDS * 30 - 60 - row + 1, 15))
    assert {row["reason"] for row in store.rejects} == {"no_audio"}


@pytest.mark.parametrize(("start", "skipped", "offset"), [("-1/2", 0, -15), ("-0.51", 560, -16)])
def test_the_song_begins_after_the_clip(
    tmp_path: Path, cache: Path, monkeypatch: Any, song: np.ndarray, start: str, skipped: int, offset: int
) -> None:
    store = build(tmp_path, cache, monkeypatch, start)
    assert verify_store(tmp_path / "out") == []
    expected = rows_of(song[skipped:])
    first = -offset if offset % 15 == 0 else 30
    windows = store.windows("train")
    assert windows[0].start == first
    for window in windows:
        begin = window.start + offset
        np.testing.assert_array_equal(store.read(window, "librosa35"), expected[begin : begin + 60])
    assert WindowDataset(store, fields=("librosa35",), normalize=False)[0]["librosa35"].shape == (60, 35)
    cut = store.windows("train", length_frames=30, stride_frames=10)
    assert cut[0].start == -offset
    assert store.starts("a", 60).start == -offset
    row, rows = store.rows_within("a", "librosa35")
    np.testing.assert_array_equal(rows, expected[: len(rows)])
    assert (row, len(rows)) == (-offset, SECONDS * 30 + offset)
    with raises_message(UsageError):
        store.clip("a").read("librosa35")
    with raises_message(UsageError):
        store.read(type(windows[0])("a", 0, 60), "librosa35")


def test_copies_at_another_speed_keep_their_place(
    tmp_path: Path, cache: Path, monkeypatch: Any, song: np.ndarray
) -> None:
    store = build(tmp_path, cache, monkeypatch, "1/2", augment={"tempo": {"speeds": [1.25]}})
    assert verify_store(tmp_path / "out") == []
    assert store.clip("a__tempo").audio_start == Fraction(2, 5)
    assert store.music_offset("a__tempo") == Fraction(2, 5)


def test_windows_by_themselves_are_refused(tmp_path: Path, cache: Path, monkeypatch: Any, song: np.ndarray) -> None:
    with raises_message(UsageError):
        build(tmp_path, cache, monkeypatch, "1/2", scope="window")


def test_slices_of_sound_begin_with_their_frames(
    tmp_path: Path, cache: Path, monkeypatch: Any, song: np.ndarray
) -> None:
    keys = {"motion": {"edge151": {}}, "windows": {"length_s": 5, "stride_s": "1/2"}}
    build(tmp_path, cache, monkeypatch, "1/4", **keys)
    with open_store(tmp_path / "out") as store:
        job = ExportJob(store, tmp_path / "x", tmp_path / "source")
        found = slices_of(job, "train", "librosa35")
        for item, sound in cut_sounds(job, found):
            first = RATE // 4 + item.window.start * RATE // 30
            cut = soundfile.read(io.BytesIO(sound), dtype="float32")[0]
            np.testing.assert_allclose(cut, song[first : first + 5 * RATE], atol=2**-14)
