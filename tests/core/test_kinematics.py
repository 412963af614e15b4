"""Rotations, forward kinematics and quality flags: by hand, against scipy and EDGE, and on real clips."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion, forward_kinematics
from dancedata.core.quality import quality_flags
from dancedata.core.rotations import (
    angles_between,
    matrix_from_6d,
    matrix_from_rotvec,
    rotation_6d,
    rotvec_from_matrix,
)
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE, Skeleton
from dancedata.formats.safe_pickle import load_pickle

REAL = [
    "gBR_sBM_cAll_d04_mBR2_ch08",
    "gBR_sBM_cAll_d06_mBR2_ch06",
    "gJS_sBM_cAll_d03_mJS2_ch07",
    "gJS_sFM_cAll_d02_mJS4_ch09",
]
#: COCO joint -> SMPL joint: shoulders, elbows, wrists, knees, ankles.
LIMBS = {5: 16, 6: 17, 7: 18, 8: 19, 9: 20, 10: 21, 13: 4, 14: 5, 15: 7, 16: 8}


def load(folder: Path, name: str, skeleton: Skeleton) -> tuple[Motion, float]:
    """Read a clip, with nothing of dancedata.datasets, and its scaling."""
    content = load_pickle(folder / "motions" / f"{name}.pkl")
    scaling = float(np.asarray(content["smpl_scaling"]).ravel()[0])
    rotations = np.asarray(content["smpl_poses"], np.float64).reshape(-1, 24, 3)
    return Motion(
        np.asarray(content["smpl_trans"], np.float64) / scaling, rotations, FrameGrid.of(60), skeleton
    ), scaling


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 100))
def test_6d_of_any_length_is_decoded(seed: int, factor: float) -> None:
    rotvec = np.random.default_rng(seed).normal(size=(4, 3, 3)) * 2
    matrix = matrix_from_rotvec(rotvec)
    rows = rotation_6d(matrix) * factor
    rows[..., 3:] += 0.3 * rows[..., :3]  # Gram-Schmidt takes this out again
    np.testing.assert_allclose(matrix_from_6d(rows), matrix, atol=1e-9)
    np.testing.assert_allclose(matrix_from_rotvec(rotvec_from_matrix(matrix)), matrix, atol=1e-9)


@pytest.mark.parametrize("n_frames", [1, 3, 256, 300])
@pytest.mark.parametrize("n_joints", [1, 2, 24])
def test_joints_are_those_of_one_joint_after_another(n_frames: int, n_joints: int) -> None:
    random = np.random.default_rng(n_frames)
    skeleton = Skeleton(
        "some", SMPL24.joints[:n_joints], SMPL24.parents[:n_joints], SMPL24.offsets[:n_joints], (), (0, 0, 0, 0)
    )
    translation, rotations = random.normal(size=(n_frames, 3)), random.normal(size=(n_frames, n_joints, 3))
    world, expected = matrix_from_rotvec(rotations), np.empty((n_frames, n_joints, 3))
    expected[:, 0] = skeleton.offsets[0] + translation
    for joint, parent in enumerate(skeleton.parents[1:], 1):
        expected[:, joint] = expected[:, parent] + np.einsum("tab,b->ta", world[:, parent], skeleton.offsets[joint])
        world[:, joint] = world[:, parent] @ world[:, joint]
    found = forward_kinematics(skeleton, rotations, translation)
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", REAL)
def test_real_clips_against_their_keypoints(shared: Path, name: str) -> None:
    """FACTS 7: 1.5-2.6 cm with the true pelvis, 24 cm without; left and right, scale and axes are right."""
    folder = shared / "realdata/aistpp"
    motion, scaling = load(folder, name, SMPL24)
    points = np.asarray(load_pickle(folder / "keypoints3d" / f"{name}.pkl")["keypoints3d_optim"]) / scaling
    assert len(points) == motion.n_frames
    joints = motion.joints()

    def error(found: np.ndarray) -> float:
        return float(np.nanmean(np.linalg.norm(found[:, list(LIMBS.values())] - points[:, list(LIMBS)], axis=-1)))

    assert error(joints) < 0.03
    assert 0.20 < error(load(folder, name, SMPL24_EDGE)[0].joints()) < 0.28
    swapped = joints.copy()
    for left, right in SMPL24.pairs:
        swapped[:, [left, right]] = swapped[:, [right, left]]
    assert error(swapped) > 0.1
    assert 0.50 < joints[:, list(SMPL24.feet), 1].min() < 0.68


def still(n: int, rate: float = 60) -> tuple[np.ndarray, np.ndarray, FrameGrid]:
    return np.zeros((n, 3)), np.zeros((n, 24, 3)), FrameGrid.of(rate)


@pytest.mark.parametrize("rate", [30, 60])
def test_limits_are_speeds(rate: int) -> None:
    translation, rotations, grid = still(10, rate)
    step = np.radians(2700 / rate)
    rotations[4:, 5, 1] = step * 1.01
    rotations[7:, 6, 1] = step * 0.99
    translation[8:, 0] = 12.1 / rate
    found = quality_flags(Motion(translation, rotations, grid, SMPL24))
    assert [(f.kind, f.joint, f.frame, f.unit, f.rate) for f in found] == [
        ("fast_turn", "right_knee", 3, "deg", str(rate)),
        ("root_jump", "pelvis", 7, "m", str(rate)),
    ]
    assert found[0].value == pytest.approx(2700 / rate * 1.01, abs=1e-3)
    assert found[1].to_json()["value"] == pytest.approx(12.1 / rate, abs=1e-4)


def test_wraps_are_not_turns() -> None:
    translation, rotations, grid = still(100)
    rotations[:, 0, 1] = np.linspace(0, 14, 100)
    wrapped = Rotation.from_rotvec(rotations[:, 0]).as_rotvec()
    assert np.abs(np.diff(wrapped[:, 1])).max() > 3
    for root in (rotations[:, 0].copy(), wrapped):
        rotations[:, 0] = root
        assert quality_flags(Motion(translation, rotations, grid, SMPL24)) == []
    assert quality_flags(Motion(translation[:1], rotations[:1], grid, SMPL24)) == []


#: Angles on both sides of where the Taylor series takes over, and beyond a full turn.
SCALES = (0.0, 1e-300, 1e-12, 1e-4, 9.99e-4, 1.001e-3, 0.1, 1.0, np.pi, 2 * np.pi, 12.0)


def rotvecs(scale: float) -> np.ndarray:
    """Frames of axis-angle vectors (T, J, 3) of about this length; neighbours of frame 3 are equal to it."""
    found = np.random.default_rng(5).normal(size=(40, 24, 3)) * scale
    found[2] = found[4] = found[3]
    return found


@pytest.mark.parametrize("scale", SCALES)
def test_matrices_are_scipys(scale: float) -> None:
    vectors = rotvecs(scale)
    expected = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(40, 24, 3, 3)
    # Ten times the rounding of float64.
    np.testing.assert_allclose(matrix_from_rotvec(vectors), expected, rtol=0, atol=2e-15)


@pytest.mark.parametrize("scale", SCALES)
def test_angles_are_scipys(scale: float) -> None:
    vectors = rotvecs(scale)
    here, there = (Rotation.from_rotvec(v.reshape(-1, 3)) for v in (vectors[:-1], vectors[1:]))
    expected = (here.inv() * there).magnitude().reshape(39, 24)
    found = angles_between(vectors)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-15)
    assert np.all(found[2:4] < 1e-15)


def test_half_turns_apart() -> None:
    vectors = np.array([[[0.0, 0, 0]], [[np.pi, 0, 0]], [[0, 0, 0]], [[0, 2 * np.pi, 0]]])
    np.testing.assert_allclose(angles_between(vectors)[:, 0], [np.pi, np.pi, 0], atol=1e-15)
