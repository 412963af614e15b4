"""Figures for papers."""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import dancedata
import dancedata.scene
from dancedata import plot
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.pages import write_report
from dancedata.plot.motion_axes import places_of
from dancedata.scene.scene_list import HIT_S
from dancedata.scene.scenes import Scenes
from dancedata.store import Clip
from tests.messages import raises_message

pytest.importorskip("matplotlib")


def test_features_are_rows_of_the_clip(demo: Path) -> None:
    ds = dancedata.open(demo)
    clip = ds.clips()[0]
    axes = plot.features(demo, clip.id)
    (image,) = axes.get_images()
    rows = clip.read("librosa35")
    assert image.get_array().shape == rows.T.shape
    assert image.get_extent() == [0.0, len(rows) / 30, 35.0, 0.0]
    assert 0 <= image.get_array().min() <= image.get_array().max() <= 1
    names = [t.get_text() for t in axes.get_yticklabels()]
    assert names == ["onset envelope", "mfcc", "chroma cens", "onset peak", "beat"]
    places = axes.get_yticks()
    assert np.all(np.diff(places) > 1)
    (beats,) = axes.collections
    assert len(beats.get_segments()) == int(rows[:, -1].sum())
    assert plot.features(ds, clip.id, "edge151", columns=True).get_images()[0].get_array().shape[0] == 151


def test_motion_has_a_row_for_each_joint(demo: Path) -> None:
    from scipy.spatial.transform import Rotation

    ds = dancedata.open(demo)
    clip = ds.clips()[0]
    axes = plot.features(ds, clip.id, "edge151")
    (image,) = axes.get_images()
    rotations = dancedata.decode(clip.read("edge151"), "edge151", fps=30).rotations
    for joint in (0, 16):
        turned = Rotation.from_rotvec(np.array(rotations[:, joint]))
        wanted = np.degrees((turned.mean().inv() * turned).magnitude())
        np.testing.assert_allclose(image.get_array()[joint], wanted, atol=1e-4)
    assert [t.get_text() for t in axes.get_yticklabels()] == [j.replace("_", " ") for j in ds.skeleton.joints]


