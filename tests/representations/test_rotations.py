"""edge151, fact219, lodge139, lodge319 and finedance319: columns, floors, contacts, and what is refused."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from dancedata.contacts.height import Height
from dancedata.contacts.velocity import Velocity
from dancedata.core.bodies import BODY_JOINTS, SMPLX22, SMPLX52, SMPLX55
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.aistpp import AistPP
from dancedata.representations.edge151 import Edge151
from dancedata.representations.fact219 import Fact219
from dancedata.representations.finedance319 import FineDance319
from dancedata.representations.lodge139 import Lodge139
from dancedata.representations.lodge319 import Lodge319
from tests.messages import raises_message

THIRTY, SIXTY = FrameGrid.of(30), FrameGrid.of(60)
EDGE, FACT, FINE = Edge151(), Fact219(), FineDance319()
LODGES = pytest.mark.parametrize("made", [Lodge139(), Lodge319()], ids=lambda m: m.name)


def random_motion(skeleton: Skeleton, n: int = 6, trim: int = 0) -> Motion:
    rng = np.random.default_rng(2)
    rotations = rng.normal(0, 0.3, (n, skeleton.n_joints, 3))
    return Motion(np.add(rng.normal(0, 0.2, (n, 3)), (0, 1.2, 0)), rotations, THIRTY, skeleton, trim)


@pytest.mark.parametrize("made", [EDGE, Lodge139(), Lodge319()], ids=lambda m: m.name)
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


@LODGES
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


def test_other_skeletons_are_refused() -> None:
    other = replace(SMPL24, name="other", joints=("hips", *SMPL24.joints[1:]))
    with raises_message(UsageError, "smpl24"):
        EDGE.encode(Motion(np.zeros((1, 3)), np.zeros((1, 24, 3)), THIRTY, other), Velocity())
    with raises_message(UsageError, "contact"):
        EDGE.encode(random_motion(SMPL24))


def test_finedance_leaves_out_jaw_and_eyes() -> None:
    motion = random_motion(SMPLX52, 8)
    with_face = np.insert(motion.rotations, [22, 22, 22], 0.7, axis=1)
    whole = Motion(motion.translation, with_face, THIRTY, SMPLX55)
    np.testing.assert_array_equal(FINE.encode(whole, Velocity()), FINE.encode(motion, Velocity()))


# ---- FACT's whole matrices


def test_facts_columns(peers: Any) -> None:
    golden = peers.load("fact_motion.npz")
    dataset = AistPP(ignore="none")
    refs = dataset.scan(peers / "inputs" / "edge_aistpp").clips
    assert {f"{ref.id}.219" for ref in refs} == {key for key in golden if key.endswith(".219")}
    for ref in refs:
        motion = dataset.load(ref)
        assert motion.grid.rate == FACT.rate == Fraction(60)
        array = FACT.encode(motion)
        found, wanted = golden.pair(f"{ref.id}.219", array[:240])
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5)
        padded = golden[f"{ref.id}.225"]
        first = array[golden.index(f"{ref.id}.225")]
        np.testing.assert_allclose(first, padded[:, 6:], rtol=0, atol=1e-5)
        np.testing.assert_array_equal(padded[:, :6], 0)


def test_fact_holds_no_contacts() -> None:
    with raises_message(UsageError, "contacts"):
        FACT.encode(random_motion(SMPL24), Velocity())


def test_decoding_facts_columns_that_are_no_rotations() -> None:
    array = FACT.encode(random_motion(SMPL24))
    with raises_message(UsageError, "decodes"):
        FACT.decode(np.pad(array, [(0, 0), (6, 0)]), SIXTY)
    knee = slice(3 + 9 * 4, 3 + 9 * 5)
    for change, reason in (
        (lambda m: m * 0, "bad_rotation"),
        (lambda m: m * 1.001, "bad_rotation"),
        (lambda m: m * -1, "bad_rotation"),  # a reflection
        (lambda m: m[[1, 0, 2, 3, 4, 5, 6, 7, 8]], "bad_rotation"),
        (lambda m: m * np.nan, "nan"),
    ):
        broken = array.copy()
        broken[3, knee] = change(broken[3, knee])
        with raises_message(DataError, "infinity|project", reason=reason) as error:
            FACT.decode(broken, SIXTY)
        if reason == "bad_rotation":
            assert "fact219, frame 3, left_knee" in str(error.value)
    broken = array.copy()
    broken[0, 0] = np.inf
    with raises_message(DataError, "infinity", where="fact219", reason="nan"):
        FACT.decode(broken, SIXTY)
