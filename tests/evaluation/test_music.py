"""Sources of music beats."""

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.audio.bailando438 import Bailando438
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.metrics import MusicBeats
from dancedata.recipes.parse import load_recipe
from dancedata.scene.inputs.clip import MemoryClip
from dancedata.scene.inputs.naming import named_clips
from dancedata.scene.inputs.songs import MusicSources, of_known, read_songs, song_files, song_name
from dancedata.store import Store
from dancedata.testing.stores import write_random_store
from tests.features import bailando438_rows
from tests.messages import raises_message


def test_beats_of_a_piece_are_counted_from_its_first_frame() -> None:
    beats = MusicBeats.of([0, 10, 25, 30], FrameGrid.of(30))
    same = beats.after(10, FrameGrid.of(30))
    assert same.frames.tolist() == [0, 15, 20]
    half = beats.after(21, FrameGrid.of(60))  # at 0.35 s, between frames 10 and 11
    assert (half.frames / float(half.grid.rate)).tolist() == pytest.approx([25 / 30 - 0.35, 1 - 0.35])
    ntsc = beats.after(7, FrameGrid.of("30000/1001"))
    start = 7 * 1001 / 30000
    assert (ntsc.frames / float(ntsc.grid.rate)).tolist() == pytest.approx([t - start for t in (10 / 30, 25 / 30, 1)])


def test_generated_clips_take_the_song_that_is_named(store: Store, tmp_path: Path) -> None:
    clip = store.clips()[0]
    np.save(tmp_path / "sample.npy", clip.read("edge151"))
    (tmp_path / "songs.csv").write_text(f"sample,{clip.music}.wav\n", encoding="utf-8")
    options: dict[str, Any] = {"like": store, "normalized": False, "intervals": False}
    named = dancedata.evaluate(tmp_path, music=tmp_path / "songs.csv", **options)
    stored = dancedata.evaluate(
        {clip.id: dancedata.decode(clip.read("edge151"), "edge151")}, like=store, intervals=False
    )
    assert named["bas"].value == stored["bas"].value is not None
    # Of nothing that the dataset has there is no music, but metrics without it have values.
    assert dancedata.evaluate(tmp_path, metrics=["pfc"], **options)["pfc"].value is not None
    # Of some a warning comes first, with their number.
    np.save(tmp_path / f"{clip.id}@0+150.npy", clip.read("edge151")[:150])
    some = dancedata.evaluate(tmp_path, **options)
    assert some.warnings[0].startswith("1 file of 2 without a clip, window or song")
    assert "sample" in some.warnings[0]
    assert str(some).startswith(some.matched)
    assert ": 2 samples: 1 window of 1 clip of small" in some.to_json()["matched"]


def test_music_that_ends_before_the_motion_is_reported(store: Store, tmp_path: Path) -> None:
    clip = store.clips()[0]
    joints = dancedata.decode(clip.read("edge151"), "edge151").joints()
    long = {"long": np.concatenate([joints, joints, joints])}
    report = dancedata.evaluate(long, like=store, music={"long": clip.music}, intervals=False)
    assert any("the music ends before the motion of 1 clip: long" in warning for warning in report.warnings)


@pytest.mark.parametrize("slices", [False, True])
def test_beats_of_slices_where_a_protocol_takes_those_of_songs(store: Store, tmp_path: Path, slices: bool) -> None:
    meta, fields = {"recipe": store.info["recipe"], "licence": ""}, [store.field("edge151"), store.field("librosa35")]
    write_random_store(
        tmp_path / "a", slices=slices, clips={"train": 2}, length=150, n_frames=(165, 165), meta=meta, fields=fields
    )
    windows = dancedata.open(tmp_path / "a")
    columns, music = (np.stack([windows.read(w, f) for w in windows.windows("train")]) for f in windows.fields)
    evaluator = dancedata.Evaluator(windows, normalized=False)
    ids = [f"{w.clip}@{w.start}+{w.length}" for w in windows.windows("train")]
    evaluator.update(columns, ids)
    own = evaluator.compute()["bas"].value
    evaluator.reset()
    evaluator.update(columns, ids, music=music)
    assert own == pytest.approx(evaluator.compute()["bas"].value, rel=1e-9)
    reports = [dancedata.evaluate(windows, split="all", metrics=["bas"], intervals=False), evaluator.compute()]
    for report in reports:
        assert report["bas"].value is not None
    told = [any("beats are those of each slice" in w for w in r.warnings) for r in reports]
    assert told == [slices] * 2


