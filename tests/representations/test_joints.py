"""joints, bailando72 and root_place: positions."""

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
from dancedata.core.placement import Placement, centroid, moved, moved_rows
from dancedata.core.registry import CONTACTS, REPRESENTATIONS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.representations.bailando72 import Bailando72
from dancedata.representations.joints import Joints
from dancedata.representations.root_place import RootPlace
from dancedata.synthetic import synthesise_motion
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


# ---- places of roots


PLACE, HML = RootPlace(), REPRESENTATIONS.make("humanml263", {})


@pytest.fixture(scope="module")
def pair() -> list[Motion]:
    """Two dancers 1.2 m apart, the second turned by 140 degrees and carried 60 cm up."""
    first = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=181)[0].resampled(FrameGrid.of(20))
    second = moved(first, Placement(np.radians(140), 1.2, 0.3))
    return [first, replace(second, translation=np.add(second.translation, (0, 0.6, 0)))]


@pytest.mark.parametrize("first", [0, 1, 17, 30])
def test_a_pair_comes_back_from_columns_without_places(pair: list[Motion], first: int) -> None:
    floor = min(HML.floor(motion) for motion in pair)
    columns = [HML.encode_above(motion, floor) for motion in pair]
    # Turned and shifted copies: only the height of the one who is carried differs.
    np.testing.assert_allclose(columns[0][:, :3], columns[1][:, :3], atol=1e-5)
    lift = columns[1][:, 3] - columns[0][:, 3]
    assert np.ptp(lift) < 1e-5
    assert 0.55 < lift[0] < 0.65
    np.testing.assert_allclose(columns[0], HML.encode(pair[0]), atol=1e-6)
    placed = []
    for motion, rows in zip(pair, columns, strict=True):
        decoded = HML.decode(rows[first:], FrameGrid.of(20))
        places = PLACE.encode(motion)[first:][: decoded.n_frames]
        placed.append(PLACE.placed(decoded, places))
        np.testing.assert_allclose(placed[-1].joints()[0, 0], motion.joints()[first, 0], atol=1e-5)
        np.testing.assert_allclose(PLACE.encode(placed[-1])[0], places[0], atol=1e-5)
    apart = [m.joints()[0, 0] for m in placed]
    true = [m.joints()[first, 0] for m in pair]
    np.testing.assert_allclose(apart[1] - apart[0], true[1] - true[0], atol=1e-5)


def test_pairwise_distances_stay_under_one_change_of_the_group(pair: list[Motion]) -> None:
    rows = np.stack([PLACE.encode(motion) for motion in pair])
    distance = np.linalg.norm(rows[1, :, :3] - rows[0, :, :3], axis=-1)
    mirrored = [PLACE.columns.mirror.apply(r) for r in rows]
    about = centroid(rows[:, 0, :3])
    assert PLACE.spatial is not None
    turned = [moved_rows(PLACE.spatial, r, PLACE.columns, Placement(2.0, 0.4, -1.0), about) for r in rows]
    for changed in (mirrored, turned):
        after = np.linalg.norm(changed[1][:, :3] - changed[0][:, :3], axis=-1)
        np.testing.assert_allclose(after, distance, atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(changed[0][:, 3:], axis=1), 1, atol=1e-6)
    # As the motion itself, turned and shifted.
    whole = moved(pair[0], Placement(2.0, 0.4, -1.0))
    np.testing.assert_allclose(
        moved_rows(PLACE.spatial, rows[0], PLACE.columns, Placement(2.0, 0.4, -1.0)), PLACE.encode(whole), atol=2e-6
    )


def test_who_lies_on_his_side_keeps_his_facing() -> None:
    rotations = np.zeros((3, 24, 3))
    rotations[1:, 0, 2] = np.pi / 2
    offsets = np.array(SMPL24.offsets)
    offsets[[1, 2, 16, 17], 1:] = 0
    level = Skeleton("level", SMPL24.joints, SMPL24.parents, offsets, SMPL24.pairs, SMPL24.feet)
    rows = PLACE.encode(Motion(np.zeros((3, 3)), rotations, FrameGrid.of(20), level))
    np.testing.assert_allclose(np.linalg.norm(rows[:, 3:], axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("bad", [np.zeros((3, 6)), np.zeros((61, 3))])
def test_rows_that_do_not_fit(pair: list[Motion], bad: Any) -> None:
    with raises_message(UsageError, "rows"):
        PLACE.placed(pair[0], bad)
    with raises_message(UsageError, "root_place"):
        PLACE.encode(pair[0], CONTACTS.make("velocity", {}))
