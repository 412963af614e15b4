"""Skeletons, SMPL's and SMPL-X's joints, and motions carried over between the bodies of the SMPL family."""

from dataclasses import replace

import numpy as np
import pytest

from dancedata.core.bodies import (
    BODY_JOINTS,
    MOTORICA21,
    SKELETONS,
    SMPLH52,
    SMPLX22,
    SMPLX52,
    SMPLX55,
    has_body,
    transfer,
    transfer_to,
)
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.representations.humanml263 import Humanml263
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)
SMPL_FAMILY = [skeleton for skeleton in SKELETONS.values() if has_body(skeleton)]


def rest(skeleton: Skeleton) -> np.ndarray:
    """Joints (J, 3) at rest, by walking up the tree."""
    positions = np.zeros((skeleton.n_joints, 3))
    for joint in range(skeleton.n_joints):
        at = joint
        while at != -1:
            positions[joint] += skeleton.offsets[at]
            at = skeleton.parents[at]
    return positions


def motion_on(skeleton: Skeleton, trim: int = 0) -> Motion:
    rng = np.random.default_rng(5)
    return Motion(rng.normal(size=(4, 3)), rng.normal(size=(4, skeleton.n_joints, 3)), THIRTY, skeleton, trim)


def test_smplx55_is_as_published() -> None:
    # Order, parents and some rest positions of FACTS 7, retyped.
    assert SMPLX55.n_joints == 55
    assert SMPLX55.joints[:22] == SMPL24.joints[:22] == BODY_JOINTS
    assert SMPLX55.parents[:22] == SMPL24.parents[:22]
    for index, name, parent in (
        (22, "jaw", 15), (23, "left_eye", 15), (24, "right_eye", 15), (25, "left_index1", 20),
        (26, "left_index2", 25), (28, "left_middle1", 20), (31, "left_pinky1", 20), (34, "left_ring1", 20),
        (39, "left_thumb3", 38), (40, "right_index1", 21), (46, "right_pinky1", 21), (52, "right_thumb1", 21),
        (54, "right_thumb3", 53),
    ):  # fmt: skip
        assert (SMPLX55.joints[index], SMPLX55.parents[index]) == (name, parent)
    positions = rest(SMPLX55)
    for index, position in (
        (0, (0.00312, -0.35141, 0.01204)),
        (7, (0.07255, -1.22598, -0.05524)),
        (24, (-0.03160, 0.31083, 0.06219)),
        (39, (0.74837, 0.01415, 0.00543)),
        (54, (-0.74837, 0.01415, 0.00543)),
    ):
        np.testing.assert_allclose(positions[index], position, atol=1e-12)
    assert SMPLX55.feet == (7, 8, 10, 11)


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=lambda s: s.name)
def test_sides_are_swapped_by_name(skeleton: Skeleton) -> None:
    assert SKELETONS[skeleton.name] is skeleton
    for left, right in skeleton.pairs:
        assert skeleton.joints[left].lower().replace("left", "right") == skeleton.joints[right].lower()
    sides = [name for name in skeleton.joints if name.lower().startswith(("left", "right"))]
    assert len(sides) == 2 * len(skeleton.pairs)
    assert has_body(skeleton) == (skeleton is not MOTORICA21)


def test_a_part_joins_bones_across_joints_left_out() -> None:
    without_spine = SMPLX22.subset("bent", tuple(j for j in BODY_JOINTS if j not in ("spine2", "neck")))
    by_name = dict(zip(SMPLX22.joints, rest(SMPLX22), strict=True))
    np.testing.assert_allclose(rest(without_spine), [by_name[j] for j in without_spine.joints], atol=1e-12)
    assert without_spine.joints[without_spine.parents[without_spine.index("head")]] == "spine3"
    for joints in (BODY_JOINTS[1:], BODY_JOINTS[:11], BODY_JOINTS[::-1]):
        with raises_message(UsageError, "smplx22"):
            SMPLX22.subset("bad", joints)
    with raises_message(UsageError, "left_hipp"):
        SMPLX22.subset("bad", ("pelvis", "left_hipp"))


@pytest.mark.parametrize("target", SMPL_FAMILY, ids=lambda s: s.name)
@pytest.mark.parametrize("source", SMPL_FAMILY, ids=lambda s: s.name)
def test_parameters_are_carried_over_by_name(source: Skeleton, target: Skeleton) -> None:
    motion = motion_on(source, trim=2)
    found = transfer(motion, target)
    assert found.skeleton.joints == target.joints
    assert (found.grid, found.trim_start) == (THIRTY, 2)
    pelvis = [m.translation + m.skeleton.offsets[0] for m in (found, motion)]
    np.testing.assert_allclose(pelvis[0], pelvis[1], atol=1e-12)
    kept = transfer_to(motion, target, keep="translation")
    np.testing.assert_array_equal(kept.translation, motion.translation)
    np.testing.assert_array_equal(kept.rotations, found.rotations)
    for j, joint in enumerate(target.joints):
        there = motion.rotations[:, source.joints.index(joint)] if joint in source.joints else np.zeros((4, 3))
        np.testing.assert_array_equal(found.rotations[:, j], there)
    if source.joints == target.joints:
        assert found is motion
    else:
        assert found.skeleton is target


