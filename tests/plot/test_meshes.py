"""Body models on pictures: what is in front, how a figure becomes one, videos, and what is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata import plot
from dancedata.core.bodies import MOTORICA21, SMPLX55
from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.formats.body_mesh import BodyMesh
from dancedata.plot.frames import Frames
from dancedata.plot.meshes import rasterised
from dancedata.store.motion_fields import Pose
from dancedata.testing.examples import random_motion
from dancedata.viewer import Figure, Scenes
from dancedata.viewer.notebook import motion_scenes_of
from dancedata.viewer.request import ViewRequest
from dancedata.viewer.view import export_page
from dancedata.viewer.wall import Wall
from tests.body_models import body_model
from tests.commands import run
from tests.messages import raises_message
from tests.plot.test_video import SIZE, pictures

RED, BLUE = [255.0, 0.0, 0.0], [0.0, 0.0, 255.0]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return body_model(tmp_path_factory.mktemp("model") / "SMPL_MALE.npz", SMPL24)


@pytest.fixture
def mesh(model: Path) -> BodyMesh:
    return BodyMesh.read(model)


@pytest.fixture
def figure() -> Figure:
    return Figure.of_pose(Pose.of_motion(random_motion(SMPL24, 30)), SMPL24, "test")


def drawn(places: Any, faces: Any, colours: Any, size: tuple[int, int] = (40, 30)) -> np.ndarray:
    """Return the whole picture, 0 where nothing is drawn."""
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    found = rasterised(np.array(places, float), np.array(faces, np.int32), np.array(colours, float), size)
    if found is not None:
        part, mask, (x, y) = found
        window = picture[y : y + len(part), x : x + len(part[0])]
        window[mask > 0] = part[mask > 0]
    return picture


def test_triangles_that_share_an_edge_leave_no_gap() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        corners = np.array([[3, 2], [36, 4], [33, 27], [5, 25]]) + rng.uniform(-2, 2, (4, 2))
        middle = rng.uniform((12, 10), (26, 20))
        places = np.pad(np.vstack([corners, middle]), [(0, 0), (0, 1)], constant_values=1)
        fan = [[k, 4, (k + 1) % 4] for k in range(4)]
        one = drawn(places, fan, [RED] * 5)[..., 0] > 0
        two = drawn(places, [[0, 3, 1], [1, 3, 2]], [RED] * 5)[..., 0] > 0
        np.testing.assert_array_equal(one, two)
        assert one.sum() > 400


def test_the_nearest_is_in_front_and_backs_are_not_drawn() -> None:
    near, far = [[5, 5, 2], [5, 25, 2], [35, 15, 2]], [[30, 2, 1], [2, 15, 1], [30, 28, 1]]
    for places, order in ((near + far, [RED, BLUE]), (far + near, [BLUE, RED])):
        picture = drawn(places, [[0, 1, 2], [3, 4, 5]], np.repeat(order, 3, axis=0))
        assert picture[15, 10].tolist() == RED
        assert picture[4, 28].tolist() == BLUE
    assert not drawn(near, [[2, 1, 0]], [RED] * 3).any()
    assert not drawn(np.add(near, [100, 0, 0]), [[0, 1, 2]], [RED] * 3).any()
    tilted = [[5, 5, 3], [5, 25, 3], [35, 15, 0.1]]
    picture = drawn(tilted + far, [[0, 1, 2], [3, 4, 5]], [RED] * 3 + [BLUE] * 3)
    assert picture[15, 8].tolist() == RED
    assert picture[15, 26].tolist() == BLUE


def test_colours_are_linear_and_pictures_end_at_their_edges() -> None:
    places = [[-60, -60, 1], [-60, 90, 1], [90, -60, 1]]
    picture = drawn(places, [[0, 1, 2]], [[0, 0, 0], [0, 150, 0], [150, 0, 0]])
    rows, columns = np.mgrid[0:30, 0:40]
    inside = rows + columns + 1 < 30 + 0
    np.testing.assert_allclose(picture[inside][:, 1], (rows + 60.5)[inside], atol=1.01)
    np.testing.assert_allclose(picture[inside][:, 0], (columns + 60.5)[inside], atol=1.01)


def test_a_figure_becomes_a_body_model(figure: Figure, mesh: BodyMesh) -> None:
    assert figure.motion is not None
    assert figure.vertices(3) is None
    body = figure.with_mesh(mesh)
    posed = list(mesh.posed(mesh.on(figure.motion)))
    np.testing.assert_allclose(body.vertices(7), posed[7], rtol=0, atol=1e-6)
    np.testing.assert_allclose(body.joints, figure.joints, atol=1e-9)  # the model has SMPL's bones
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
    swapped = body.mirrored()
    np.testing.assert_allclose(swapped.vertices(7), mirrored.vertices(7), rtol=0, atol=3e-6)


def test_a_taller_model_has_its_own_bones_and_feet(figure: Figure, mesh: BodyMesh, tmp_path: Path) -> None:
    other = BodyMesh.read(body_model(tmp_path / "m.npz", SMPLX55))
    body = figure.with_mesh(other)
    assert [body.skeleton.joints[joint] for joint in body.contact_joints] == [
        figure.skeleton.joints[joint] for joint in figure.contact_joints
    ]
    np.testing.assert_allclose(body.joints[:, 0], figure.joints[:, 0], atol=1e-9)
    turned = Figure.of_pose(Pose.of_motion(random_motion(MOTORICA21, 30)), SMPL24, "test")
    for whole in (replace(figure, rotations=None), turned):
        with raises_message(UsageError, "smpl24"):
            whole.with_mesh(mesh)


def test_a_body_model_is_drawn_with_its_sides(demo: Path, mesh: BodyMesh) -> None:
    scenes = Scenes(dancedata.open(demo))
    scene = scenes.scene(scenes.items[0]).with_mesh(mesh)
    assert scene.figure is not None
    times = np.arange(scene.figure.n_frames) / 30
    counts = []
    for shown in (scene, scene.mirrored()):
        frames = Frames(shown, shown.figure, (640, 480), times, "dark")
        picture = np.asarray(frames.image(20))[:390].astype(int)
        blue = (picture[..., 2] - picture[..., 0] > 60).sum()
        orange = (picture[..., 0] - picture[..., 2] > 60).sum()
        assert min(blue, orange) > 150
        assert len(np.unique(picture[picture[..., 2] - picture[..., 0] > 60] // 16, axis=0)) > 20
        counts.append((picture != np.asarray(frames.image(60))[:390]).sum())
    assert min(counts) > 1000


def test_videos_show_the_model(demo: Path, model: Path, tmp_path: Path) -> None:
    ds = dancedata.open(demo)
    clip, options = ds.clips[0].id, {"length_s": 0.2, "size": SIZE}
    limbs = plot.write_video(ds, clip, tmp_path / "a.mp4", **options)
    body = plot.write_video(ds, clip, tmp_path / "b.mp4", body_model=model, **options)
    assert len(pictures(body)) == len(pictures(limbs)) == 6
    assert np.abs(pictures(body).astype(int) - pictures(limbs)).max() > 60
    tall = plot.write_video(ds, clip, tmp_path / "c.mp4", body_model=model, betas=[50.0], **options)
    assert np.abs(pictures(tall).astype(int) - pictures(body)).max() > 60
    command = ["view", demo, clip, "--body-model", model, "--window", 0, "--size", "192x160"]
    result = run(*command, "--video", tmp_path / "d.mp4")
    assert str(tmp_path / "d.mp4") in result.output
    assert len(pictures(tmp_path / "d.mp4")) == 150


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
    with raises_message(UsageError, "ebf14da2"):
        others.with_mesh(mesh)


def test_pages_that_are_passed_on_hold_no_model(demo: Path, model: Path, tmp_path: Path) -> None:
    with raises_message(UsageError, r"FILE\.mp4", where="SMPL_MALE.npz"):
        export_page(ViewRequest(demo, body_model=model), tmp_path / "a.html")
    assert not (tmp_path / "a.html").exists()
    with raises_message(DanceDataError, "betas"):
        ViewRequest(demo, betas=(1.0,)).mesh()
