"""Groups in figures and videos: all dancers at their places, in colours of their own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata import plot
from dancedata.core.errors import UsageError
from dancedata.core.skeleton import SMPL24
from dancedata.plot.frames import Frames
from dancedata.scene.motion_page import motion_scenes_of
from dancedata.scene.palette import DANCERS, Theme
from dancedata.scene.scene_list import Scene
from dancedata.scene.scenes import Scenes
from dancedata.scene.wall import Wall
from dancedata.testing.examples import random_motion
from tests.commands import run
from tests.messages import raises_message
from tests.scene.conftest import crowd, crowd_source, duets, lacking  # noqa: F401 (the groups of the viewer's tests)

SEVEN, DUET = "plainid0123_04_829_1009", "Waltz_5_0"


def picture_of(path: Path, group: str, theme: Theme = "dark", frame: int = 20) -> tuple[Scene, np.ndarray]:
    """Return a scene and its frame of 640 x 480."""
    pytest.importorskip("matplotlib")
    scenes = Scenes(dancedata.open(path))
    scene = scenes.scene(scenes.find(group))
    return scene, next(iter(Frames(scene, (640, 480), np.array([frame / 30]), theme)))[..., :3]


def pixels(picture: np.ndarray, colour: str) -> int:
    rgb = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return int((np.abs(picture.astype(int) - rgb).sum(axis=2) < 30).sum())


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_every_dancer_is_in_the_picture(crowd: Path, theme: Theme) -> None:  # noqa: F811
    stage = picture_of(crowd, SEVEN, theme)[1][:310]
    for tones in DANCERS[theme][:7]:
        assert min(pixels(stage, tone) for tone in tones) > 15
    assert pixels(stage, DANCERS[theme][7][0]) == 0


def test_the_nearest_dancer_is_in_front(duets: Path) -> None:  # noqa: F811
    scene, _ = picture_of(duets, DUET)
    figure, (leader, follower) = scene.members[0].figure, scene.members
    for by in (-0.4, 0.4):  # one behind, or before the other, as the camera looks
        away = figure.shifted(by * np.array([np.sin(np.radians(31.5)), 0, np.cos(np.radians(31.5))]))
        both = replace(scene, members=(replace(leader, figure=figure), replace(follower, figure=away)))
        picture = next(iter(Frames(both, (640, 480), np.zeros(1))))[:330, :, :3]
        counts = [pixels(picture, tones[0]) for tones in DANCERS["dark"][:2]]
        assert counts[by > 0] > 1.5 * counts[by < 0]


def test_names_may_have_any_letters() -> None:
    pytest.importorskip("matplotlib")
    wall = Wall(motion_scenes_of({name: random_motion(SMPL24, 30) for name in ("舞", "$a_1$")}, None))
    assert len(list(Frames(wall.scene(wall.items[0]), (640, 480), np.arange(2) / 30))) == 2


def test_dancers_keep_their_colours_where_others_are_missing(lacking: Path) -> None:  # noqa: F811
    _, picture = picture_of(lacking, SEVEN)
    for k, tones in enumerate(DANCERS["dark"][:7]):
        assert (pixels(picture, tones[0]) > 15) == (k not in (1, 4))


def test_a_duet_has_lanes_of_both_and_of_collisions(duets: Path) -> None:  # noqa: F811
    scene, picture = picture_of(duets, DUET, "light")
    below = picture[375:]
    for tones in DANCERS["light"][:2]:
        assert min(pixels(below, tones[1]), pixels(below, tones[2])) > 200
    assert scene.together is not None
    (pair,) = scene.together.pairs
    assert pair.collides.any()
    amber = (np.abs(below[-20:, 62:].astype(int) - [0x8A, 0x5A, 0x00]).sum(axis=2) < 12).any(axis=0)
    assert amber.mean() == pytest.approx(pair.collides.mean(), abs=0.06)


def test_a_video_of_a_group_and_of_one_dancer(duets: Path, tmp_path: Path) -> None:  # noqa: F811
    pytest.importorskip("imageio_ffmpeg")
    for name in (DUET, f"{DUET}_01"):
        written = plot.write_video(duets, name, tmp_path / f"{name}.mp4", length_s=0.2, size=(192, 160))
        assert written.stat().st_size > 1000
    assert "group.mp4" in run("view", duets, f"{DUET}@240+6", "--out", tmp_path / "group.mp4").stdout


def test_poses_of_a_group_stand_as_they_stand_together(duets: Path, tmp_path: Path) -> None:  # noqa: F811
    pytest.importorskip("matplotlib")
    scenes = Scenes(dancedata.open(duets))
    members = scenes.scene(scenes.find(DUET)).members
    axes = plot.motion(duets, DUET, times=[0, 4], turn_deg=0, body=False)
    lines = [line for line in axes.lines if len(line.get_xdata()) == 2 and line.get_linestyle() == "-"]
    assert len(lines) == 2 * 2 * 23 + 1
    follower, leader = (lines[k * 23].get_xdata()[0] for k in (0, 1))
    joints = [member.figure.joints for member in members]
    assert follower - leader == pytest.approx(joints[0][0, 0, 0] - joints[1][0, 0, 0], abs=1e-6)
    floor = min(member.figure.floor for member in members)
    assert lines[23].get_ydata()[0] == pytest.approx(joints[1][0, 0, 1] - floor)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["0 follower", "1 leader"]
    axes.figure.savefig(tmp_path / "poses.png", dpi=40)
    assert plot.motion(duets, f"{DUET}_01", poses=2).get_legend() is None


def test_music_of_a_group_is_that_of_all_and_motion_is_of_one(duets: Path) -> None:  # noqa: F811
    pytest.importorskip("matplotlib")
    one, group = (plot.features(duets, name, "librosa35") for name in (f"{DUET}_00", DUET))
    np.testing.assert_array_equal(one.get_images()[0].get_array(), group.get_images()[0].get_array())
    with raises_message(UsageError, "Waltz_5_0_01"):
        plot.features(duets, DUET, "joints")
