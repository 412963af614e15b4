"""Augmentations of motions and of columns: forward kinematics commutes with each of them."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.augment.crop import Crop
from dancedata.augment.drop import Drop
from dancedata.augment.mirror import MirrorImage
from dancedata.augment.noise import JointNoise
from dancedata.augment.root_offset import RootOffset
from dancedata.augment.tempo import Tempo
from dancedata.augment.yaw import Yaw
from dancedata.building.transforms.copy import Copy
from dancedata.core.bodies import SMPLX55, has_body
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.placement import Placement, moved, moved_rows, require_roles
from dancedata.core.plugins import SampleField
from dancedata.core.registry import CONTACTS, REPRESENTATIONS
from dancedata.core.rotations import rotation
from dancedata.core.skeleton import SMPL24
from dancedata.testing.examples import FPS, contact_rule_of, example_fields, random_motion
from tests.messages import raises_message

NAMES = [name for name in REPRESENTATIONS.names() if REPRESENTATIONS.get(name).spatial is not None]
#: Those whose columns hold the dancer's place, so that decoding gives it back.
DECODED = [
    name
    for name in NAMES
    if REPRESENTATIONS.get(name).decodes and "place" in REPRESENTATIONS.get(name).spatial.roles.values()
]
ANGLES = st.floats(-np.pi, np.pi)
METRES = st.floats(-3, 3)
MOTION = random_motion(SMPL24, 20, turn_rad=0.6)
#: Metres that float32 columns lose on joints.
JOINT_TOLERANCE = 5e-6
few = settings(max_examples=20, deadline=None, derandomize=True)


def field_of(name: str) -> SampleField:
    made = REPRESENTATIONS.get(name)()
    grid = FPS if made.rate is None else FrameGrid(made.rate)
    return SampleField(name, "motion", made.columns, grid, made, contact_rule_of(made))


def encoded(name: str, by: Placement = Placement()) -> np.ndarray:  # noqa: B008 (frozen)
    made = REPRESENTATIONS.get(name)()
    motion = MOTION if has_body(made.skeleton) else random_motion(made.skeleton, 20, turn_rad=0.6)
    return made.encode(moved(motion, by), contact_rule_of(made))


def placed(joints: np.ndarray, root: np.ndarray, by: Placement) -> np.ndarray:
    """Positions (T, J, 3), +Y up, turned about the vertical through `root` and shifted, written out."""
    c, s = np.cos(by.turn_rad), np.sin(by.turn_rad)
    x, y, z = np.moveaxis(joints - root, -1, 0)
    return np.stack([c * x + s * z, y, -s * x + c * z], axis=-1) + root + (by.x_m, 0, by.z_m)


@few
@given(ANGLES, METRES, METRES)
def test_joints_of_a_moved_motion_are_the_moved_joints(angle: float, x: float, z: float) -> None:
    by = Placement(angle, x, z)
    for skeleton in (SMPL24, SMPLX55):
        motion = random_motion(skeleton, 5)
        joints = motion.joints()
        np.testing.assert_allclose(moved(motion, by).joints(), placed(joints, joints[0, 0], by), atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_moved_columns_are_those_of_the_moved_motion(name: str) -> None:
    made = REPRESENTATIONS.get(name)()
    for by in (Placement(), Placement(2.0), Placement(0, 0.3, -0.2), Placement(-1.1, -1.5, 2.5)):
        found = moved_rows(made.spatial, encoded(name), made.columns, by)
        np.testing.assert_allclose(found, encoded(name, by), atol=2e-6)
    still = moved_rows(made.spatial, encoded(name), made.columns, Placement())
    np.testing.assert_array_equal(still, encoded(name))


def test_directions_turn_and_do_not_shift() -> None:
    from dancedata.core.columns import Columns, Group, Spatial

    columns = Columns((Group("velocity", 6, "m/s"), Group("speed", 1, "m/s")))
    rows = np.array([[1, 2, 0, 0, 0, 3, 5]], np.float32)
    found = moved_rows(
        Spatial("y", {"velocity": "direction", "speed": "unchanged"}), rows, columns, Placement(np.pi / 2, 9)
    )
    np.testing.assert_allclose(found, [[0, 2, -1, 3, 0, 0, 5]], atol=1e-6)
    for roles in ({"velocity": "direction"}, {"velocity": "direction", "speed": "place"}):
        with raises_message(UsageError, "speed"):
            require_roles(Spatial("y", roles), columns)


@few
@given(st.integers(0, 2**32), st.floats(0, 10), st.floats(0.05, 2))
def test_noise_turns_joints_and_leaves_the_root(index: int, degrees: float, every_s: float) -> None:
    noise = JointNoise(std_degrees=degrees, every_s=every_s)
    rows, field = encoded("edge151"), field_of("edge151")
    made = field.representation.decode(noise.change_sample(rows, field, Draw(1, index)), FPS)
    clean = field.representation.decode(rows, FPS)
    np.testing.assert_allclose(made.translation, clean.translation, atol=1e-6)
    np.testing.assert_allclose(made.matrices[:, 0], clean.matrices[:, 0], atol=1e-6)
    turns = (rotation(clean.rotations[:, 1:]).inv() * rotation(made.rotations[:, 1:])).magnitude()
    assert turns.max() <= np.radians(degrees) * 12 + 1e-3
    assert degrees == 0 or turns.max() > 0


@pytest.mark.parametrize("name", DECODED)
def test_columns_with_noise_are_those_of_the_motion_with_noise(name: str) -> None:
    noise, field, made = JointNoise(std_degrees=5), field_of(name), REPRESENTATIONS.get(name)()
    rows = encoded(name)
    if field.contacts is not None:
        rows[:, made.columns.slice("contact")] = 0.5
    found = noise.change_sample(rows, field, Draw(3))
    clean = made.decode(rows, field.grid)
    motion = noise._noisy(clean, Draw(3))
    np.testing.assert_allclose(made.decode(found, field.grid).joints(), motion.joints(), atol=JOINT_TOLERANCE)
    if field.contacts is not None:  # labelled again, at the height that the columns had
        own = made.columns.slice("contact")
        np.testing.assert_array_equal(found[:, own], made.reencode(motion, field.contacts)[:, own])
        assert set(np.unique(found[:, own])) <= {0, 1}


def test_noise_is_a_function_of_time_and_joint() -> None:
    slow = Motion(np.zeros((30, 3)), np.zeros((30, 24, 3)), FPS, SMPL24)
    fast = Motion(np.zeros((60, 3)), np.zeros((60, 24, 3)), FrameGrid.of(60), SMPL24)
    body = Motion(np.zeros((30, 3)), np.zeros((30, 55, 3)), FPS, SMPLX55)
    noise = JointNoise()
    rotations = [noise._noisy(motion, Draw(5)).rotations for motion in (slow, fast, body)]
    np.testing.assert_allclose(rotations[0], rotations[1][::2], atol=1e-12)
    np.testing.assert_allclose(rotations[0][:, :22], rotations[2][:, :22], atol=1e-12)
    assert rotations[0][:, 1:].std() == pytest.approx(np.radians(2), rel=0.25)
    # A turn in the joints' own axes.
    moving = rotation(MOTION.rotations[:, 1:]).inv() * rotation(noise._noisy(MOTION, Draw(5)).rotations[:, 1:])
    still = rotation(rotations[0][: MOTION.n_frames, 1:])
    np.testing.assert_allclose(moving.as_matrix(), still.as_matrix(), atol=1e-9)


def test_turns_have_the_requested_range() -> None:
    """Uniform between minus and plus the limit."""
    degrees = np.degrees([Yaw(max_degrees=30)._turn(Draw(0, k)).turn_rad for k in range(2000)])
    assert np.abs(degrees).max() <= 30
    np.testing.assert_allclose(np.quantile(degrees, [0.05, 0.25, 0.5, 0.75, 0.95]), [-27, -15, 0, 15, 27], atol=2)


def test_shifts_are_uniform_over_a_disc() -> None:
    shifts = [RootOffset(max_m=2)._shift(Draw(0, k)) for k in range(2000)]
    x, z = np.array([(s.x_m, s.z_m) for s in shifts]).T
    assert not any(s.turn_rad for s in shifts)
    radius = np.hypot(x, z)
    assert radius.max() <= 2
    np.testing.assert_allclose(np.quantile(radius, [0.25, 0.5, 0.75]), [1, 2**0.5, 3**0.5], atol=0.06)
    assert abs(x.mean()) < 0.1 > abs(z.mean())


def test_every_speed_and_every_window_is_drawn() -> None:
    speeds = [Tempo(speeds=(0.8, 1.0, 1.25)).speed(f"clip {k}") for k in range(600)]
    for speed in (Fraction(4, 5), Fraction(1), Fraction(5, 4)):
        assert speeds.count(speed) == pytest.approx(200, abs=50)
    starts = [Crop().choose_start(30, range(0, 61, 2), 15, Draw(0, k)) for k in range(3100)]
    counts = np.bincount(starts)[::2]
    assert len(counts) == 31
    assert counts.min() > 60
    assert counts.max() < 150


@pytest.mark.parametrize("p", [0.0, 0.1, 1.0])
def test_fields_are_dropped_with_the_probability_together_or_not(p: float) -> None:
    fields = [replace(field_of("edge151"), name=name, kind="audio") for name in ("a", "b")]
    together, alone = (
        [Drop(p=p, together=way).dropped(fields, Draw(0, k)) for k in range(2000)] for way in (True, False)
    )
    assert set(together) <= {(), ("a", "b")}
    for drops in (together, alone):
        assert np.mean(["a" in names for names in drops]) == pytest.approx(p, abs=0.02)
        assert np.mean(["b" in names for names in drops]) == pytest.approx(p, abs=0.02)
    assert np.mean([len(names) == 2 for names in alone]) == pytest.approx(p * p, abs=0.01)


@pytest.mark.parametrize("made", [Yaw(), RootOffset(), JointNoise(), Tempo()], ids=lambda made: made.name)
def test_copies_are_a_function_of_seed_and_clip(made) -> None:
    def copy(seed: int, clip: str) -> tuple[bytes, Fraction]:
        spec = Copy(made.name, replace(made, seed=seed))
        motion = spec.motion_of(MOTION, clip)
        return motion.joints().tobytes(), motion.grid.rate

    assert copy(0, "a") == copy(0, "a")
    assert len({copy(0, f"clip {k}") for k in range(20)}) > 1
    assert len({copy(k, "a") for k in range(20)}) > 1


@few
@given(st.sampled_from([Fraction(4, 5), Fraction(9, 10), Fraction(11, 10), Fraction(5, 4), Fraction(2)]))
def test_a_motion_at_another_speed_is_where_it_was_at_the_same_place_of_the_dance(speed: Fraction) -> None:
    spec = Copy("tempo", Tempo(speeds=(float(speed),)))
    at_60 = random_motion(SMPL24, 120, turn_rad=0.6, step_m=0.01)
    source = Motion(at_60.translation, at_60.rotations, FrameGrid.of(60), SMPL24, trim_start=30)
    copy = spec.motion_of(source, "clip").resampled(FPS)
    instants = np.arange(copy.n_frames) * float(speed) * 2  # in frames of the source
    assert copy.n_frames == int(119 / float(speed) / 2 + 1e-9) + 1
    lower = np.minimum(instants.astype(int), 118)
    share = (instants - lower)[:, None]
    wanted = source.translation[lower] * (1 - share) + source.translation[lower + 1] * share
    np.testing.assert_allclose(copy.translation, wanted, atol=1e-9)
    assert copy.trim_start == int(np.ceil(30 / float(speed) / 2 - 1e-9))
    # Contacts by height follow: each label is that of the source within half a frame of the copy.
    height = CONTACTS.get("height")()
    labels = height(copy.joints(), FPS, SMPL24)
    dense = np.arange(0, 119.01, 0.05)
    whole = replace(source, trim_start=0).resampled(FrameGrid.of(1200))
    of_source = height(whole.joints(), whole.grid, SMPL24)
    for k, frame in enumerate(instants):
        near = np.abs(dense - frame) <= float(speed)
        choices = of_source[: len(dense)][near]
        assert ((choices == labels[k]).any(axis=0)).all()


def test_impossible_augmentations_say_why() -> None:
    plain = SampleField("edge151", "motion", field_of("edge151").columns, FPS)
    keymotion = next(f.sample_field for f in example_fields() if f.kind == "keymotion")
    for made in (Yaw(), RootOffset(), JointNoise()):
        with raises_message(UsageError, "installation"):
            made.check_sample(plain)
    for name in ("joints", "bailando72"):
        with raises_message(UsageError, "determine"):
            JointNoise().check_sample(field_of(name))
    with raises_message(UsageError, "follow"):
        JointNoise().check_sample(keymotion)
    for made in (Yaw(), RootOffset(), MirrorImage()):
        made.check_sample(keymotion)


@pytest.mark.parametrize(
    ("make", "parameters"),
    [
        (Yaw, {"max_degrees": 181}), (Yaw, {"max_degrees": float("nan")}), (Yaw, {"max_degrees": "x"}),
        (Yaw, {"seed": -1}), (RootOffset, {"max_m": -1}), (JointNoise, {"every_s": 0}), (Tempo, {"speeds": ()}),
        (Tempo, {"speeds": (5.0,)}),
    ],
)  # fmt: skip
def test_parameters_are_checked(make, parameters) -> None:
    with raises_message(UsageError, "range|seed|speeds"):
        make(**parameters)


@pytest.mark.parametrize("of_copy", [Fraction(401, 100), Fraction(24, 100)])
def test_a_speed_that_is_not_possible_is_refused(of_copy: Fraction) -> None:
    class Odd(Tempo):
        def speed(self, clip: str) -> Fraction:
            return of_copy

    with raises_message(UsageError, "possible", where="clip clip"):
        Copy("odd", Odd()).motion_of(MOTION, "clip")


def test_numbers_of_a_draw() -> None:
    draw, same = Draw(7, 1, 2), Draw(7, 1, 2)
    for call in (lambda d: d.uniform(), lambda d: d.uniform(2, 3), lambda d: d.below(10)):
        assert call(draw) == call(same)
    normal = Draw(1).normal(40000)
    assert abs(normal.mean()) < 0.02
    assert abs(normal.std() - 1) < 0.02
    np.testing.assert_array_equal(Draw(1).normal(5, 3), Draw(1).normal(9, 3)[:5])
    with raises_message(UsageError, "draw"):
        draw.below(0)
