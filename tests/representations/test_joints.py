"""joints and bailando72: positions."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.contacts.height import Height
from dancedata.core.bodies import SKELETONS, SMPLX22, SMPLX52, SMPLX55
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.representations.bailando72 import Bailando72
from dancedata.representations.joints import Joints
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)
#: Nobody's body: a root, two arms and a tail.
ANIMAL = Skeleton(
    "animal",
    ("root", "arm_l", "arm_r", "tail"),
    (-1, 0, 0, 0),
    np.array([[0.1, 0.9, 0.0], [0.3, 0.1, 0.0], [-0.2, 0.1, 0.05], [0.0, -0.2, -0.5]]),
    ((1, 2),),
    (1, 2, 1, 2),
)


def random_motion(skeleton: Skeleton) -> Motion:
    rng = np.random.default_rng(9)
    return Motion(rng.normal(size=(4, 3)), rng.normal(size=(4, skeleton.n_joints, 3)), THIRTY, skeleton)


@pytest.mark.parametrize("body", [*SKELETONS, ANIMAL.to_json()], ids=lambda b: b if isinstance(b, str) else b["name"])
def test_positions_of_any_skeleton(body: Any) -> None:
    made = Joints(body)
    motion = random_motion(made.skeleton)
    array = made.encode(motion)
    assert array.dtype == np.float32
    np.testing.assert_allclose(array.reshape(4, -1, 3), motion.joints(), atol=1e-6)
    labels = made.columns.labels
    assert labels[3:6] == tuple(f"position.{made.skeleton.joints[1]}.{axis}" for axis in "xyz")
    # The mirror image is the reflection, sides swapped.
    order = list(range(made.skeleton.n_joints))
    for left, right in made.skeleton.pairs:
        order[left], order[right] = right, left
    image = made.columns.mirror.apply(array).reshape(4, -1, 3)
    np.testing.assert_array_equal(image, array.reshape(4, -1, 3)[:, order] * np.float32([-1, 1, 1]))
    assert not made.decodes


def test_the_motions_own_bones() -> None:
    tall = replace(SMPLX55, name="tall", offsets=SMPLX55.offsets * 1.2)
    motion = random_motion(tall)
    np.testing.assert_allclose(Joints("smplx55").encode(motion).reshape(4, 55, 3), motion.joints(), atol=1e-6)
    np.testing.assert_allclose(Joints("smplx22").encode(motion).reshape(4, 22, 3), motion.joints()[:, :22], atol=1e-6)
    # SMPL's 24 put on SMPL-X take SMPL-X's bones.
    motion = random_motion(SMPL24)
    pelvis = motion.translation + SMPL24.offsets[0]  # which stays where it is
    wanted = Motion(pelvis - SMPLX22.offsets[0], motion.rotations[:, :22], THIRTY, SMPLX22).joints()
    np.testing.assert_allclose(Joints("smplx22").encode(motion).reshape(4, 22, 3), wanted, atol=1e-6)


def test_a_skeleton_spelled_out_survives_json() -> None:
    body = json.loads(json.dumps(ANIMAL.to_json()))
    made = Joints(body)
    np.testing.assert_array_equal(made.skeleton.offsets, ANIMAL.offsets)
    assert made == Joints(ANIMAL.to_json())
    assert made != Joints()
    array = dancedata.encode(random_motion(ANIMAL), "joints", body=body)
    np.testing.assert_array_equal(array, made.encode(random_motion(ANIMAL)))
    np.testing.assert_array_equal(
        dancedata.encode(random_motion(SMPLX52), "joints", body="smplx52"),
        Joints("smplx52").encode(random_motion(SMPLX52)),
    )


def broken(**changes: Any) -> dict[str, Any]:
    return {**ANIMAL.to_json(), **changes}


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("smplx2", r"'smplx2'.*Did you mean 'smplx\d\d'"),
        ({}, "body is not a valid skeleton.*'feet'"),
        (broken(offsets=[[0, 0, 0], [1]]), "body is not a valid skeleton"),
        (broken(pairs=[[1, 9]]), "each joint in at most one pair"),
        (broken(pairs=[[1]]), "body is not a valid skeleton"),
        (broken(feet=[1]), "body is not a valid skeleton"),
    ],
)
def test_invalid_skeletons(body: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Joints(body)


def test_unsupported_motions_are_refused() -> None:
    with raises_message(UsageError, "animal"):
        Joints().encode(random_motion(ANIMAL))
    for made in (Joints(), Bailando72()):
        with raises_message(UsageError, "contacts"):
            made.encode(random_motion(SMPL24), Height())