@pytest.mark.parametrize(("text", "word"), [
    ("a,b,c\n", "columns"), ("clip,song\na,b\nc\n", "columns"), ("x,a\nx,b\n", "delete"), ("x, \n", "song"),
])  # fmt: skip
def test_broken_lists_of_songs(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "songs.csv").write_text(text, encoding="utf-8")
    with raises_message(UsageError, word):
        read_songs(tmp_path / "songs.csv")
    with raises_message(DataError, "songs", where="missing.csv", reason="broken_file"):
        read_songs(tmp_path / "missing.csv")


def test_lists_of_songs_of_other_spreadsheets(tmp_path: Path) -> None:
    for between in ",;\t":
        for head in ("", f"clip{between}song\n"):
            (tmp_path / "songs.csv").write_text(f"{head}a{between}mBR0.wav\nb{between}mBR1\n", encoding="utf-8")
            assert read_songs(tmp_path / "songs.csv") == {"a": "mBR0", "b": "mBR1"}
    (tmp_path / "songs.csv").write_text("a;b;c,mBR0\n", encoding="utf-8")
    assert read_songs(tmp_path / "songs.csv") == {"a;b;c": "mBR0"}


def test_missing_songs_are_named(store: Store, tmp_path: Path) -> None:
    for k, clip in enumerate(store.clips()[:2]):
        np.save(tmp_path / f"sample{k}.npy", clip.read("edge151"))
    options: dict[str, Any] = {"like": store, "normalized": False, "intervals": False, "metrics": ["bas"]}
    songs = {"sample0": store.clips()[0].music, "sample1": "nosong"}
    report = dancedata.evaluate(tmp_path, music=songs, **options)
    assert "no beats of songs that --music names: nosong" in report.warnings
    with raises_message(UsageError, "could"):
        dancedata.evaluate(tmp_path, music={"sample0": "other", "sample1": "nosong"}, **options)
    with raises_message(DataError, "named"):
        dancedata.evaluate(tmp_path, **options)


@pytest.fixture(scope="module")
def other_songs(store: Store) -> dict[str, str]:
    """For each clip of the dataset, another song of it."""
    songs = sorted({clip.music for clip in store})
    return {clip.id: songs[songs.index(clip.music) - 1] for clip in store}


def test_the_list_of_songs_counts_for_clips_of_a_dataset_too(store, motions, other_songs):
    own, other = [
        dancedata.evaluate(store, split="all", metrics=["bas"], music=m, intervals=False) for m in (None, other_songs)
    ]
    assert own["bas"].value != other["bas"].value
    # As if generated clips of other names had these songs, and as generated clips with the names of the dataset's.
    renamed = {f"new-{name}": motion for name, motion in motions.items()}
    songs = {f"new-{name}": f"{song}.wav" for name, song in other_songs.items()}
    for clips, music in ((renamed, songs), (dict(motions), other_songs)):
        found = dancedata.evaluate(clips, like=store, metrics=["bas"], music=music, intervals=False)
        assert found["bas"].value == pytest.approx(other["bas"].value, rel=1e-9)


def test_a_song_has_its_own_tempo(store: Store, other_songs: dict[str, str]) -> None:
    tempos = {clip.music: clip.tempo_bpm for clip in store}
    assert len(set(tempos.values())) > 1
    clips = [MemoryClip(id=clip.id, music=clip.music, tempo_bpm=clip.tempo_bpm) for clip in store]
    for like in (store, None):
        named = named_clips(clips, MusicSources(songs=other_songs), like).clips
        assert [clip.tempo_bpm for clip in named] == [tempos[other_songs[clip.id]] for clip in named]
    # Songs whose names say nothing have the tempo that the dataset states.
    (other,) = named_clips([MemoryClip(id="a", tempo_bpm=90.0)], MusicSources.of({"a": "polka"}), None).clips
    assert other.tempo_bpm is None