def test_features_are_drawn_on_given_axes(demo: Path, tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    ds = dancedata.open(demo)
    assert plot.features(ds, ds.clips()[0].id, ax=axes) is axes
    axes.figure.savefig(tmp_path / "features.pdf")


def test_motion_draws_every_bone_of_every_pose(demo: Path, tmp_path: Path) -> None:
    ds = dancedata.open(demo)
    clip = ds.clips()[0]
    axes = plot.motion(ds, clip.id, times=[0, 1, 2.5], body=False)
    joints = dancedata.decode(clip.read("edge151"), "edge151", fps=30).joints()
    lines = [line for line in axes.lines if len(line.get_xdata()) == 2 and line.get_linestyle() == "-"]
    assert len(lines) == 3 * 23 + 1
    scenes = Scenes(ds)
    floor = scenes.scene(scenes.find(clip.id)).figure.floor
    np.testing.assert_allclose(lines[0].get_ydata(), joints[0, [0, 1], 1] - floor, atol=1e-6)
    lengths = [np.hypot(*(np.diff(line.get_data()[k])[0] for k in (0, 1))) for line in lines[:23]]
    bones = np.linalg.norm(joints[0, 1:] - joints[0, list(ds.skeleton.parents[1:])], axis=1)
    assert np.all(lengths <= bones + 1e-6)
    assert [t.get_text() for t in axes.get_xticklabels()] == ["0.00 s", "1.00 s", "2.50 s"]
    axes.figure.savefig(tmp_path / "poses.png", dpi=40)
    assert len(plot.motion(demo, clip.id, poses=4).get_xticks()) == 4


def test_a_name_with_dollars_is_not_a_formula(relabelled, tmp_path: Path) -> None:
    path = relabelled(lambda k: {"id": f"a$b_{{x$ {k}"})
    clip = dancedata.open(path).clips()[0].id
    for axes in (plot.motion(path, clip, poses=1), plot.features(path, clip)):
        axes.figure.savefig(tmp_path / "drawn.png", dpi=40)
        assert clip in axes.get_title(loc="left")


def test_errors_say_what_is_allowed(demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ds = dancedata.open(demo)
    clip = ds.clips()[0].id
    with raises_message(UsageError, "time"):
        plot.motion(ds, clip, times=[99])
    with raises_message(UsageError, "draw"):
        plot.motion(ds, clip, poses=0)
    with raises_message(UsageError, "name the clip", where="demo"):
        plot.motion(ds)
    with raises_message(UsageError, "gHO_sBM_cAll_d19_mHO3_ch03x", where="demo"):
        plot.features(ds, clip + "x")
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with raises_message(UsageError, "matplotlib"):
        plot.motion(ds, clip)


# The figures of a dance paper: two dances, beats, paths, the map of poses, and poses at beats.


pytest.importorskip("matplotlib")


def motion_of(clip: Clip) -> Motion:
    return dancedata.decode(clip.read("edge151"), "edge151", fps=30)


def test_beats_are_those_that_the_viewer_counts(demo: Path) -> None:
    ds = dancedata.open(demo)
    clip = ds.clips()[0]
    scenes = Scenes(ds)
    scene = scenes.scene(scenes.find(clip.id))
    late = [scene.movement.key_times[np.abs(scene.movement.key_times - b).argmin()] - b for b in scene.rhythm.beats]
    hit = sum(abs(s) <= 0.06 for s in late)
    axes = plot.beats(ds, clip.id)
    assert axes.get_title(loc="right").startswith(f"{hit} of {len(late)} beats hit")
    labels = axes.get_legend_handles_labels()[1]
    early = sum(s < -0.06 for s in late)
    assert labels == [f"hit {hit}", f"early {early}", f"late {len(late) - hit - early}",
                      f"key motion {len(scene.movement.key_times)}"]  # fmt: skip
    np.testing.assert_allclose(axes.lines[0].get_ydata(), scene.movement.speed)
    np.testing.assert_allclose(axes.lines[1].get_xdata(), scene.movement.key_times)
    script = (Path(dancedata.scene.__file__).parent / "static" / "js" / "timeline.js").read_text(encoding="utf-8")
    assert float(re.findall(r"HIT_MS = (\d+)", script)[0]) == 1000 * HIT_S


def test_the_map_is_that_of_the_report(demo: Path, tmp_path: Path) -> None:
    hexagons = write_report(demo).document["poses"]["hexagons"]
    axes = plot.pose_map(demo)
    drawn = axes.collections[0]
    assert len(drawn.get_paths()) == len(hexagons)
    np.testing.assert_allclose(drawn.get_array(), [h["counts"]["train"] ** 0.5 for h in hexagons])
    centres = [path.vertices[:6].mean(axis=0) for path in drawn.get_paths()]
    np.testing.assert_allclose(centres, [(h["x"], h["y"]) for h in hexagons], atol=1e-6)
    axes.figure.savefig(tmp_path / "map.pdf")


def test_poses_at_beats_with_equal_gaps(demo: Path) -> None:
    ds = dancedata.open(demo)
    clip = ds.clips()[0]
    scenes = Scenes(ds)
    beats = scenes.scene(scenes.find(clip.id)).rhythm.beats
    axes = plot.motion(ds, clip.id, times="beats", poses=4)
    chosen = beats[np.linspace(0, len(beats) - 1, 4).round().astype(int)]
    assert [t.get_text() for t in axes.get_xticklabels()] == [f"{round(b * 30) / 30:.2f} s" for b in chosen]
    bodies = [c for c in axes.collections if len(c.get_paths()) > 20]
    ends = [np.concatenate([p.vertices[:, 0] for p in c.get_paths()]) for c in bodies]
    assert all(a.max() < b.min() for a, b in pairwise(ends))
    places, width = places_of([(-0.5, 0.3), (-0.4, 0.6), (-0.1, 0.1)])
    assert places == pytest.approx([0.0, 0.3 + 0.2 + 0.4, 0.9 + 0.6 + 0.2 + 0.1 + 0.11])
    assert width == pytest.approx(0.5 + places[-1] + 0.1 + 0.11)


def test_errors_of_the_figures_of_papers(demo: Path) -> None:
    motion = motion_of(dancedata.open(demo).clips()[0])
    with raises_message(UsageError, "draw"):
        plot.motion(motion, times="beats")
