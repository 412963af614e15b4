"""lodge139 and lodge319: grounding, trims, contacts, what decoding refuses."""

from typing import Any

import numpy as np
import pytest

from dancedata.contacts.height import Height
from dancedata.contacts.velocity import Velocity
from dancedata.core.bodies import BODY_JOINTS, SMPLX22
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.representations.lodge139 import Lodge139
from dancedata.representations.lodge319 import Lodge319
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)
BOTH = pytest.mark.parametrize("made", [Lodge139(), Lodge319()], ids=lambda m: m.name)


def random_motion(skeleton: Skeleton, n: int = 6, trim: int = 0) -> Motion:
    rng = np.random.default_rng(2)
    rotations = rng.normal(0, 0.3, (n, skeleton.n_joints, 3))
    return Motion(np.add(rng.normal(0, 0.2, (n, 3)), (0, 1.2, 0)), rotations, THIRTY, skeleton, trim)


@BOTH
def test_columns(made: Any) -> None:
    joints = made.skeleton.joints
    assert made.columns.names == ("contact", "translation", "rotation_6d")
    assert made.columns.width == 7 + 6 * len(joints)
    assert made.columns.labels[:7] == (
        "contact.left_ankle", "contact.right_ankle", "contact.left_foot", "contact.right_foot",
        "translation.x", "translation.y", "translation.z",
    )  # fmt: skip
    assert made.columns.labels[7 + 6 * 21 + 2] == "rotation_6d.right_wrist.0z"
    assert made.columns.labels[-1] == f"rotation_6d.{joints[-1]}.1z"
    assert joints[:22] == BODY_JOINTS


@BOTH
def test_plus_y_stays_up_and_the_toes_stand_on_the_floor(made: Any) -> None:
    """At rest the toes lie at -1.28398 and -1.28675 m (FACTS 7), so the floor is their mean."""
    motion = Motion(np.array([[1.0, 7.0, 3.0]]), np.zeros((1, made.skeleton.n_joints, 3)), THIRTY, made.skeleton)
    row = made.encode(motion, Height())[0]
    np.testing.assert_allclose(row[4:7], [1, (1.28398 + 1.28675) / 2, 3], atol=1e-6)
    np.testing.assert_allclose(row[7:], np.tile([1, 0, 0, 0, 1, 0], made.skeleton.n_joints), atol=1e-7)
    np.testing.assert_array_equal(row[:4], 1)  # ankles 6 cm above the toes


@BOTH
@pytest.mark.parametrize("trim", [0, 3, 5])
def test_the_floor_is_that_of_the_first_frame_of_the_dance(made: Any, trim: int) -> None:
    motion = random_motion(made.skeleton, trim=trim)
    array = made.encode(motion, Height())
    assert len(array) == 6  # frames before the cut are encoded too
    # Lodge cuts first and grounds then: from the cut on the rows are the same.
    np.testing.assert_array_equal(array[trim:], made.encode(motion.part(trim, 6), Height()))
    decoded = made.decode(array, THIRTY)
    toes = decoded.joints()[trim, [10, 11], 1]
    assert abs(toes[0] - toes[1]) > 0.02
    assert toes.min() == pytest.approx(0, abs=1e-6)


@BOTH
def test_contacts_see_the_grounded_joints(made: Any) -> None:
    seen = []

    class Rule:
        def __call__(self, joints: np.ndarray, grid: FrameGrid, skeleton: Skeleton) -> np.ndarray:
            seen.append((joints, grid, skeleton))
            return np.arange(24, dtype=np.float32).reshape(6, 4)

    motion = random_motion(made.skeleton)
    array = made.encode(motion, Rule())
    np.testing.assert_array_equal(array[:, :4], np.arange(24).reshape(6, 4))
    ((joints, grid, skeleton),) = seen
    assert (grid, skeleton) == (THIRTY, made.skeleton)
    np.testing.assert_allclose(joints, made.decode(array, THIRTY).joints(), atol=1e-5)
    # Speeds do not care about the floor.
    np.testing.assert_array_equal(
        made.encode(motion, Velocity())[:, :4], Velocity()(motion.joints(), THIRTY, made.skeleton)
    )
    with raises_message(UsageError, "contact"):
        made.encode(motion)


def test_smpls_translation_is_kept_on_smplx() -> None:
    """As Lodge does with AIST++: the same numbers, on the other body, whose feet then decide the floor."""
    motion = random_motion(SMPL24)
    array = Lodge139().encode(motion, Height())
    np.testing.assert_allclose(array[:, [4, 6]], motion.translation[:, [0, 2]], atol=1e-6)
    on_smplx = Motion(motion.translation, motion.rotations[:, :22], THIRTY, SMPLX22)
    np.testing.assert_array_equal(array, Lodge139().encode(on_smplx, Height()))
