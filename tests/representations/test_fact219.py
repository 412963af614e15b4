"""fact219: FACT's own numbers, whole matrices, exact decoding."""

from fractions import Fraction
from typing import Any

import numpy as np

from dancedata.contacts.velocity import Velocity
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.aistpp import AistPP
from dancedata.representations.fact219 import Fact219
from tests.messages import raises_message

SIXTY = FrameGrid.of(60)
FACT = Fact219()


def random_motion() -> Motion:
    rng = np.random.default_rng(7)
    return Motion(rng.normal(size=(5, 3)), rng.normal(size=(5, 24, 3)) * 1.5, SIXTY, SMPL24)


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


def test_layout() -> None:
    assert FACT.columns.names == ("translation", "rotation_matrix")
    assert FACT.columns.width == 219
    assert FACT.columns.labels[3 + 9 * 4 + 5] == "rotation_matrix.left_knee.1z"
    # A quarter turn about z of the left knee takes x to y: entry (0, 1) is -1, (1, 0) is 1.
    rotations = np.zeros((1, 24, 3))
    rotations[0, 4, 2] = np.pi / 2
    row = FACT.encode(Motion(np.array([[1.0, 2.0, 3.0]]), rotations, SIXTY, SMPL24))[0]
    assert row[:3].tolist() == [1, 2, 3]
    np.testing.assert_allclose(row[39:48], [0, -1, 0, 1, 0, 0, 0, 0, 1], atol=1e-7)


def test_it_holds_no_contacts() -> None:
    with raises_message(UsageError, "contacts"):
        FACT.encode(random_motion(), Velocity())


def test_decoding_invalid_rotations() -> None:
    array = FACT.encode(random_motion())
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
