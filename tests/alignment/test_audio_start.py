"""Music that does not begin with its clip: rows lie on the clip's frames, to the nearest sample."""

import shutil
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata import comparison, plot
from dancedata.building.leaks import alike_songs
from dancedata.building.left_out import reasons
from dancedata.building.plan import make_plan
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import FEATURES
from dancedata.evaluation.clips import ClipSet, store_clips
from dancedata.evaluation.music import Resources, music_plan, read_beats
from dancedata.evaluation.protocol import PROTOCOLS
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.pages import write_report
from dancedata.scene.inputs.songs import MusicSources
from dancedata.scene.pieces import ClipReader
from dancedata.scene.scenes import Scenes
from dancedata.store import Store, verify_store
from dancedata.store.songs import songs_of
from dancedata.synthetic import synthesise_song
from dancedata.torch import Scale, WindowDataset
from tests.messages import raises_message

RATE, SECONDS = 24_000, 8


def write_clip(folder: Path, name: str, music: str) -> None:
    rng, n = np.random.default_rng(0), SECONDS * 30
    poses = np.cumsum(rng.normal(scale=0.01, size=(n, 72)), axis=0)
    np.savez(folder / f"{name}.npz", poses=poses, trans=np.tile([0.0, 0.9, 0.0], (n, 1)))
    pcm = synthesise_song(music, length_s=SECONDS, sample_rate=RATE, n_channels=1).pcm
    soundfile.write(folder / f"{name}.wav", pcm, RATE, subtype="PCM_16")


@pytest.fixture
def song(tmp_path: Path) -> np.ndarray:
    (tmp_path / "source").mkdir()
    write_clip(tmp_path / "source", "a", "mBR0")
    return np.asarray(soundfile.read(tmp_path / "source" / "a.wav", dtype="float32")[0])


@pytest.fixture
def build(tmp_path: Path, cache: Path, song: np.ndarray) -> Any:
    """Return a function that builds clips whose frame 0 is some second of their songs."""

    def run(start: str, folder: Path = tmp_path, **keys: Any) -> Store:
        rows = [f"{name}.npz,{name}.wav,{split},{start},30,y,m" for name, split in (("a", "train"), ("b", "test"))]
        rows = [row for row in rows if (folder / "source" / row.partition(",")[0]).exists()]
        text = "\n".join(["motion,audio,split,audio_start_s,fps,up,unit", *rows])
        (folder / "source" / "manifest.csv").write_text(text)
        document = {
            "recipe": 1, "name": "late", "dataset": {"folder": {}}, "fps": 30,
            "windows": {"length_s": 2, "stride_s": "1/2"}, "motion": {"joints": {}}, "audio": {"librosa35": {}},
        } | keys  # fmt: skip
        places = (folder / "source", folder / "out")
        return dancedata.build(document, *places, jobs=1, cache=cache, progress=False).open()

    return run


def rows_of(samples: np.ndarray) -> np.ndarray:
    feature: Any = FEATURES.make("librosa35", {})
    return np.asarray(feature.extract(AudioSignal(samples, RATE), FrameGrid.of(30)))


@pytest.mark.parametrize(("start", "skipped", "row"), [("1/2", 0, 15), ("3/5", 0, 18), ("51/100", 240, 15)])
def test_the_song_begins_before_the_clip(tmp_path, build, song, start, skipped, row):
    store = build(start)
    assert verify_store(tmp_path / "out") == []
    expected = rows_of(song[skipped:])
    np.testing.assert_array_equal(store["a"].read("librosa35"), expected[row:][: SECONDS * 30])
    assert store["a"].audio_start == Fraction(start)
    assert store["a"].music_offset == Fraction(start)
    windows = store.windows("train")
    assert [w.start for w in windows] == list(range(0, SECONDS * 30 - 60 - row + 1, 15))
    assert {row["reason"] for row in store.rejects} == {"no_audio"}


@pytest.mark.parametrize(("start", "skipped", "offset"), [("-1/2", 0, -15), ("-0.51", 560, -16)])
def test_the_song_begins_after_the_clip(tmp_path, build, song, start, skipped, offset):
    store = build(start)
    assert verify_store(tmp_path / "out") == []
    expected = rows_of(song[skipped:])
    first = -offset if offset % 15 == 0 else 30
    windows = store.windows("train")
    assert windows[0].start == first
    for window in windows:
        begin = window.start + offset
        np.testing.assert_array_equal(store.read(window, "librosa35"), expected[begin : begin + 60])
    assert WindowDataset(store, fields=("librosa35",), scale=None)[0]["librosa35"].shape == (60, 35)
    cut = store.windows("train", length=30, stride=10)
    assert cut[0].start == -offset
    assert store._starts("a", 60).start == -offset
    row, rows = store["a"].rows_within("librosa35")
    np.testing.assert_array_equal(rows, expected[: len(rows)])
    assert (row, len(rows)) == (-offset, SECONDS * 30 + offset)
    with raises_message(UsageError, "begin", where="clip a"):
        store["a"].read("librosa35")
    with raises_message(UsageError, "begins", where="clip a"):
        store.read(type(windows[0])("a", 0, 60), "librosa35")