@pytest.mark.parametrize(("text", "name"), [
    ("mBR0", "mBR0"), ("mBR0.wav", "mBR0"), (" music/mBR0.MP3 ", "music/mBR0"), ("Mr. Brown", "Mr. Brown"),
    ("a.v2.ogg", "a.v2"),
])  # fmt: skip
def test_only_the_suffix_of_a_music_file_is_left_out_of_a_songs_name(text: str, name: str, tmp_path: Path) -> None:
    assert song_name(text) == name
    (tmp_path / "songs.csv").write_text(f'clip,song\nx,"{text}"\n', encoding="utf-8")
    assert read_songs(tmp_path / "songs.csv") == {"x": name}


@pytest.mark.parametrize(("written", "name"), [
    ("session2/take1.wav", "session2/take1"), ("session2\\take1.mp3", "session2/take1"),
    ("/data/songs/session1/take1.wav", "session1/take1"), ("session1/take1", "session1/take1"),
    ("music/mBR0.wav", "mBR0"), ("mBR0", "mBR0"), ("elsewhere/take1.wav", "take1"),
])  # fmt: skip
def test_songs_that_share_a_name_are_named_by_their_folders(tmp_path: Path, written: str, name: str) -> None:
    known = ("session1/take1", "session2/take1", "mBR0")
    (tmp_path / "songs.csv").write_text(f"a,{written},1.5\r", encoding="utf-8")
    found = of_known(read_songs(tmp_path / "songs.csv"), known)
    assert found == {"a": name}
    assert found["a"].start == Fraction(3, 2)


def test_songs_below_a_folder_are_found_by_name(tmp_path: Path) -> None:
    for name in ("one/take1.wav", "two/take1.wav", "two/solo.wav", "two/solo.mp3"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    songs = song_files(tmp_path)
    assert sorted(songs) == ["one/take1", "solo", "two/take1"]
    assert songs["two/take1"] == tmp_path / "two" / "take1.wav"
    (tmp_path / "alone.wav").write_bytes(b"")
    assert sorted(song_files(tmp_path)) == ["alone"]


# Protocols whose beats are those of bailando438: from a dataset with that column, and from the music itself.


PROTOCOLS = ("bailando-aistpp", "motius-aistpp", "dancedata")
#: Beats: MFCC 20, their derivative 20, chroma 12 and the onset envelope stand before them.
COLUMN = 53


@pytest.fixture(scope="module")
def sixty(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A dataset with the columns of the recipe aist++-60 that these protocols need."""
    folder = tmp_path_factory.mktemp("sixty")
    recipe = dict(load_recipe("aist++-60").document)
    recipe["dataset"] = {"synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 6}}
    recipe["audio"] = {"bailando438": recipe["audio"]["bailando438"]}
    recipe["motion"] = {"joints": {}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Bailando438, "extract", bailando438_rows)
        dancedata.build(recipe, out=folder / "sixty", jobs=1, cache=folder / "cache", progress=False)
    return dancedata.open(folder / "sixty")


def bas(what: object, protocol: str, **options: object) -> float:
    options |= {"split": "all"} if isinstance(what, Store) else {}
    report = dancedata.evaluate(what, protocol=protocol, metrics=["bas"], intervals=False, **options)  # type: ignore[arg-type]
    value = report["bas"].value
    assert value is not None
    return value


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_column_of_a_dataset(sixty: Store, protocol: str) -> None:
    found = bas(sixty, protocol)
    beats = {
        clip.id: MusicBeats.of_rows(clip.read("bailando438"), sixty.fields["bailando438"], FrameGrid.of(60), late=1)
        for clip in sixty.clips()
    }
    assert all(own.frames.tolist() == np.flatnonzero(sixty[c].read("bailando438")[:, COLUMN]).tolist()
               for c, own in beats.items())  # fmt: skip
    assert all(len(own.frames) for own in beats.values())
    assert found == bas(sixty, protocol, music=beats)
    late = {clip: MusicBeats.of(own.frames + 7, own.grid) for clip, own in beats.items()}
    assert found != bas(sixty, protocol, music=late)


def test_a_dataset_without_it_has_no_beats_for_the_protocol(sixty: Store, motions: Mapping[str, Motion]) -> None:
    clips = {name: motion.resampled(FrameGrid.of(60)) for name, motion in motions.items()}
    report = dancedata.evaluate(clips, protocol="bailando-aistpp", pool=sixty, intervals=False)
    assert report["bas"].value is None
    assert any("the protocol takes those of bailando438 at 60 per second" in w for w in report.warnings)
