"""Contacts by height and by speed: the rules themselves, and on a motion whose contacts are known."""

import numpy as np
import pytest

from dancedata.contacts.height import Height
from dancedata.contacts.velocity import Velocity
from dancedata.core.bodies import SMPLX52
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE, Skeleton
from dancedata.synthetic import synthesise_motion
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)


def feet(left_ankle: float, right_ankle: float, left_toe: float, right_toe: float, n_joints: int = 24) -> np.ndarray:
    """Joints (1, J, 3), all at y = 0 except the feet."""
    joints = np.zeros((1, n_joints, 3))
    joints[0, [7, 8, 10, 11], 1] = left_ankle, right_ankle, left_toe, right_toe
    return joints


@pytest.mark.parametrize(
    ("heights", "labels"),
    [
        ((0.119, 0.121, 0.049, 0.051), (1, 0, 1, 0)),
        ((0.121, 0.119, 0.051, 0.049), (0, 1, 0, 1)),
        ((0.06, 0.06, 0.06, 0.06), (1, 1, 0, 0)),
        ((0.12, 0.12, 0.05, 0.05), (0, 0, 0, 0)),  # a limit itself is above
        ((-1.0, -1.0, -1.0, -1.0), (1, 1, 1, 1)),
    ],
)
@pytest.mark.parametrize("skeleton", [SMPL24, SMPLX52], ids=lambda s: s.name)
def test_lodges_limits(heights: tuple[float, ...], labels: tuple[int, ...], skeleton: Skeleton) -> None:
    found = Height()(feet(*heights, skeleton.n_joints), THIRTY, skeleton)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, [labels])


def test_speed_does_not_matter() -> None:
    joints = np.concatenate([feet(0.1, 0.1, 0.04, 0.04)] * 3)
    joints[:, :, 0] = np.array([0.0, 50.0, -50.0])[:, None]
    np.testing.assert_array_equal(Height()(joints, THIRTY, SMPL24), np.ones((3, 4)))


def test_custom_limits() -> None:
    found = Height(ankle_m=0.3, toe_m=0.01)(feet(0.25, 0.35, 0.005, 0.015), THIRTY, SMPL24)
    np.testing.assert_array_equal(found, [[1, 0, 1, 0]])


def slide(speed_m_s: float, rate: int, n: int = 5) -> np.ndarray:
    """Joints (n, 24, 3) that all move at a speed along a diagonal."""
    step = speed_m_s / rate * np.array([1.0, -2.0, 2.0]) / 3
    return np.tile((np.arange(n)[:, None] * step)[:, None], (1, 24, 1))


@pytest.mark.parametrize("rate", [30, 60])
def test_limit_is_a_speed_and_the_last_frame_counts_as_still(rate: int) -> None:
    rule, grid = Velocity(), FrameGrid.of(rate)
    slow, fast = (rule(slide(speed, rate), grid, SMPL24) for speed in (0.299, 0.301))
    assert slow.dtype == np.float32
    np.testing.assert_array_equal(slow, np.ones((5, 4)))
    np.testing.assert_array_equal(fast, [[0] * 4] * 4 + [[1] * 4])
    np.testing.assert_array_equal(Velocity(max_speed_m_s=0.4)(slide(0.301, rate), grid, SMPL24), np.ones((5, 4)))


def test_the_limit_itself_is_no_contact() -> None:
    joints = np.tile(np.arange(3.0)[:, None, None] * (0.5, 0, 0), (1, 24, 1))
    assert not Velocity(max_speed_m_s=15)(joints, FrameGrid.of(30), SMPL24)[:2].any()


def test_order_of_the_feet_and_direction_of_time() -> None:
    joints = np.zeros((6, 24, 3))
    for column, foot in enumerate((7, 8, 10, 11)):
        joints[column + 1 :, foot] += 0.5  # jumps between frame `column` and the next
    contacts = Velocity()(joints, FrameGrid.of(30), SMPL24)
    wanted = np.ones((6, 4))
    wanted[range(4), range(4)] = 0
    np.testing.assert_array_equal(contacts, wanted)


@pytest.mark.parametrize(("rule", "name"), [(Height, "ankle_m"), (Height, "toe_m"), (Velocity, "max_speed_m_s")])
@pytest.mark.parametrize("limit", [0, -0.1, float("nan"), float("inf")])
def test_wrong_limits(rule: type, name: str, limit: float) -> None:
    with raises_message(UsageError, "floor|max_speed_m_s"):
        rule(**{name: limit})


@pytest.mark.parametrize("name", ["gBR_sBM_cAll_d04_mBR0_ch01", "gHO_sFM_cAll_d20_mHO1_ch03"])
@pytest.mark.parametrize("skeleton", [SMPL24, SMPL24_EDGE], ids=lambda s: s.name)
def test_known_contacts(name: str, skeleton: object) -> None:
    motion, truth = synthesise_motion(name, n_frames=600)
    thirty = motion.resampled(FrameGrid.of(30))
    joints = thirty.joints() if skeleton is SMPL24 else thirty.joints() - SMPL24.offsets[0]
    contacts = Velocity()(joints, thirty.grid, SMPL24)[:-1]
    # Still from this frame to the next: planted in all frames at 60 from one to the other.
    planted = truth.planted[:-2:2] & truth.planted[1:-1:2] & truth.planted[2::2]
    moving = truth.moving[:-2:2]
    assert planted.mean() > 0.2
    assert moving.mean() > 0.05
    assert contacts[planted].all()
    assert not contacts[moving].any()
