"""Joint positions where rotations belong: refused with words, and nothing that is a rotation is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.core.bodies import SMPLX55
from dancedata.core.errors import DataError
from dancedata.core.motion import Motion
from dancedata.core.quality import implausible_flags
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.aistpp import AistPP
from dancedata.datasets.checks import require_rotations
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.formats.safe_pickle import load_pickle
from dancedata.synthetic import synthesise_motion
from tests import video_files
from tests.datasets.scans import load
from tests.messages import raises_message

READING = Reading(Declared("60", "y", "m"), Declared())


@pytest.fixture(scope="module")
def dance() -> Motion:
    return synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0]


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Motion]:
    def read(unnamed: Any = None, **arrays: Any) -> Motion:
        path = tmp_path / ("a.npz" if arrays else "a.npy")
        if arrays:
            np.savez(path, **arrays)
        else:
            np.save(path, unnamed)
        return load_motion(path, READING)

    return read


def refused(call: Callable[[], Any], reason: str) -> None:
    with raises_message(DataError, r"body_pose|\(T, J, 3\)|joint_names|axis-angle", reason=reason):
        call()


def test_arrays_that_are_no_rotations(read: Any, dance: Motion) -> None:
    joints = dance.joints()
    for width in (72, 66):
        refused(lambda width=width: read(joints.reshape(-1, 72)[:, :width]), "bad_shape")
    refused(lambda: read(keypoints3d=joints[:, :17], score=np.ones(3)), "unknown_joints")
    refused(lambda: read(poses=joints[:, :22], trans=joints[:, 0]), "bad_shape")
    refused(lambda: read(verts=np.ones((5, 4))), "missing_key")
    refused(lambda: read(poses=np.degrees(dance.rotations), trans=dance.translation), "not_rotations")


@pytest.mark.parametrize("unit", [1, 100, 1000])
@pytest.mark.parametrize("noise_m", [0, 0.002])
def test_positions_in_disguise(read: Any, dance: Motion, unit: float, noise_m: float) -> None:
    joints = dance.joints() + np.random.default_rng(0).normal(0, 1, dance.joints().shape) * noise_m
    # The advice for unnamed rotations followed with positions: the root is in both.
    refused(lambda: read(poses=joints.reshape(-1, 72) * unit, trans=joints[:, 0]), "not_rotations")
    # Relative to the root, or without a translation: the bones keep their length.
    refused(lambda: read(poses=(joints - joints[:, :1]) * unit, trans=joints[:, 0] * 0), "not_rotations")


@pytest.mark.parametrize("noise_m", [0.005, 0.01])
def test_measured_positions_in_disguise(peers: Any, noise_m: float) -> None:
    """Markers and fitted skeletons are off by millimetres to a centimetre, each joint by itself."""
    motion = load(AistPP(), sorted((peers / "inputs").rglob("*.pkl"))[0])
    joints = motion.joints()
    joints = joints + np.random.default_rng(0).normal(0, noise_m, joints.shape)
    with raises_message(DataError, "joint_names", where="x", reason="not_rotations"):
        require_rotations(Path("x"), "poses", joints - joints[:, :1], motion.translation, SMPL24.parents)


def test_a_measured_root_in_disguise(dance: Motion) -> None:
    rng = np.random.default_rng(0)
    seconds = np.arange(dance.n_frames) / 60
    path = np.stack([0.4 * np.sin(3 * seconds), np.full_like(seconds, 0.9), 0.4 * np.cos(3 * seconds)], axis=1)
    vectors = dance.rotations.copy()
    vectors[:, 0] = path + rng.normal(0, 0.01, path.shape)
    with raises_message(DataError, "joint_names", where="x", reason="not_rotations"):
        require_rotations(Path("x"), "poses", vectors, path, SMPL24.parents)
    # A root that turns as it rises follows the translation in one direction only: that is a dance.
    vectors[:, 0] = np.stack([0.1 * np.sin(5 * seconds), 2 * seconds, 0.1 * np.cos(3 * seconds)], axis=1)
    rising = np.stack([0.02 * np.cos(7 * seconds), seconds, 0.02 * np.sin(2 * seconds)], axis=1)
    require_rotations(Path("x"), "poses", vectors, rising, SMPL24.parents)


@settings(max_examples=60)
@given(
    frames=st.integers(1, 90),
    waves=st.integers(1, 4),
    spins=st.floats(-40, 40),
    swing=st.sampled_from([0, 1e-6, 0.01, 0.5, 2.0]),
    seed=st.integers(0, 10**6),
)
def test_rotations_of_any_kind_pass(frames: int, waves: int, spins: float, swing: float, seed: int) -> None:
    """Any number of frames, still joints, swings about one axis, unwrapped spins, a root that only rises."""
    rng = np.random.default_rng(seed)
    seconds = np.arange(frames)[:, None, None] / 30
    rest = rng.normal(0, 0.5, (24, 3))
    turns = sum(
        swing / waves * np.sin(6.3 * rng.uniform(0.1, 1.5, (24, 1)) * seconds + rng.uniform(0, 6.3, (24, 1))) * axis
        for axis in rng.normal(0, 0.6, (waves, 24, 3))
    )
    rotations = rest + turns
    rotations[:, 0, 1] += np.linspace(0, spins, frames)
    path = 0.3 * np.sin(6.3 * rng.uniform(0.05, 0.3, 3) * seconds[:, 0] + rng.uniform(0, 6.3, 3))
    rising = np.array([0, 1, 0]) * np.linspace(0, 1, frames)[:, None]
    for translation in (path, rising, np.zeros((frames, 3))):
        require_rotations(Path("x"), "poses", rotations, translation, SMPL24.parents)


def smooth_motions(seed: int, frames: int) -> dict[str, np.ndarray]:
    """Rotation vectors (T, 24, 3) of ten kinds, smooth in time, as tests and generators make them."""
    rng = np.random.default_rng(seed)
    t = np.pi * np.arange(frames)[:, None, None] / 30
    one, two, rest = rng.normal(0, 0.4, (3, 24, 3))
    phase, later = rng.uniform(0, 6.3, (24, 1)), 0.3 * np.arange(24)[:, None]
    x, z = np.array([0.3, 0, 0]), np.array([0, 0, 0.3])
    noise = rng.normal(0, 1, (frames + 40, 24, 3)).cumsum(axis=0)
    share = (1 - np.cos(np.linspace(0, np.pi, frames)))[:, None, None] / 2
    return {
        "sines of one phase": np.sin(t) * one,
        "sines of all numbers": 0.4 * np.sin(t + rng.uniform(0, 6.3, (24, 3))),
        "ellipses about a pose": rest + np.cos(t + phase) * one + np.sin(t + phase) * two,
        "circles": np.cos(t + phase) * x + np.sin(t + phase) * z,
        "circles about a pose": rest + np.cos(t + phase) * x + np.sin(t + phase) * z,
        "circles of one phase": np.arange(1, 25)[:, None] / 12 * (np.cos(t) * x + np.sin(t) * z),
        "a wave down the body": np.sin(t - later) * x + np.cos(t - later) * z,
        "smoothed noise": 0.02 * (noise[40:] - noise[:-40]),
        "from pose to pose": rest * (1 - share) + two * share,
        "a drift": rest + 0.1 * share * one,
    }


@pytest.mark.parametrize("kind", smooth_motions(0, 10))
def test_smooth_motions_pass(kind: str) -> None:
    """Vectors that circle keep their distances, but not those of a body; nor is the dancer where they circle."""
    for frames in (40, 90, 300):
        angle = np.pi * np.arange(frames) / 30
        round_the_floor = np.stack([0.5 * np.cos(angle), np.full(frames, 0.9), 0.5 * np.sin(angle)], axis=1)
        for seed in range(4):
            vectors = smooth_motions(seed, frames)[kind]
            for translation in (np.zeros((frames, 3)), round_the_floor):
                require_rotations(Path("x"), "poses", vectors, translation, SMPL24.parents)


def test_extreme_numbers_do_not_crash() -> None:
    rotations = np.random.default_rng(0).normal(0, 1e300, (40, 24, 3))
    with raises_message(DataError, "vectors", where="x", reason="not_rotations"):
        require_rotations(Path("x"), "poses", rotations, rotations[:, 1], SMPL24.parents)


def test_real_motions_are_rotations_and_their_joints_are_not(shared: Path) -> None:
    peers = shared / "golden/peers/inputs"
    motions = [load(AistPP(), path) for path in sorted((peers / "edge_aistpp/motions").glob("*.pkl"))]
    motions += [load_motion(path, Reading(Declared("30"), Declared())) for path in sorted(peers.rglob("*.npy"))]
    assert [implausible_flags(motion) for motion in motions] == [[]] * (6 + 3)
    real = sorted((shared / "realdata/aistpp/motions").glob("*.pkl"))
    motions += [load(AistPP(), path) for path in real]
    for path in (shared / "realdata/finedance").glob("*.npy"):
        motions.append(load_motion(path, Reading(Declared("30"), Declared())))
    for name, up, unit in (("rokoko_jesse_dance", "y", "cm"), ("cmu_01_01", "y", "cmu"), ("fair1_dab", "z", "guess")):
        motions.append(
            load_motion(shared / f"realdata/bvh/{name}.bvh", Reading(Declared(None, up, unit), Declared()))
        )
    assert len(motions) == 6 + 3 + 4 + 1 + 3
    for motion in motions:
        parents = motion.skeleton.parents
        require_rotations(Path("x"), "poses", motion.rotations, motion.translation, parents)
        with raises_message(DataError, "joint_names", where="x", reason="not_rotations"):
            require_rotations(Path("x"), "poses", motion.joints(), np.zeros((motion.n_frames, 3)), parents)
    # Positions as they were captured: bones of keypoints change their length, but the root gives them away.
    for path in sorted((shared / "realdata/aistpp/keypoints3d").glob("*.pkl")):
        points = np.asarray(load_pickle(path)["keypoints3d_optim"])[:, :17]
        with raises_message(DataError, "joint_names", where="x", reason="not_rotations"):
            require_rotations(Path("x"), "poses", np.nan_to_num(points), np.nan_to_num(points[:, 0]), range(-1, 16))


def test_hands_that_do_not_turn_are_not_evidence() -> None:
    """The bones from a wrist to its fingers would all be the wrist's rotation, here of constant length."""
    seconds = np.arange(90) / 30
    vectors = np.zeros((90, 55, 3))
    vectors[:, :22] = video_files.dance(90, 1, 22)[0]
    vectors[:, 20] = vectors[:, 21] = np.stack([np.sin(4 * seconds), np.cos(4 * seconds), 0 * seconds], axis=1)
    require_rotations(Path("x"), "poses", vectors, np.zeros((90, 3)), SMPLX55.parents)
