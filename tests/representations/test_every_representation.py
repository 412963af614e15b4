"""Properties that every registered representation has to have; none is named here."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.ground import grounded
from dancedata.core.motion import Motion
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.testing.examples import contact_rule_of
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)
NAMES = REPRESENTATIONS.names()
#: Those that decode to the motion itself; others only to one with the same positions, on their own body, or from
#: another place.
DECODED = [
    name
    for name, made in ((name, REPRESENTATIONS.get(name)) for name in NAMES)
    if made.decodes and not made.positions_only and not (made.spatial is not None and made.spatial.placeless)
]
#: Those whose joints are known: of others the mirror is proved by the reflected motion alone.
WITH_JOINTS = [
    name
    for name, made in ((name, REPRESENTATIONS.get(name)()) for name in NAMES)
    if made.decodes or "position" in made.columns.names
]
FLIP = np.array([-1.0, 1.0, 1.0])
#: Turns where axis-angle is delicate.
TURNS = (0.0, 1e-9, 1e-5, np.pi - 1e-7, np.pi, np.pi + 1e-7, 2 * np.pi, 3 * np.pi, 4 * np.pi)

seeds = st.integers(0, 2**31)


def random_motion(seed: int, skeleton: Skeleton, n: int = 4, trim: int = 0) -> Motion:
    """Any rotations at all, wrapped ones too, within 10 m of the origin."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(n, skeleton.n_joints, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    turns = rng.uniform(0, 4 * np.pi, axes.shape[:2])
    special = rng.random(turns.shape) < 0.3
    turns[special] = rng.choice(TURNS, special.sum())
    return Motion(rng.uniform(-10, 10, (n, 3)), axes * turns[..., None], THIRTY, skeleton, trim)


def other_side(skeleton: Skeleton) -> list[int]:
    order = list(range(skeleton.n_joints))
    for left, right in skeleton.pairs:
        order[left], order[right] = right, left
    return order


@pytest.mark.parametrize("name", DECODED)
@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(0, 3))
def test_decoding_undoes_encoding(name: str, seed: int, trim: int) -> None:
    made = REPRESENTATIONS.get(name)()
    motion = random_motion(seed, made.skeleton, trim=trim)
    array = made.encode(motion, contact_rule_of(made))
    back = made.decode(array, THIRTY)
    assert (back.grid, back.skeleton) == (THIRTY, made.skeleton)
    # A representation that grounds gives back the grounded motion.
    wanted = grounded(motion) if made.grounded else motion
    angle = (
        Rotation.from_rotvec(back.rotations.copy()).inv() * Rotation.from_rotvec(wanted.rotations.copy())
    ).magnitude()
    assert angle.max() < 1e-6
    np.testing.assert_allclose(back.translation, wanted.translation, atol=2e-6)  # float32 at 20 m
    assert np.linalg.norm(back.rotations, axis=-1).max() <= np.pi + 1e-9
    again = made.encode(Motion(back.translation, back.rotations, THIRTY, made.skeleton, trim), contact_rule_of(made))
    motion_columns = [j for j, label in enumerate(made.columns.labels) if not label.startswith("contact.")]
    np.testing.assert_allclose(again[:, motion_columns], array[:, motion_columns], atol=4e-6)


@pytest.mark.parametrize("name", WITH_JOINTS)
@settings(max_examples=20, deadline=None)
@given(seeds)
def test_mirrored_columns_on_the_mirrored_body_are_the_reflection(name: str, seed: int) -> None:
    made = REPRESENTATIONS.get(name)()
    array = made.encode(random_motion(seed, made.skeleton), contact_rule_of(made))
    image = made.columns.mirror.apply(array)
    if made.decodes:
        plain = made.decode(array, THIRTY).joints()
        mirrored = made.decode(image, THIRTY)
        mirrored = (mirrored if made.positions_only else mirrored.on(made.skeleton.mirrored())).joints()
    else:
        # Without a decoder it has to hold the positions themselves, or nothing proves its mirror.
        plain, mirrored = (x[:, made.columns.slice("position")].reshape(len(x), -1, 3) for x in (array, image))
    np.testing.assert_allclose(mirrored, plain[:, other_side(made.skeleton)] * FLIP, atol=1e-5)


@pytest.mark.parametrize(
    "name", [name for name in DECODED if "rotation_6d" in REPRESENTATIONS.get(name)().columns.names]
)
def test_decoding_what_is_not_a_motion(name: str) -> None:
    made = REPRESENTATIONS.get(name)()
    array = made.encode(random_motion(0, made.skeleton), contact_rule_of(made))
    with raises_message(UsageError, f"{name} decodes"):
        made.decode(array[:, :-1], THIRTY)
    first = made.columns.slice("rotation_6d").start
    place = made.columns.slice("translation").start + 1
    for columns, value, reason in (
        (slice(first + 24, first + 30), 0, "bad_rotation"),
        (first + 33, np.nan, "nan"),
        (first + 33, np.inf, "nan"),
        (place, np.inf, "nan"),
    ):
        broken = array.copy()
        broken[3, columns] = value
        where = f"{name}, frame 3, left_knee" if reason == "bad_rotation" else name
        with raises_message(DataError, "infinity|plane", where=where, reason=reason):
            made.decode(broken, THIRTY)


@pytest.mark.parametrize("name", NAMES)
def test_contacts_change_sides_and_nothing_else(name: str) -> None:
    made = REPRESENTATIONS.get(name)()
    if "contact" not in made.columns.names:
        assert made.default_contacts is None
        return
    feet = made.columns.slice("contact")
    labels = made.columns.labels[feet]
    # All sixteen combinations.
    array = np.zeros((16, made.columns.width), np.float32)
    array[:, feet] = (np.arange(16)[:, None] >> np.arange(4)) & 1
    image = made.columns.mirror.apply(array)
    for j, label in enumerate(labels):
        there = label.replace("left", "LEFT").replace("right", "left").replace("LEFT", "right")
        assert there != label
        np.testing.assert_array_equal(image[:, feet][:, j], array[:, feet][:, labels.index(there)])
