"""Contacts by height."""

import numpy as np
import pytest

from dancedata.contacts.height import Height
from dancedata.core.bodies import SMPLX52
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24, Skeleton
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


@pytest.mark.parametrize("name", ["ankle_m", "toe_m"])
@pytest.mark.parametrize("limit", [0, -0.1, float("nan"), float("inf")])
def test_wrong_limits(name: str, limit: float) -> None:
    with raises_message(UsageError, "floor"):
        Height(**{name: limit})
