"""Motion: what it refuses; resampling, against scipy's Slerp; grounding by the toes, as Lodge does."""

from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from dancedata.core.bodies import SMPLX22, SMPLX52
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.ground import ground_height, grounded
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE, Skeleton
from tests.messages import raises_message

SIXTY, THIRTY = FrameGrid.of(60), FrameGrid.of(30)


def make(n: int, rate: Any = 60, seed: int = 0, skeleton: Skeleton = SMPL24, trim: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    translation, rotations = rng.normal(size=(n, 3)), rng.normal(size=(n, skeleton.n_joints, 3))
    return Motion(translation, rotations, FrameGrid.of(rate), skeleton, trim)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between rotations (..., 3), radians."""
    flat = [Rotation.from_rotvec(np.array(x).reshape(-1, 3)) for x in (a, b)]
    return np.asarray((flat[0].inv() * flat[1]).magnitude())


def test_arrays_are_float64_copies_and_read_only() -> None:
    translation, rotations = np.zeros((4, 3), np.float32), np.ones((4, 24, 3), np.float32)
    motion = Motion(translation, rotations, SIXTY, SMPL24)  # type: ignore[arg-type]
    translation[:] = rotations[:] = 9
    assert motion.translation.max() == 0
    assert motion.rotations.max() == 1
    assert motion.rotations.dtype == motion.translation.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        motion.rotations[0] = 0
    with pytest.raises(FrozenInstanceError):
        motion.grid = THIRTY  # type: ignore[misc]


@pytest.mark.parametrize(
    ("translation", "rotations", "reason"),
    [
        ((4, 3), (5, 24, 3), "bad_shape"), ((4, 3), (4, 23, 3), "bad_shape"), ((4, 3), (4, 72), "bad_shape"),
        ((4, 2), (4, 24, 3), "bad_shape"), ((0, 3), (0, 24, 3), "empty"),
    ],
)  # fmt: skip
def test_shapes_that_do_not_fit(translation: Any, rotations: Any, reason: str) -> None:
    with raises_message(DataError, "frames|shapes", reason=reason):
        Motion(np.zeros(translation), np.zeros(rotations), SIXTY, SMPL24)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("what", ["translation", "rotations"])
def test_values_that_are_not_numbers(value: float, what: str) -> None:
    arrays = {"translation": np.zeros((9, 3)), "rotations": np.zeros((9, 24, 3))}
    arrays[what][4:6, ..., 1] = value
    with raises_message(DataError, rf"{what} .* 2 of 9 frames, the first at frame 4", reason="nan"):
        Motion(**arrays, grid=SIXTY, skeleton=SMPL24)


@pytest.mark.parametrize("n", [1, 2, 9, 10, 1919])
def test_whole_ratios_keep_frames_to_the_bit(n: int) -> None:
    motion = make(n)
    half = motion.resampled(THIRTY)
    assert half.grid == THIRTY
    np.testing.assert_array_equal(half.rotations, motion.rotations[::2])
    np.testing.assert_array_equal(half.translation, motion.translation[::2])
    assert motion.resampled(SIXTY) is motion


RATES = ["25", "29.97", "30000/1001", "24", "50", "100"]


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("n", [1, 2, 3, 101])
def test_other_ratios_against_scipy(rate: str, n: int) -> None:
    motion = make(n, rate)
    made = motion.resampled(THIRTY)
    assert made.n_frames == motion.grid.resampled_length(n, THIRTY)
    if n == 1:
        assert angles(made.rotations, motion.rotations).max() < 1e-9
        return
    times = np.arange(n) / float(motion.grid.rate)
    wanted = np.minimum(np.arange(made.n_frames) / 30, times[-1])
    for joint in range(24):
        slerp = Slerp(times, Rotation.from_rotvec(np.array(motion.rotations[:, joint])))
        assert angles(made.rotations[:, joint], slerp(wanted).as_rotvec()).max() < 1e-7
    for axis in range(3):
        np.testing.assert_allclose(
            made.translation[:, axis], np.interp(wanted, times, motion.translation[:, axis]), atol=1e-12
        )


@pytest.mark.parametrize(
    ("trim", "start", "stop", "expected"),
    [(5, 0, 10, 5), (5, 3, 10, 2), (5, 5, 10, 0), (5, 8, 10, 0), (5, 0, 4, 0), (5, 0, 5, 0), (5, 0, 6, 5)],
)
def test_a_part_keeps_what_is_left_of_the_trim(trim: int, start: int, stop: int, expected: int) -> None:
    motion = replace(make(10), trim_start=trim)
    assert motion.part(start, stop).trim_start == expected


@pytest.mark.parametrize(
    ("rate", "trim", "expected"),
    [
        (30, 6, 3),  # a frame that is kept
        (30, 7, 4),  # the next frame that is
        (30, 19, 9),  # beyond the last one: the last
        (45, 6, 5),  # 6 / 60 s = 4.5 / 45 s
        (45, 8, 6),
        (120, 7, 14),
    ],
)
def test_the_trim_of_another_rate_is_the_first_frame_at_or_after_its_instant(rate, trim, expected):
    assert replace(make(20), trim_start=trim).resampled(FrameGrid.of(rate)).trim_start == expected


def test_parts_of_a_motion_that_remembers_are_those_of_one_that_does_not() -> None:
    plain = make(40)
    kept = plain.with_cache()
    bones = SMPL24.mirrored()

    def part_of(motion: Motion) -> Motion:
        return motion.part(3, 31).resampled(THIRTY).part(2, 9)

    for one, two in ((plain, kept), (plain.part(3, 31), kept.part(3, 31)), (part_of(plain), part_of(kept))):
        np.testing.assert_array_equal(two.rotations, one.rotations)
        np.testing.assert_array_equal(two.matrices, one.matrices)
        np.testing.assert_array_equal(two.joints(), one.joints())
        for other in (bones, SMPL24_EDGE, bones):
            np.testing.assert_array_equal(two.joints(other), one.joints(other))
        two.joints()[:] = 0  # an array of the caller's own
    assert kept.resampled(FrameGrid.of(45)).matrices.shape == (30, 24, 3, 3)
    with pytest.raises(ValueError, match="read-only"):
        kept.matrices[0] = 0
    with raises_message(DataError, "frames", reason="empty"):
        kept.part(5, 5)


def feet(left: float, right: float) -> np.ndarray:
    """Joints (1, 24, 3) at y = -5 (including ankles and hands), except the two toes."""
    joints = np.full((1, 24, 3), -5.0)
    joints[0, 10, 1], joints[0, 11, 1] = left, right
    return joints


@pytest.mark.parametrize(
    ("left", "right", "floor"),
    [
        (0.3, 0.3, 0.3),
        (0.3, 0.319, 0.3095),
        (0.319, 0.3, 0.3095),
        (0.3, 0.321, 0.3),
        (0.321, 0.3, 0.3),
        (-0.5, 0.5, -0.5),
        (0.0, 0.02, 0.0),  # 2 cm are not "less than 2 cm"
    ],
)
def test_mean_of_level_toes_else_the_lower(left: float, right: float, floor: float) -> None:
    assert ground_height(feet(left, right), SMPL24) == pytest.approx(floor, abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 9999), st.integers(0, 5), st.sampled_from([SMPL24, SMPLX22, SMPLX52]))
def test_the_lower_toe_is_on_the_floor_once_the_beginning_is_cut(seed: int, trim: int, skeleton: Skeleton) -> None:
    motion = make(6, 30, seed, skeleton, trim)
    found = grounded(motion)
    toes = found.joints()[trim, [10, 11], 1]
    level = abs(toes[0] - toes[1]) < 0.02
    assert (toes.mean() if level else toes.min()) == pytest.approx(0, abs=1e-12)
    # Nothing else changed: one height for all frames, those before the cut too.
    shift = motion.translation - found.translation
    np.testing.assert_allclose(shift, np.broadcast_to([0, shift[0, 1], 0], (6, 3)), atol=1e-12)
    np.testing.assert_array_equal(found.rotations, motion.rotations)
    assert (found.grid, found.skeleton, found.trim_start) == (motion.grid, motion.skeleton, trim)
