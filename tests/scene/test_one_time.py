"""One time of music: dancers of one song who begin elsewhere in it are shown and measured where they are in it."""

import shutil
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import DataError, UsageError
from dancedata.scene.comparisons import ItemComparison, StoreComparison
from dancedata.scene.inputs.clip import MemoryClip
from dancedata.scene.inputs.songs import read_songs
from dancedata.scene.motions import MusicFiles
from dancedata.scene.scenes import Scenes
from dancedata.scene.source import ClipSource
from dancedata.scene.wall import Wall, WallSounds
from dancedata.store import open_store
from dancedata.study.trials import Trial, begin_of, common_clips, shown_figures
from dancedata.synthetic import synthesise_motion, synthesise_song
from tests.messages import raises_message

HEAD = "id,motion,audio,up,unit,start_s,end_s\n"


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One take to one song, cut in several ways: the cuts begin at other seconds of the song."""
    folder = tmp_path_factory.mktemp("time")
    source = folder / "source"
    source.mkdir()
    motion = synthesise_motion("gBR_sFM_cAll_d04_mBR4_ch02", n_frames=60 * 20)[0]
    poses = np.asarray(motion.rotations).reshape(-1, 72)
    np.savez(source / "take.npz", poses=poses, trans=np.asarray(motion.translation), fps=60.0)
    song = synthesise_song("mBR4", length_s=24, sample_rate=22_050, n_channels=1)
    soundfile.write(source / "song.wav", song.signal.samples, 22_050)
    rows = {
        "cut": [("whole", "", 12), ("part", 4.2, 18), ("late", 18.5, "")],
        "uncut": [("whole", "", 12), ("part", "", 18)],
        "names": [("other", 4.2, 12), ("first", "", 8)],
        "slices": [("whole", "", 12), ("part", "", 18)],
    }
    built = {}
    for name, clips in rows.items():
        shutil.copytree(source, folder / f"{name}-source")
        lines = [f"{clip},take.npz,song.wav,y,m,{start},{end}\n" for clip, start, end in clips]
        (folder / f"{name}-source" / "manifest.csv").write_text(HEAD + "".join(lines))
        recipe: dict[str, Any] = {
            "recipe": 1, "name": name, "dataset": {"folder": {}}, "motion": {"edge151": {}},
            "audio": {"librosa35": {}}, "windows": {"length_s": 1, "stride_s": 1},
            "transforms": [{"slices": {"length_s": 1, "stride_s": 1}}] if name == "slices" else [],
        }  # fmt: skip
        dancedata.build(
            recipe, folder / f"{name}-source", folder / name, cache=folder / "cache", jobs=1, progress=False
        )
        built[name] = folder / name
    return {**built, "source": source}


def wall_bas(wall: Wall, number: int = 0) -> dict[str, float]:
    return {m.item.clip.id: float(dict(m.numbers)["BAS"]) for m in wall.scene(wall.items[number]).members}


def test_dancers_on_a_wall_keep_their_seconds(stores: dict[str, Path]) -> None:
    store = open_store(stores["cut"])
    wall = Wall(Scenes(store))
    (item,) = wall.items  # "late" shares no second with the others
    scene = wall.scene(item)
    assert scene.seconds == pytest.approx(18)
    joints = {m.item.clip.id: m.figure.joints - m.figure.joints[-1, :1] for m in scene.members if m.figure}
    both = slice(round(4.2 * 30) + 1, 12 * 30 - 1)
    relative = [j[both] - j[both][:1, :1] for j in (joints["whole"], joints["part"])]
    np.testing.assert_allclose(*relative, atol=2e-3)
    assert np.ptp(joints["part"][: round(4.2 * 30)], axis=0).max() < 1e-9  # stands still until then
    assert any("part begins at 4.20 s" in note for note in scene.notes)
    own = {r.id: r for r in Scenes(store).items}
    beats = {name: Scenes(store).scene(own[name]).rhythm.beats for name in ("whole", "part")}
    expected = np.union1d(np.round(beats["whole"], 1), np.round(beats["part"][beats["part"] >= 7.8] + 4.2, 1))
    np.testing.assert_allclose(scene.rhythm.beats, expected, atol=0.1)
    alone = dancedata.evaluate(store, metrics=["bas"], intervals=False)
    found = wall_bas(wall)
    assert alone["bas"].value is not None
    assert found["whole"] == pytest.approx(found["part"], abs=0.15)


def test_the_music_of_a_wall_begins_with_its_first_dancer(stores: dict[str, Path]) -> None:
    store = open_store(stores["names"])
    wall = Wall(Scenes(store))
    sound = WallSounds(wall, ClipSource(store, stores["names"].parent / "names-source")).sound(wall.items[0])
    assert sound is not None
    samples = soundfile.read(stores["source"] / "song.wav", dtype="float32")[0]
    assert len(sound.signal.samples) == 12 * 22_050
    np.testing.assert_array_equal(sound.signal.samples, samples[: 12 * 22_050])


def test_slices_of_a_wall_begin_together(stores: dict[str, Path]) -> None:
    wall = Wall(Scenes(open_store(stores["slices"])))
    for item in wall.items:
        assert len({m.clip.audio_start for m in item.members}) == 1
    assert {len(item.members) for item in wall.items} <= {1, 2}
    assert any(len({m.clip.slice_of for m in item.members}) == 2 for item in wall.items)


@pytest.mark.parametrize(("one", "other"), [("cut", "uncut"), ("uncut", "cut")])
def test_another_dataset_is_compared_at_the_same_second(stores: dict[str, Path], one: str, other: str) -> None:
    mine, theirs = Scenes(open_store(stores[one])), Scenes(open_store(stores[other]))
    comparison = StoreComparison(scenes=theirs, name="other")
    scene = mine.scene(mine.find("part"))
    assert scene.figure is not None
    if one == "uncut":
        with raises_message(DataError, "4.2 s later", reason="too_short"):
            comparison.figure(scene)
        return
    distance = scene.figure.distance_mm(comparison.figure(scene))
    assert np.nanmax(distance) < 1


def test_another_clip_of_the_song_is_compared_at_the_same_second(stores: dict[str, Path]) -> None:
    scenes = Scenes(open_store(stores["cut"]))
    scene = scenes.scene(scenes.find("part"))
    assert scene.figure is not None
    figure = ItemComparison(name="whole", scenes=scenes, item=scenes.find("whole")).figure(scene)
    assert np.nanmax(scene.figure.distance_mm(figure)) < 1
    with raises_message(DataError, "later", reason="too_short"):
        ItemComparison(name="late", scenes=scenes, item=scenes.find("late")).figure(scene)


@pytest.mark.parametrize(("a", "b"), [("cut", "uncut"), ("uncut", "cut"), ("cut", "names")])
def test_dancers_of_a_study_meet_at_one_second(stores: dict[str, Path], a: str, b: str) -> None:
    systems = {name: Scenes(open_store(stores[name])) for name in (a, b)}
    clips = common_clips(systems)
    name = "part" if b != "names" else "song"
    left, right = shown_figures(Trial(0, "song", name, a, b), clips[name], systems, 5)
    assert left.n_frames == right.n_frames == 150
    assert np.nanmax(left.distance_mm(right)) < 1
    begin = {"cut": 0, "uncut": Fraction("4.2")}[a] if b != "names" else 0
    assert begin_of(clips[name], systems) == begin


def test_dancers_who_share_nothing_of_their_song_stand_apart(stores: dict[str, Path]) -> None:
    cut = Scenes(open_store(stores["cut"]))
    systems = {"a": cut, "b": cut}
    items = {"a": cut.find("whole"), "b": cut.find("late")}
    with raises_message(UsageError, r"a from its 0 s, b from its 18\.5 s: 0\.00 s in common", reason="mixed_starts"):
        shown_figures(Trial(0, "song", "song", "a", "b"), items, systems, 5)
    vars(cut)["items"] = tuple(items.values())
    with raises_message(UsageError, r"whole to song.* from 0 s, late to song.* from 18\.5 s"):
        Wall(cut)


def test_a_song_of_a_window_needs_its_second(stores: dict[str, Path], tmp_path: Path) -> None:
    store = open_store(stores["cut"])
    rows = store["part"].read("edge151")
    np.save(tmp_path / "part@30+150.npy", rows[30:180])
    options: dict[str, Any] = {"like": store, "normalized": False, "metrics": ["bas"], "intervals": False}
    (tmp_path / "songs.csv").write_text("clip,song\npart@30+150,song.wav\n")
    with raises_message(UsageError, "second 5.2", where="part@30+150"):
        dancedata.evaluate(tmp_path, music=tmp_path / "songs.csv", **options)
    for folder in ("", f"{stores['source']}/"):
        (tmp_path / "songs.csv").write_text(f"sample,song,start_s\npart@30+150,{folder}song.wav,5.2\n")
        listed = dancedata.evaluate(tmp_path, music=tmp_path / "songs.csv", **options)
        given = dancedata.evaluate(tmp_path, music={"part@30+150": (f"{folder}song.wav", "5.2")}, **options)
        motion = dancedata.decode(rows[30:180], "edge151")
        beats = store["part"].beats()
        mine = MusicBeats.of(np.round((beats[beats >= 1] - 1) * 30).astype(int), store.grid)
        own = dancedata.evaluate({"x": motion}, music={"x": mine}, metrics=["bas"], intervals=False)
        assert listed["bas"].value == given["bas"].value == pytest.approx(own["bas"].value, abs=0.03)
    (tmp_path / "songs.csv").write_text("part@30+150,song,1\npart@30+150,song,2\n")
    with raises_message(UsageError, "two songs"):
        read_songs(tmp_path / "songs.csv")


def test_music_beside_windows_begins_with_them(stores: dict[str, Path], tmp_path: Path) -> None:
    store, song = open_store(stores["cut"]), stores["source"] / "song.wav"
    samples = soundfile.read(song, dtype="float32")[0]
    part, whole = MemoryClip(id="part@30+150"), MemoryClip(id="whole")
    music = MusicFiles.beside(song, [part, whole], store)
    for clip, first in (("part@30+150", 5.2), ("whole", 0)):
        signal = music.signal(clip, Fraction(1))
        assert signal is not None
        np.testing.assert_array_equal(signal.samples, samples[round(first * 22_050) :][:22_050])
    with raises_message(UsageError, "second"):
        MusicFiles.beside(song, [part])
    shutil.copy(song, tmp_path / "song.wav")
    (tmp_path / "songs.csv").write_text("part@30+150,song,2\n")
    signal = MusicFiles.beside(tmp_path / "songs.csv", [part]).signal("part@30+150", Fraction(1))
    assert signal is not None
    np.testing.assert_array_equal(signal.samples, samples[2 * 22_050 :][:22_050])
