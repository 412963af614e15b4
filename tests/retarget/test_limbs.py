"""Limbs of captures point as in the file, on every body and in every representation, whatever pose is at rest."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import dancedata
from dancedata.core.bodies import SKELETONS, SMPLX55, has_body, transfer_to
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation, shortest_rotation
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.datasets.motorica.motion import write_recording
from dancedata.formats.bvh.joint_names import map_joints
from dancedata.formats.bvh.kinematics import world
from dancedata.formats.bvh.parse import read_bvh
from dancedata.formats.bvh.write import write_bvh
from dancedata.formats.stated import UPRIGHT
from dancedata.retarget.transfer import retargeted
from dancedata.synthetic import synthesise_motion
from tests.formats.test_bvh_retarget import MIXAMO

Floats = NDArray[np.float64]

#: Collar to shoulder, upper arm, forearm, thigh, shin, foot of both sides.
LIMBS = [(13, 16), (16, 18), (18, 20), (1, 4), (4, 7), (7, 10)]
LIMBS += [(14, 17), (17, 19), (19, 21), (2, 5), (5, 8), (8, 11)]
TARGETS = ["smpl24", "smplx55", "lodge139", "finedance319"]
BODIES = [name for name, body in SKELETONS.items() if has_body(body)]


def directions(joints: Floats) -> Floats:
    bones = np.stack([joints[:, b] - joints[:, a] for a, b in LIMBS], axis=1)
    return np.asarray(bones / np.linalg.norm(bones, axis=-1, keepdims=True))


def degrees(one: Floats, other: Floats) -> float:
    chord = np.linalg.norm(one - other, axis=-1).max()
    return float(np.degrees(2 * np.arcsin(min(chord / 2, 1))))


def stored(motion: Motion, target: str) -> Floats:
    """Return the joints of what a dataset holds of a motion."""
    if target in SKELETONS:
        return dancedata.encode(motion, "joints", body=target).reshape(motion.n_frames, -1, 3).astype(np.float64)
    columns = dancedata.encode(motion, target)
    return dancedata.decode(columns, target, fps=motion.grid.rate).joints()


def posed(path: Path, arms: float, legs: float, frames: int = 40) -> None:
    """Write a dance on a level skeleton whose arms hang, and legs are spread, by degrees where all angles are 0."""
    offsets = np.array(SMPL24.offsets)
    turns = np.tile(np.eye(3), (24, 1, 1))
    for side in (0, 1):
        sign = 1 - 2 * side
        arm, leg = (rotation(np.array([0, 0, sign * np.radians(angle)])).as_matrix() for angle in (-arms, legs))
        for joints, turn, bone in (((16, 18, 20), arm, (sign, 0, 0)), ((1, 4), leg, (0, -1, 0))):
            for joint in joints:
                turns[joint + side] = turn
                below = {16: 18, 18: 20, 20: 22, 1: 4, 4: 7}[joint] + side
                offsets[below] = np.linalg.norm(SMPL24.offsets[below]) * (turn @ np.array(bone, dtype=float))
        offsets[10 + side] = turns[4 + side] @ (0, -0.06, 0.12)
        turns[7 + side] = turns[4 + side]
    dance = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=frames)[0]
    local = dance.matrices.copy()
    local[0] = np.eye(3)  # the rest pose itself
    parents = np.array(SMPL24.parents[1:])
    local[1:, 1:] = turns[parents] @ local[1:, 1:] @ np.swapaxes(turns[1:], -1, -2)
    names = [name.partition(":")[2] for name in MIXAMO.split()]
    write_bvh(path, names, SMPL24.parents, offsets * 100, local, dance.translation * 100, "0.0166667")


CAPTURES: dict[str, tuple[Callable[[Path], None] | str, str]] = {
    "T pose": (lambda path: posed(path, 0, 0), "y"),
    "A pose": (lambda path: posed(path, 45, 10), "y"),
    "arms down": (lambda path: posed(path, 88, 0), "y"),
    "I pose, legs apart": (lambda path: posed(path, 70, 30), "y"),
    "FAIR": ("realdata/bvh/fair1_dab.bvh", "z"),
    "CMU": ("realdata/bvh/cmu_01_01.bvh", "y"),
    "Rokoko": ("realdata/bvh/rokoko_jesse_dance.bvh", "y"),
    "Motorica's layout": (lambda path: write_recording(path, 1, dance_s=0.5), "y"),
    "Motorica": ("golden/crowd/inputs/motorica/bvh/kthstreet_gKR_sFM_cAll_d01_mKR_ch01.bvh", "y"),
}


@pytest.fixture(scope="module", params=CAPTURES)
def capture(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Motion, Floats]:
    """A capture of 25 frames and more, and the directions of its limbs by the file's own kinematics."""
    make, up = CAPTURES[request.param]
    if callable(make):
        path = tmp_path_factory.mktemp("capture") / "a.bvh"
        make(path)
    else:
        path = request.getfixturevalue("shared") / make
        if not path.exists():
            pytest.skip(f"{make} is not here")
    motion = load_motion(path, Reading(Declared(None, up), Declared(unit="guess")))
    bvh = read_bvh(path)
    of = map_joints(path, bvh.joints, None).of
    step = -(-motion.n_frames // 20)
    joints = np.full((len(range(0, motion.n_frames, step)), 24, 3), np.nan)
    joints[:, list(of)] = world(bvh, list(of.values()), slice(None, None, step))[1] @ UPRIGHT[up].T
    rows = slice(None, None, step)
    few = Motion(motion.translation[rows], motion.rotations[rows], FrameGrid.of(30), motion.skeleton)
    return few, directions(joints)


@pytest.mark.parametrize("target", TARGETS)
def test_limbs_point_as_in_the_file(capture: tuple[Motion, Floats], target: str) -> None:
    """12.9 degrees off at the left arm, where rotations for SMPL's bones were copied onto SMPL-X's."""
    motion, expected = capture
    known = np.isfinite(expected).all(axis=(0, 2))
    assert known.sum() >= 10
    for body in (None, *BODIES):
        moved = motion if body is None else retargeted(motion, SKELETONS[body], feet=False).motion
        found = directions(stored(moved, target))
        assert degrees(found[:, known], expected[:, known]) < 0.05, body


def test_a_body_without_collars_or_toes(tmp_path: Path) -> None:
    posed(tmp_path / "a.bvh", 0, 0)
    text = (tmp_path / "a.bvh").read_text()
    (tmp_path / "a.bvh").write_text(re.sub(r"(Left|Right)(Shoulder|ToeBase)", r"\1X\2", text))
    motion = load_motion(tmp_path / "a.bvh", Reading(Declared(), Declared(unit="cm")))
    limbs = [k for k, (a, _) in enumerate(LIMBS) if a not in (13, 14, 7, 8)]
    found, expected = (directions(stored(motion, target))[:, limbs] for target in ("lodge139", "smpl24"))
    assert degrees(found, expected) < 0.05
    collars = transfer_to(motion, SMPLX55).rotations[:, 13:15]
    np.testing.assert_array_equal(collars, motion.rotations[:, 13:15])


@pytest.mark.parametrize("target", BODIES)
def test_retargeting_between_bodies_of_models_keeps_the_limbs(target: str) -> None:
    """In the stage `retarget`; without it the parameters of body models are copied, as Lodge does with AIST++'s."""
    dance = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=40)[0]
    for source in (dance, transfer_to(dance, SMPLX55)):
        moved = retargeted(source, SKELETONS[target], feet=False).motion
        assert degrees(directions(moved.joints()), directions(source.joints())) < 1e-3
        assert not moved.skeleton.captured
        copied = transfer_to(source, SKELETONS[target])
        np.testing.assert_array_equal(copied.rotations[:, :22], source.rotations[:, :22])
    columns = dancedata.encode(dance, "lodge139")
    rows = columns[:, 7:].reshape(40, 22, 2, 3)
    np.testing.assert_allclose(rows, dance.matrices[:, :22, :2], atol=1e-6)
    bones = SMPL24.offsets[[18]], SMPLX55.offsets[[18]]
    assert np.degrees(np.arccos((np.trace(shortest_rotation(*bones)[0]) - 1) / 2)) == pytest.approx(12.88, abs=0.01)
