"""Grounding by the toes of one frame, as Lodge does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.core.bodies import SMPLX22, SMPLX52
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion, ground_height, grounded
from dancedata.core.skeleton import SMPL24, Skeleton

THIRTY = FrameGrid.of(30)


def feet(left: float, right: float) -> np.ndarray:
    """Joints (1, 24, 3) at y = -5 (including ankles and hands), except the two toes."""
    joints = np.full((1, 24, 3), -5.0)
    joints[0, 10, 1], joints[0, 11, 1] = left, right
    return joints


@pytest.mark.parametrize(
    ("left", "right", "floor"),
    [
        (0.3, 0.3, 0.3),
        (0.3, 0.319, 0.3095),
        (0.319, 0.3, 0.3095),
        (0.3, 0.321, 0.3),
        (0.321, 0.3, 0.3),
        (-0.5, 0.5, -0.5),
        (0.0, 0.02, 0.0),  # 2 cm are not "less than 2 cm"
    ],
)
def test_mean_of_level_toes_else_the_lower(left: float, right: float, floor: float) -> None:
    assert ground_height(feet(left, right), SMPL24) == pytest.approx(floor, abs=1e-12)


def random_motion(seed: int, skeleton: Skeleton, trim: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    rotations = rng.normal(0, 0.4, (6, skeleton.n_joints, 3))
    return Motion(rng.normal(size=(6, 3)), rotations, THIRTY, skeleton, trim)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 9999), st.integers(0, 5), st.sampled_from([SMPL24, SMPLX22, SMPLX52]))
def test_the_lower_toe_is_on_the_floor_once_the_beginning_is_cut(seed: int, trim: int, skeleton: Skeleton) -> None:
    motion = random_motion(seed, skeleton, trim)
    found = grounded(motion)
    toes = found.joints()[trim, [10, 11], 1]
    level = abs(toes[0] - toes[1]) < 0.02
    assert (toes.mean() if level else toes.min()) == pytest.approx(0, abs=1e-12)
    # Nothing else changed: one height for all frames, those before the cut too.
    shift = motion.translation - found.translation
    np.testing.assert_allclose(shift, np.broadcast_to([0, shift[0, 1], 0], (6, 3)), atol=1e-12)
    np.testing.assert_array_equal(found.rotations, motion.rotations)
    assert (found.grid, found.skeleton, found.trim_start) == (motion.grid, motion.skeleton, trim)
