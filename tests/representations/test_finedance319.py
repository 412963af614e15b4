"""finedance319: the source's heights, speeds on SMPL-X's joints."""

import numpy as np

from dancedata.contacts.height import Height
from dancedata.contacts.velocity import Velocity
from dancedata.core.bodies import SMPLX52, SMPLX55
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.representations.finedance319 import FineDance319
from dancedata.representations.lodge319 import Lodge319

THIRTY = FrameGrid.of(30)
FINE = FineDance319()


def random_motion(n: int = 8, trim: int = 0) -> Motion:
    rng = np.random.default_rng(6)
    rotations = rng.normal(0, 0.3, (1, 52, 3)) + rng.normal(0, 0.003, (n, 52, 3)).cumsum(axis=0)
    translation = np.add(rng.normal(0, 0.003, (n, 3)).cumsum(axis=0), (0, 1.2, 0))
    return Motion(translation, rotations, THIRTY, SMPLX52, trim)


def test_lodges_layout_is_the_same_and_its_numbers_are_not() -> None:
    motion = random_motion()
    mine, lodges = FINE.encode(motion, Velocity()), Lodge319().encode(motion, Height())
    assert FINE.columns == Lodge319().columns
    np.testing.assert_array_equal(mine[:, 7:], lodges[:, 7:])
    assert np.ptp(mine[:, 5] - lodges[:, 5]) < 1e-6
    assert np.abs(mine[:, 5] - lodges[:, 5]).min() > 0.01
    assert (mine[:, :4] != lodges[:, :4]).any()


def test_jaw_and_eyes_are_left_out() -> None:
    motion = random_motion()
    with_face = np.insert(motion.rotations, [22, 22, 22], 0.7, axis=1)
    whole = Motion(motion.translation, with_face, THIRTY, SMPLX55)
    np.testing.assert_array_equal(FINE.encode(whole, Velocity()), FINE.encode(motion, Velocity()))
