"""SMPL's joints, and skeletons in general."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dancedata.core.errors import UsageError
from dancedata.core.skeleton import SMPL24, Skeleton
from tests.messages import raises_message


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


def test_mirrored_twice_is_the_same() -> None:
    once = SMPL24.mirrored()
    np.testing.assert_array_equal(once.offsets[1], SMPL24.offsets[2] * [-1, 1, 1])
    np.testing.assert_array_equal(once.mirrored().offsets, SMPL24.offsets)


def test_json_round_trip() -> None:
    back = Skeleton.from_json(json.loads(json.dumps(SMPL24.to_json())))
    np.testing.assert_array_equal(back.offsets, SMPL24.offsets)
    for name in ("name", "joints", "parents", "pairs", "feet"):
        assert getattr(back, name) == getattr(SMPL24, name)


def test_wrong_name_gets_the_closest() -> None:
    with raises_message(UsageError, "left_kne"):
        SMPL24.index("left_kne")


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
