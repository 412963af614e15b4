"""Dances for key motions: synthetic ones, and the real clip in FineDance's layout."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dancedata.core.bodies import SMPLX22, SMPLX52
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import matrix_from_6d, matrix_from_rotvec, rotation_6d, rotvec_from_matrix

THIRTY = FrameGrid.of(30)


@pytest.fixture(scope="session")
def dance() -> Callable[..., Motion]:
    """A made-up dance: every joint swings at a few frequencies."""

    def make(n: int, seed: int = 0, skeleton=SMPLX22) -> Motion:
        rng = np.random.default_rng(seed)
        seconds = np.arange(n)[:, None, None, None] / 30
        joints = skeleton.n_joints
        hertz, phase = rng.uniform(0.1, 1.2, (4, joints, 3)), rng.uniform(0, 6.3, (4, joints, 3))
        turns = 0.25 * np.sin(2 * np.pi * hertz * seconds + phase).sum(axis=1)
        path = 0.4 * np.sin(2 * np.pi * rng.uniform(0.05, 0.2, 3) * seconds[:, 0, 0] + rng.uniform(0, 6.3, 3))
        return Motion(path, turns, THIRTY, skeleton)

    return make


@pytest.fixture(scope="session")
def columns() -> Callable[[Motion], np.ndarray]:
    """lodge139's columns of a motion; contacts are left 0, key motions do not look at them."""

    def make(motion: Motion) -> np.ndarray:
        rows = np.zeros((motion.n_frames, 139), dtype=np.float32)
        rows[:, 4:7] = motion.translation
        rows[:, 7:] = rotation_6d(matrix_from_rotvec(motion.rotations[:, :22])).reshape(motion.n_frames, -1)
        return rows

    return make


@pytest.fixture(scope="session")
def real(shared: Path) -> Motion:
    """32 s of a real dance at 30 FPS, in FineDance's layout."""
    (path,) = (shared / "realdata" / "finedance").glob("derived_315_*.npy")
    rows = np.load(path, allow_pickle=False).astype(np.float64)
    turns = rotvec_from_matrix(matrix_from_6d(rows[:, 3:].reshape(len(rows), 52, 6)))
    return Motion(rows[:, :3], turns, THIRTY, SMPLX52)
