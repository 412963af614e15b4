"""Anything that moves: files and motions that are no dataset, with music beside; pages, walls and videos of them."""

import base64
import gzip
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata import plot
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.files.atomic import PREFIX
from dancedata.formats.motion_files import motion_file
from dancedata.scene.figure import Figure
from dancedata.scene.motion_page import motion_scenes_of, view_motions
from dancedata.scene.motions import MotionScenes
from dancedata.scene.selection import ViewRequest, ViewSelection
from dancedata.scene.wall import MOST, Wall
from dancedata.synthetic import synthesise_motion
from dancedata.viewer.notebook import html_of
from dancedata.viewer.server import Site
from dancedata.viewer.view import export_page
from tests.messages import raises_message
from tests.scene.helpers import CLICKS, FPS, SECONDS, clicks, page_data


def dance(number: int = 0, n_frames: int = SECONDS * 60) -> Motion:
    return synthesise_motion(f"gBR_sBM_cAll_d04_mBR{number}_ch01", n_frames=n_frames)[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A motion in each format, of one song; and a file that cannot be read."""
    out = tmp_path_factory.mktemp("motions")
    motion = dance()
    (out / "a.bvh").write_bytes(motion_file(motion, "bvh"))
    (out / "b.npz").write_bytes(motion_file(motion, "smpl"))
    np.savez(out / "c.npz", joints=motion.joints(), fps=60)
    np.savez(out / "d.npz", full_pose=motion.joints()[::2], fps=30)
    (out / "e.npz").write_bytes(b"no archive")
    (out / "notes.txt").write_text("not a motion")
    clicks("wav", out.parent / "song.wav")
    return out


def shown(path: Path, **options: Any) -> ViewSelection:
    return ViewSelection.of(ViewRequest(path, **options))


def test_a_folder_of_any_files_opens(folder: Path) -> None:
    scenes = shown(folder, music=folder.parent / "song.wav").scenes
    assert [item.id for item in scenes.items] == ["a", "b", "c", "d", "e"]
    joints = dance().joints()
    for item in scenes.items[:3]:
        figure = scenes.scene(item).figure
        assert figure is not None
        np.testing.assert_allclose(figure.joints[:, :22], joints[:, :22], rtol=0, atol=1e-5)
        assert scenes.scene(item).seconds == SECONDS
    assert scenes.scene(scenes.items[3]).figure.grid == FrameGrid.of(30)
    assert [round(scenes.scene(item).seconds, 3) for item in scenes.items[:4]] == [SECONDS] * 4
    assert isinstance(scenes, MotionScenes)
    assert len(scenes.problems) == 1
    assert "e.npz" in scenes.problems[0]
    assert "no figure" in scenes.scene(scenes.items[4]).notes[0]


def test_beats_and_sound_are_those_of_the_music_beside(folder: Path) -> None:
    opened = shown(folder / "a.bvh", music=folder.parent / "song.wav")
    scene = opened.scenes.scene(opened.item)
    beats = scene.rhythm.beats
    nearest = np.abs(beats[:, None] - CLICKS).min(axis=1)
    assert len(beats) > 6
    assert np.median(nearest) < 0.04
    sound = opened.sounds.sound(opened.item)
    assert len(sound.signal.samples) == SECONDS * sound.signal.sample_rate
    onsets = np.flatnonzero(np.abs(sound.signal.samples) > 0.5)[0] / sound.signal.sample_rate
    assert onsets == pytest.approx(CLICKS[0], abs=0.001)
    site = Site(opened.scenes, opened.sounds)
    assert site.answer("/clip/0/music", None).status == 200
    assert json.loads(site.answer("/clip/0", None).body)["seconds"] == SECONDS


def test_music_is_found_by_name_within_a_name_and_by_list(folder: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "gBR_sBM_cAll_d04_mBR0_ch01.npz", joints=dance().joints(), fps=60)
    songs = tmp_path / "songs"
    songs.mkdir()
    for name in ("mBR0", "mBR"):
        clicks("wav", songs / f"{name}.wav")
    scenes = shown(tmp_path, music=songs).scenes
    assert scenes.items[0].clip.music == "mBR0"
    (songs / "list.csv").write_text("clip,song\na,mBR\nb,mBR0.wav\n")
    listed = shown(folder, music=songs / "list.csv").scenes
    assert [item.clip.music for item in listed.items] == ["mBR", "mBR0", "", "", ""]
    assert "no music is named as this clip" in listed.scene(listed.items[2]).notes
    with raises_message(UsageError, "song", where="songs"):
        shown(folder, music=songs)


def test_columns_and_batches_of_a_trainer(odd: Path, tmp_path: Path) -> None:
    ds = dancedata.open(odd)
    rows = [ds.read(window, "edge151") for window in list(ds.windows("train"))[:3]]
    np.save(tmp_path / "samples.npy", ds.scaler("edge151").normalize(np.stack(rows)))
    options: dict[str, Any] = {"field": "edge151", "like": odd}
    scenes = shown(tmp_path, normalized=True, **options).scenes
    assert [item.id for item in scenes.items] == ["samples_000", "samples_001", "samples_002"]
    for item, wanted in zip(scenes.items, rows, strict=True):
        plain = dancedata.decode(wanted, "edge151", fps=FPS)
        np.testing.assert_allclose(scenes.scene(item).figure.joints, plain.joints(), rtol=0, atol=1e-4)
    with raises_message(UsageError, "whether", where="samples.npy"):
        shown(tmp_path, **options)
    with raises_message(UsageError, "frame rate|wrong shape"):
        shown(tmp_path, field="edge151")
    with raises_message(DataError, "frame rate|wrong shape", where="samples.npy", reason="bad_shape"):
        shown(tmp_path)


def test_a_group_of_a_file_is_one_item_and_of_a_batch_one_each(tmp_path: Path) -> None:
    joints = np.stack([np.add(dance(k).joints()[:60], (1.5 * k, 0, 0)) for k in range(3)])
    np.savez(tmp_path / "trio.npz", joints=joints, person_mask=[1, 0, 1], fps=60)
    scenes = shown(tmp_path / "trio.npz").scenes
    (item,) = scenes.items
    scene = scenes.scene(item)
    assert len(scene.dancers) == 2
    assert scene.together.pairs[0].distance_m[0] == pytest.approx(
        np.linalg.norm(joints[2, 0, 0] - joints[0, 0, 0]), abs=1e-6
    )
    np.savez(
        tmp_path / "batch.npz", joints=np.stack([joints, joints[::-1]]), person_mask=[[1, 0, 1], [1, 1, 1]], fps=60
    )
    scenes = shown(tmp_path / "batch.npz").scenes
    assert [(item.id, len(item.members)) for item in scenes.items] == [("batch_000", 2), ("batch_001", 3)]
    first = scenes.scene(scenes.items[0]).dancers[1].figure
    np.testing.assert_allclose(first.joints, joints[2], rtol=0, atol=1e-9)
    last = scenes.scene(scenes.items[1]).dancers[2].figure
    np.testing.assert_allclose(last.joints, joints[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("options", [{"overlay": True}, {"normalized": True}, {"clip": "nobody"}], ids=str)
def test_what_does_not_go_with_files(folder: Path, options: dict[str, Any]) -> None:
    with raises_message(UsageError, "needs columns|nobody|overlay"):
        shown(folder, **options)


def test_nothing_that_moves(tmp_path: Path) -> None:
    """A build that was interrupted is named as one."""
    (tmp_path / "killed" / f"{PREFIX}unfinished").mkdir(parents=True)
    (tmp_path / "empty").mkdir()
    for path in (tmp_path, tmp_path / "gone", Path(__file__), tmp_path / "killed", tmp_path / "empty"):
        with raises_message(DataError, "look", reason="nothing_matched"):
            shown(path)


def test_motions_of_python_are_shown(tmp_path: Path) -> None:
    motion = dance()
    html = html_of(motion)
    assert 'sandbox="allow-scripts"' in html
    page = page_data(plot.write_page({"one": motion, "two": dance(1)}, tmp_path / "page.html"))
    assert [clip[0] for clip in page["list"]["clips"]] == ["one", "two"]
    song = tmp_path / "song.wav"
    clicks("wav", song)
    assert set(page_data(view_motions(motion, music=song).page)["audio"]) == {"0"}
    assert page_data(view_motions([motion, dance(1)], wall=True).page)["head"]["groups"] == 1
    with raises_message(UsageError, "motion_1"):
        view_motions([motion, motion.joints()])  # type: ignore[list-item]
    with raises_message(UsageError, "already", where="page.html"):
        plot.write_page(motion, tmp_path / "page.html")


def test_a_wall_of_the_clips_of_a_song() -> None:
    scenes = motion_scenes_of([dance(k, 120) for k in range(14)])
    wall = Wall(scenes)
    (item,) = wall.items
    assert len(item.members) == MOST
    scene = wall.scene(item)
    assert any("left out: 2 further dancers" in note for note in scene.notes)
    roots = np.stack([member.figure.joints[0, 0] for member in scene.members])
    apart = np.linalg.norm(roots[:, None, [0, 2]] - roots[None, :, [0, 2]], axis=-1)
    assert apart[~np.eye(MOST, dtype=bool)].min() > 1.49
    for member, source in zip(scene.members, scenes.items, strict=False):
        before, after = scenes.scene(source).figure, member.figure
        moved = after.joints - before.joints
        np.testing.assert_allclose(moved, np.broadcast_to(moved[0, 0], moved.shape), rtol=0, atol=1e-9)
        assert after.floor == pytest.approx(0, abs=1e-9)
    assert wall.wall_of(scenes.items[3]) == item
    with raises_message(UsageError, "wall", where="motions"):
        wall.wall_of(scenes.items[13])
    with raises_message(UsageError, "wall", where="motions"):
        Wall(motion_scenes_of(dance()))


def test_a_wall_of_a_clip_and_what_it_is_compared_with(odd: Path, source: Path, tmp_path: Path) -> None:
    ds = dancedata.open(odd)
    truth = dancedata.decode(ds["wav"].read("edge151"), "edge151", fps=FPS)
    joints = np.add(truth.joints(), (0.0, 0.5, 2.0))  # elsewhere, which a wall does not count
    joints[:, 15] += [0.024, 0, 0]
    for name, n in (("mine", 180), ("short", 60)):
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / "wav.npz", joints=joints[:n], fps=FPS)
    request = ViewRequest(odd, "wav", music=source, compare=(tmp_path / "mine", tmp_path / "short"), wall=True)
    opened = ViewSelection.of(request)
    scene = opened.scenes.scene(opened.item)
    assert [member.item.part for member in scene.members] == ["odd", "mine", "short"]
    assert {member.figure.n_frames for member in scene.members} == {180}
    assert "short ends at 2.00 s" in scene.notes
    numbers = [dict(member.numbers) for member in scene.members]
    assert numbers[1]["distance"] == "1 mm"  # 24 mm of one joint of 24
    assert "distance" not in numbers[0]
    as_read = Figure.of_joints(joints[:60], SMPL24, FrameGrid.of(FPS))
    assert numbers[2]["sliding"] == f"{100 * as_read.sliding:.1f} cm/s"  # not of the pose that stays
    sound = opened.sounds.sound(opened.item)
    assert len(sound.signal.samples) == SECONDS * sound.signal.sample_rate
    page = page_data(export_page(replace(request, wall=True), tmp_path / "wall.html"))
    members = page["clips"]["0"]["members"]
    assert [m["part"] for m in members] == ["odd", "mine", "short"]
    assert dict(members[1]["numbers"])["distance"] == "1 mm"


def test_the_comparison_and_the_loop_are_in_the_exported_page(odd: Path, tmp_path: Path) -> None:
    joints = dancedata.decode(dancedata.open(odd)["wav"].read("edge151"), "edge151", fps=FPS).joints()
    np.savez(tmp_path / "mine.npz", joints=np.add(joints, (0.0, 0.0, 0.01)), fps=FPS)
    request = ViewRequest(odd, "wav@15+60~mirror", compare=(tmp_path / "mine.npz",), overlay=True, up="y")
    page = page_data(export_page(request, tmp_path / "page.html"))
    assert page["head"]["takes"] == ["mine.npz"]
    assert page["clips"]["0"]["with"]["mine.npz"]["mean"] == pytest.approx(10, abs=0.1)
    assert page["at"] == "#clip=wav&t=0.500&loop=15-75&with=mine.npz&mirror=1&over=1"


def test_the_distance_ends_with_the_comparison_and_the_page_begins_where_there_is_one(odd, tmp_path):
    ds = dancedata.open(odd)
    joints = dancedata.decode(ds["wav"].read("edge151"), "edge151", fps=FPS).joints()
    (tmp_path / "mine").mkdir()
    np.savez(tmp_path / "mine" / "wav.npz", joints=np.add(joints[:60], (0.0, 0.0, 0.01)), fps=FPS)
    said: list[str] = []
    request = ViewRequest(odd, compare=(tmp_path / "mine",))
    page = page_data(export_page(request, tmp_path / "page.html", say=said.append))
    assert page["list"]["clips"][0][0] == "wav"  # the only clip that is in both
    compared = page["clips"]["0"]["with"]["mine"]
    assert compared["mean"] == pytest.approx(10, abs=0.1)
    assert len(gzip.decompress(base64.b64decode(compared["distance"]["data"]))) == 2 * 60
    assert "mine: 1 of " in said[0]
    assert "it shows wav" in said[-1]
    walled = ViewSelection.of(replace(request, wall=True))
    assert [member.item.part for member in walled.scenes.scene(walled.item).members] == ["odd", "mine"]


@pytest.mark.parametrize("name", ["other", "nobody@0+150", "WAV"])
@pytest.mark.parametrize("wall", [False, True])
def test_nothing_that_is_named_as_a_clip_is_an_error(odd: Path, tmp_path: Path, name: str, wall: bool) -> None:
    (tmp_path / "mine").mkdir()
    for number in (name, "second"):
        np.savez(tmp_path / "mine" / f"{number}.npz", joints=np.zeros((60, 24, 3)), fps=FPS)
    with raises_message(DataError, "named", where="mine") as error:
        ViewSelection.of(ViewRequest(odd, compare=(tmp_path / "mine",), wall=wall))
    assert error.value.reason == "nothing_matched"
    assert f"{name}.npz" in str(error.value)
    assert error.value.allowed


def test_clips_of_a_dataset_are_played_beside_motions(odd: Path) -> None:
    clip = dancedata.open(odd)["wav"]
    page = page_data(view_motions({"truth": clip, "mine": dance()}, wall=True).page)
    assert [member["part"] for member in page["clips"]["0"]["members"]] == ["truth", "mine"]
    figure = motion_scenes_of(clip).scene(motion_scenes_of(clip).items[0]).figure
    np.testing.assert_allclose(figure.joints, clip.motion().joints(), rtol=0, atol=1e-9)
