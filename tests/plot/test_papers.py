"""The figures of a dance paper: beats, the map of poses, and poses at beats."""

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