def test_an_own_body_keeps_its_bones() -> None:
    tall = replace(SMPLX55, name="tall", offsets=SMPLX55.offsets * 1.2)
    for target in (SMPLX52, SMPLX22):
        found = transfer(motion_on(tall), target)
        np.testing.assert_allclose(rest(found.skeleton), 1.2 * rest(target), atol=1e-12)
        assert found.skeleton.name == f"tall-{target.n_joints}"
        # The joints stand where the whole body's do.
        np.testing.assert_allclose(found.joints()[:, :22], motion_on(tall).joints()[:, :22], atol=1e-12)
        # On the target's bones if requested.
        assert transfer_to(motion_on(tall), target).skeleton is target
    # SMPL's hands are not joints of SMPL-X, so the bones are SMPL's; the other way round, SMPL-X's.
    assert transfer(motion_on(tall), SMPL24).skeleton is SMPL24
    assert (
        transfer(motion_on(replace(SMPL24, name="mine", offsets=SMPL24.offsets * 1.2)), SMPLX22).skeleton is SMPLX22
    )


def test_other_families_are_refused() -> None:
    other = replace(SMPL24, name="other", joints=("hips", *SMPL24.joints[1:]))
    assert not has_body(other)
    for motion, target in ((motion_on(other), SMPLX22), (motion_on(SMPLX22), other)):
        with raises_message(UsageError, "smplx22"):
            transfer(motion, target)
    # Its own joints are fine, in any family.
    same = replace(other, offsets=other.offsets * 2)
    motion = motion_on(other)
    assert transfer(motion, same) is motion


def test_smplhs_mean_body_is_smpls() -> None:
    """As SMPL's 24 joints do: both bodies put a dance on SMPL-X's bones in the same place."""
    motion = motion_on(SMPL24)
    smplh = transfer_to(motion, SMPLH52)
    np.testing.assert_array_equal(smplh.joints()[:, :22], motion.joints()[:, :22])
    for target in (SMPLX22, SMPLX52, SMPLX55):
        assert transfer(smplh, target).skeleton is target
        np.testing.assert_array_equal(transfer(smplh, target).joints(), transfer(motion, target).joints())
    own = replace(SMPLH52, offsets=SMPLH52.offsets * 1.2)
    assert transfer(motion_on(own), SMPLX52).skeleton is own


def test_a_skeleton_of_another_family_is_sent_to_retarget() -> None:
    motion = Motion(np.zeros((3, 3)), np.zeros((3, 21, 3)), FrameGrid.of(30), MOTORICA21)
    for call in (lambda: transfer_to(motion, SMPLX22), lambda: Humanml263().encode(motion)):
        with raises_message(UsageError, "transforms.retarget.skeleton=smpl24"):
            call()


def test_smpl24() -> None:
    # Joint order and parents of FACTS 7, retyped.
    assert SMPL24.n_joints == 24
    assert SMPL24.parents == (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
    for index, name in ((0, "pelvis"), (4, "left_knee"), (11, "right_foot"), (13, "left_collar"), (23, "right_hand")):
        assert SMPL24.joints[index] == name
        assert SMPL24.index(name) == index
    assert SMPL24.feet == (7, 8, 10, 11)
    np.testing.assert_array_equal(SMPL24.offsets[0], [-0.00217368, -0.24078918, 0.02858379])
    np.testing.assert_array_equal(SMPL24.offsets[8], [0.01905555, -0.4200455, -0.03456167])
    assert not SMPL24.offsets.flags.writeable


@pytest.mark.parametrize(
    "change",
    [
        {"parents": (-1, *range(22))}, {"offsets": np.zeros((24, 2))}, {"parents": (0, *SMPL24.parents[1:])},
        {"parents": (-1, 5, *SMPL24.parents[2:])}, {"parents": (-1, -1, *SMPL24.parents[2:])},
    ],
    ids=["number", "offsets", "no root", "child before its parent", "two roots"],
)  # fmt: skip
def test_no_tree(change: dict[str, object]) -> None:
    with raises_message(UsageError, "smpl24"):
        replace(SMPL24, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "wrong", [{"feet": (7, 8, 10, 24)}, {"pairs": ((1, 24),)}, {"pairs": ((1, 2), (2, 4))}, {"feet": (-1, 8, 10, 11)}]
)
def test_pairs_and_feet_are_joints(wrong: dict[str, object]) -> None:
    with raises_message(UsageError, "requires"):
        replace(SMPL24, **wrong)  # type: ignore[arg-type]