@pytest.mark.parametrize("start", ["-1/2", "-0.51"])
def test_music_that_begins_later_is_drawn_and_reported(tmp_path: Path, build: Any, start: str) -> None:
    store = build(start)
    lead, rows = store["a"].rows_within("librosa35")
    beats = np.flatnonzero(rows[:, -1]) + lead
    scenes = Scenes(store)
    rhythm = scenes.scene(scenes.items[0]).rhythm
    assert np.abs(rhythm.beats * 30 + 1 - beats).max() <= 0.5
    assert (rhythm.onset[:lead] == 0).all()
    assert len(rhythm.onset) == lead + len(rows) - 1
    piece = ClipReader.of(store).piece(store.clips()[0])
    assert piece is not None
    assert piece.beats is not None
    assert (piece.beats.frames == beats).all()
    assert piece.beats.seconds == pytest.approx(rhythm.beats)
    found = write_report(tmp_path / "out", tmp_path / "page.html")
    assert found.numbers.contents.music_minus_motion_s.min == pytest.approx(float(-Fraction(start)), abs=1 / 30)
    axes = plot.features(store, "a", "librosa35")
    assert axes.images[0].get_extent()[:2] == [lead / 30, SECONDS]


def test_copies_at_another_speed_keep_their_place(tmp_path: Path, build: Any) -> None:
    store = build("1/2", augment={"tempo": {"speeds": [1.25]}})
    assert verify_store(tmp_path / "out") == []
    assert store["a__tempo"].audio_start == Fraction(2, 5)
    assert store["a__tempo"].music_offset == Fraction(12, 30)


def test_windows_by_themselves_are_refused(build: Any) -> None:
    with raises_message(UsageError, "begin", where="clip a"):
        build("1/2", transforms=["slices"], windows={"length_s": 5, "stride_s": 1})


@pytest.fixture
def two_splits(tmp_path: Path, song: np.ndarray) -> Path:
    """Clips of train and test with songs of their own."""
    write_clip(tmp_path / "source", "b", "mHO3")
    return tmp_path / "source"


@pytest.mark.parametrize("start", ["1/2", "-1/2", "-0.51"])
def test_what_reads_whole_songs_reads_them(tmp_path: Path, build: Any, two_splits: Path, start: str) -> None:
    store = build(start)
    assert verify_store(tmp_path / "out") == []
    assert len(alike_songs(store, songs_of(store.clips())) or ()) == 0
    (two_splits / "a.wav").write_bytes((two_splits / "b.wav").read_bytes())
    shutil.copytree(tmp_path / "source", tmp_path / "other" / "source")
    other = build(start, tmp_path / "other")
    [gap] = [d for d in comparison.diff(store.path, other.path) if d.kind == "values"]
    assert gap.names == ("a",)


@pytest.mark.parametrize("start", ["0", "1.2", "-1"])
def test_beats_of_music_files_are_counted_from_frame_0(tmp_path, cache, build, song, start):
    """Beats from the source are those that the store has, and those of the song less its beginning."""
    store = build(start)
    found = {}
    resources = Resources(Cache(cache), 1, Progress(quiet=True))
    protocol = PROTOCOLS.get("dancedata")()
    clips, _ = store_clips(store, protocol)
    for name, files in (("store", {}), ("files", {"a": tmp_path / "source" / "a.wav"})):
        plan = music_plan(protocol, ClipSet(clips, "out", "truth", store), MusicSources(files=files))
        music, _ = read_beats(resources, plan)
        found[name] = music["a"].beats.seconds
    within = found["files"][found["files"] < SECONDS - 0.1]
    np.testing.assert_allclose(within, found["store"][found["store"] < SECONDS - 0.1], atol=1e-9)
    heard = store.field("librosa35").beats(rows_of(song)).seconds - float(Fraction(start))
    if Fraction(start) * 30 % 1 == 0:
        np.testing.assert_allclose(found["files"], heard[heard >= 0], atol=1e-9)


@pytest.mark.parametrize("start", ["3/2", "-1"])
def test_edge_gets_the_sound_of_its_windows(tmp_path: Path, build: Any, two_splits: Path, start: str) -> None:
    store = build(start, motion={"edge151": {}}, windows={"length_s": 5, "stride_s": "1/2"})
    dancedata.export(store.path, "edge", tmp_path / "edge", source=two_splits)
    song = soundfile.read(two_splits / "a.wav", dtype="float32")[0]
    for window in store.windows("train"):
        [file] = (tmp_path / "edge").rglob(f"train/wavs_sliced/a_slice{window.start // 15}.wav")
        first = int((Fraction(start) + Fraction(window.start, 30)) * RATE)
        np.testing.assert_array_equal(soundfile.read(file, dtype="float32")[0], song[first : first + 5 * RATE])


@pytest.mark.parametrize("start", ["1/2", "51/100", "-3/5", "5"])
def test_a_plan_counts_the_windows_of_a_build(tmp_path: Path, cache: Path, build: Any, start: str) -> None:
    tempo = {"augment": {"tempo": {"speeds": [0.9, 1.1]}}}
    store = build(start, **tempo)
    places = {"jobs": 1, "cache": cache, "progress": False}
    plan = make_plan(store.info["recipe"], tmp_path / "source", tmp_path / "out", **places).to_json()
    counts = store.info["splits"]["train"]
    assert plan["splits"]["train"] == {name: counts[name] for name in plan["splits"]["train"]}
    assert plan["left_out"] == reasons(store)
    assert all(units["cached"] == units["of"] > 0 for units in plan["cached"].values())


@pytest.mark.parametrize(("target", "options"), [("npz", {}), ("webdataset", {"samples": "clips"})])
def test_exports_of_whole_clips_name_music_that_begins_later(tmp_path, build, target, options):
    store = build("-1")
    with raises_message(StoreError, "later", where="out"):
        dancedata.export(store.path, target, out=tmp_path / "x", **options)


def test_a_scaler_over_all_rows_takes_music_that_begins_later(build: Any) -> None:
    store = build("-1")
    scaler = WindowDataset(store, "train", scale=Scale(fields=("librosa35",), over="all")).scaler("librosa35")
    _, rows = store["a"].rows_within("librosa35")
    np.testing.assert_array_equal(scaler.data_max, rows.max(axis=0).astype(np.float64))
