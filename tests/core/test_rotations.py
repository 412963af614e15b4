"""Rotations against scipy's."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dancedata.core.rotations import angles_between, matrix_from_rotvec

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
