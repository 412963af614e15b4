"""edge151: EDGE's own numbers, exact decoding, mirroring."""

from dataclasses import replace

import numpy as np

from dancedata.contacts.velocity import Velocity
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.representations.edge151 import Edge151
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)
EDGE = Edge151()


def encode(motion: Motion) -> np.ndarray:
    return EDGE.encode(motion, Velocity())


def random_motion(seed: int, n: int = 5, size: float = 1.5) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(rng.normal(size=(n, 3)), rng.normal(size=(n, 24, 3)) * size, THIRTY, SMPL24)


def test_columns() -> None:
    columns = EDGE.columns
    assert columns.width == 151
    assert columns.names == ("contact", "translation", "rotation_6d")
    assert columns.labels[:7] == (
        "contact.left_ankle", "contact.right_ankle", "contact.left_foot", "contact.right_foot",
        "translation.x", "translation.y", "translation.z",
    )  # fmt: skip
    assert columns.labels[7 + 6 * 4] == "rotation_6d.left_knee.0x"


def test_contacts_are_those_of_the_rule() -> None:
    class Rule:
        def __call__(self, joints: np.ndarray, grid: FrameGrid, skeleton: object) -> np.ndarray:
            assert joints.shape == (5, 24, 3)
            assert grid == THIRTY
            return np.arange(20, dtype=np.float32).reshape(5, 4)

    array = EDGE.encode(random_motion(0), Rule())  # type: ignore[arg-type]
    np.testing.assert_array_equal(array[:, :4], np.arange(20).reshape(5, 4))
    with raises_message(UsageError, "contact"):
        EDGE.encode(random_motion(0))


def test_other_skeletons_are_refused() -> None:
    other = replace(SMPL24, name="other", joints=("hips", *SMPL24.joints[1:]))
    with raises_message(UsageError, "smpl24"):
        encode(Motion(np.zeros((1, 3)), np.zeros((1, 24, 3)), THIRTY, other))
