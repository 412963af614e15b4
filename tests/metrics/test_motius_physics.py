"""Motius' physical metrics on constructed feet, counted by hand."""

import numpy as np
import pytest

from dancedata.metrics import physics

LEFT, RIGHT = 10, 11


def _standing(frames: int) -> np.ndarray:
    return np.zeros((frames, 22, 3))


def test_a_glide_slides() -> None:
    joints = _standing(20)
    joints[:, :, 0] = 0.004 * np.arange(20)[:, None]  # all joints, 4 mm a frame: toes in contact, with the pelvis
    found = physics(joints)
    assert found.sliding == pytest.approx(0.004, rel=1e-5)
    assert found.dynamic == pytest.approx(0.004)  # relative to the root nothing moves
    assert found.jitter == pytest.approx(0, abs=1e-12)
    assert found.penetration == 0
    assert found.floating == 1  # both toes in contact in all frames, and both move with the pelvis


@pytest.mark.parametrize(("resting", "floating"), [(0, 4.5), (4, 2.5), (5, 2.0), (6, 0.0)])
def test_a_foot_in_the_air_floats(resting: int, floating: float) -> None:
    """Half a frame for each in which a lifted toe goes with the pelvis, if that moves in half of the run."""
    joints = _standing(30)
    pelvis, toe = np.zeros(30), np.zeros(30)
    pelvis[10 + resting : 20] = 0.02  # steps along x; the lifted toe goes with it
    toe[10 : 10 + resting] = 0.02  # steps along z of the toe alone
    path = np.concatenate([[0.0], np.cumsum(pelvis)[:-1]])
    joints[:, :, 0] = path[:, None]
    joints[:, RIGHT, 0] = 0  # stands
    joints[:, LEFT, 2] = np.concatenate([[0.0], np.cumsum(toe)[:-1]])
    joints[10:20, LEFT, 1] = 1.0  # and in frame 19 it comes down
    assert physics(joints).floating * 30 == pytest.approx(floating)
