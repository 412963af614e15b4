"""Body models on pictures: what is in front, how a figure becomes one, videos, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata import plot
from dancedata.core.bodies import MOTORICA21, SMPLX55
from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.formats.body_mesh import BodyMesh
from dancedata.plot.bodies import Camera, body
from dancedata.scene.figure import Figure
from dancedata.scene.motion_page import motion_scenes_of
from dancedata.scene.poses import Pose
from dancedata.scene.selection import ViewRequest
from dancedata.scene.wall import Wall
from dancedata.testing.examples import random_motion
from dancedata.viewer.view import export_page
from tests.body_models import body_model
from tests.commands import run
from tests.messages import raises_message
from tests.plot.test_video import SIZE, pictures


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return body_model(tmp_path_factory.mktemp("model") / "SMPL_MALE.npz", SMPL24)


@pytest.fixture
def mesh(model: Path) -> BodyMesh:
    return BodyMesh.read(model)


@pytest.fixture
def figure() -> Figure:
    return Figure.of_pose(Pose.of_motion(random_motion(SMPL24, 30)), SMPL24, "test")


def test_triangles_are_sorted_by_depth_and_backs_are_not_drawn(figure: Figure, mesh: BodyMesh) -> None:
    pytest.importorskip("matplotlib")
    shown, place = figure.with_mesh(mesh), (5.0, 0.0)
    for distance in (np.inf, 4.0):
        camera = Camera(shown.joints[3, 0], 30.0, 10.0, distance)
        drawn = body(shown, 3, camera, ("#ff0000", "#00ff00", "#0000ff"), place, 1)
        corners = camera(shown.vertices(3))[mesh.faces]
        across, up = np.moveaxis(np.diff(corners, axis=1)[..., :2], -1, 0)
        front = corners[across[:, 0] * up[:, 1] - up[:, 0] * across[:, 1] > 0]
        assert 0.3 * len(corners) < len(front) < 0.7 * len(corners)
        wanted = front[np.argsort(front[..., 2].mean(axis=1))][..., :2] + place
        np.testing.assert_allclose([path.vertices[:3] for path in drawn.get_paths()], wanted)
        assert (drawn.get_facecolor()[:, :3].max(axis=0) > 0.3).all()
    behind = Camera(shown.joints[3, 0] - (0, 0, 9), 0.0, distance=4.0)
    assert not body(shown, 3, behind, ("#ff0000",) * 3, place, 1).get_paths()


def test_a_figure_becomes_a_body_model(figure: Figure, mesh: BodyMesh) -> None:
    assert figure.motion is not None
    assert figure.vertices(3) is None
    shown = figure.with_mesh(mesh)
    posed = list(mesh.posed(mesh.on(figure.motion)))
    np.testing.assert_allclose(shown.vertices(7), posed[7], rtol=0, atol=1e-6)
    np.testing.assert_allclose(shown.joints, figure.joints, atol=1e-9)  # the model has SMPL's bones
    by = np.array([1.0, 0.25, -2.0])
    for whole, wanted in (
        (figure.shifted(by), posed[7] + by),
        (figure.part(4 / 30, 0.5), posed[11]),
        (figure.mirrored().mirrored(), posed[7]),
        (figure.mirrored().shifted(by).mirrored(), posed[7] + by * (-1, 1, 1)),
        (figure.resampled(FrameGrid.of(15), 1.0), posed[14]),
        (figure.resampled(FrameGrid.of(30), 5.0).part(4.0, 1.0), posed[29]),
    ):
        late = whole.with_mesh(mesh)
        np.testing.assert_allclose(late.vertices(7), wanted, rtol=0, atol=3e-6)
        np.testing.assert_allclose(late.joints, whole.joints, rtol=0, atol=1e-6)
    # The model is not mirrored, the dance is: both are as unequal left and right as SMPL's bones.
    mirrored = figure.mirrored().with_mesh(mesh)
    off = np.linalg.norm(mirrored.joints - figure.mirrored().joints, axis=-1)
    assert 1e-4 < off.mean() < 0.03
    swapped = shown.mirrored()
    np.testing.assert_allclose(swapped.vertices(7), mirrored.vertices(7), rtol=0, atol=3e-6)


def test_a_taller_model_has_its_own_bones_and_feet(figure: Figure, mesh: BodyMesh, tmp_path: Path) -> None:
    other = BodyMesh.read(body_model(tmp_path / "m.npz", SMPLX55))
    shown = figure.with_mesh(other)
    assert [shown.skeleton.joints[joint] for joint in shown.contact_joints] == [
        figure.skeleton.joints[joint] for joint in figure.contact_joints
    ]
    np.testing.assert_allclose(shown.joints[:, 0], figure.joints[:, 0], atol=1e-9)
    turned = Figure.of_pose(Pose.of_motion(random_motion(MOTORICA21, 30)), SMPL24, "test")
    for whole in (replace(figure, rotations=None), turned):
        with raises_message(UsageError, "smpl24"):
            whole.with_mesh(mesh)


def test_videos_show_the_model(demo: Path, model: Path, tmp_path: Path) -> None:
    ds = dancedata.open(demo)
    clip, options = ds.clips()[0].id, {"length_s": 0.2, "size": SIZE}
    limbs = plot.write_video(ds, clip, tmp_path / "a.mp4", **options)
    skin = plot.write_video(ds, clip, tmp_path / "b.mp4", body_model=model, **options)
    assert len(pictures(skin)) == len(pictures(limbs)) == 6
    assert np.abs(pictures(skin).astype(int) - pictures(limbs)).max() > 60
    tall = plot.write_video(ds, clip, tmp_path / "c.mp4", body_model=model, betas=[50.0], **options)
    assert np.abs(pictures(tall).astype(int) - pictures(skin)).max() > 60
    command = ["view", demo, f"{clip}@0+12", "--body-model", model, "--size", "192x160"]
    result = run(*command, "--out", tmp_path / "d.mp4")
    assert str(tmp_path / "d.mp4") in result.output
    assert len(pictures(tmp_path / "d.mp4")) == 12


def test_motions_of_a_wall_without_rotations_stay_limbs(mesh: BodyMesh) -> None:
    scenes = motion_scenes_of({"mine": random_motion(SMPL24, 30), "theirs": random_motion(MOTORICA21, 30)}, None)
    wall = Wall(scenes)
    scene = wall.scene(wall.items[0]).with_mesh(mesh)
    mine, theirs = (member.figure for member in scene.members)
    assert mine is not None
    assert theirs is not None
    assert (mine.mesh, theirs.mesh) == (mesh, None)
    assert "theirs: no body model: a motion on skeleton motorica21 cannot be transferred" in scene.notes[-1]
    others = replace(scene, members=scene.members[1:])
    with raises_message(UsageError, "cannot be transferred"):
        others.with_mesh(mesh)


def test_pages_that_are_passed_on_hold_no_model(demo: Path, model: Path, tmp_path: Path) -> None:
    with raises_message(UsageError, "mp4", where="SMPL_MALE.npz"):
        export_page(ViewRequest(demo, body_model=model), tmp_path / "a.html")
    assert not (tmp_path / "a.html").exists()
    with raises_message(DanceDataError, "betas"):
        ViewRequest(demo, betas=(1.0,)).mesh()
