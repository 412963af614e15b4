"""The figures of a dance paper: two dances, beats, paths, the map of poses, and poses at beats."""

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


def motion_of(clip: Clip) -> Motion:
    return dancedata.decode(clip.read("edge151"), "edge151", fps=30)


def test_the_distance_of_two_dances_is_in_centimetres(demo: Path, tmp_path: Path) -> None:
    joints = motion_of(dancedata.open(demo).clips()[0]).joints()
    stills, curve = plot.compare(joints, joints + np.array([0.03, 0, 0.04]), fps=30, names=("truth", "$x$")).axes
    (line,) = curve.lines
    np.testing.assert_allclose(line.get_ydata(), 5.0, atol=1e-6)
    assert len(line.get_xdata()) == len(joints)
    assert curve.get_xlim() == (0, (len(joints) - 1) / 30)
    assert "cm" in curve.get_ylabel()
    assert [t.get_text() for t in stills.get_yticklabels()] == ["truth", "$x$"]
    stills.figure.savefig(tmp_path / "compare.pdf")


def test_dances_of_other_rates_and_lengths_are_compared_at_equal_moments(demo: Path, slices: Path) -> None:
    clip = dancedata.open(demo).clips()[0]
    joints = motion_of(clip).joints()
    half = plot.compare(clip, joints[:91:2], fps=15, poses=4)
    stills, curve = half.axes
    distance = curve.lines[0].get_ydata()
    assert len(distance) == 91
    np.testing.assert_allclose(distance[::2], 0, atol=1e-4)
    between = np.linalg.norm(joints[1] - (joints[0] + joints[2]) / 2, axis=-1).mean() * 100
    assert distance[1] == pytest.approx(between, abs=1e-4)
    assert [t.get_text() for t in stills.get_xticklabels()] == ["0.00 s", "1.00 s", "2.00 s", "3.00 s"]
    bodies = [c for c in stills.collections if len(c.get_paths()) > 20]
    assert len(bodies) == 8
    slice_ = dancedata.open(slices).clips()[0]
    assert plot.compare(slice_, slice_).axes[1].lines[0].get_ydata().max() == 0


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


def test_paths_have_one_scale(demo: Path) -> None:
    ds = dancedata.open(demo)
    ids = [clip.id for clip in ds.clips()[:3]]
    ways = [line for line in plot.paths(ds, ids).lines if line.get_label() == "_path"]
    assert len(ways) == 3
    for clip, way in zip(ids, ways, strict=True):
        root = motion_of(ds[clip]).joints()[:, 0]
        drawn = np.stack(way.get_data(), axis=1)
        np.testing.assert_allclose(drawn - drawn[0], (root - root[0])[:, [0, 2]] * (1, -1), atol=1e-6)
    motion = motion_of(ds.clips()[0])
    named = plot.paths({"one": motion, "two": motion})
    assert [t.get_text() for t in named.texts][:2] == ["one", "two"]
    assert len(plot.paths(demo, ids[0]).texts) == 2


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
    with raises_message(UsageError, r"dancedata\.decode"):
        plot.compare(motion, np.zeros((5, 151)))
    with raises_message(UsageError, "frame"):
        plot.compare(motion, motion.joints())
