"""The kinetic curve, its minima, and the rows that a store holds of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import argrelextrema

from dancedata.core.errors import DataError, UsageError
from dancedata.metrics.key_motion import KeyMotion, key_motion, kinetic_curve, smoothed
from tests.messages import raises_message


def swinging(n: int, period: int = 40, joints: int = 3) -> np.ndarray:
    """Joints on circles at a speed that rises and falls: slowest at whole periods."""
    t = np.arange(n)
    way = np.cumsum(0.02 - 0.015 * np.cos(2 * np.pi * t / period)) - 0.005
    circle = np.stack([np.cos(way), 0 * way, np.sin(way)], axis=-1)
    return circle[:, None] * np.arange(1, joints + 1)[None, :, None]


@pytest.mark.parametrize(
    ("joints", "reason"),
    [
        (np.zeros((5, 3)), "bad_shape"), (np.zeros((5, 2, 2)), "bad_shape"), (np.zeros((0, 2, 3)), "empty"),
        (np.zeros((5, 0, 3)), "empty"), (np.full((5, 2, 3), np.nan), "nan"), (np.full((5, 2, 3), np.inf), "nan"),
    ],
)  # fmt: skip
def test_bad_joints(joints: np.ndarray, reason: str) -> None:
    with raises_message(DataError, "joints", reason=reason):
        kinetic_curve(joints)


def test_smoothing_keeps_the_sum_and_reflects_at_the_ends() -> None:
    rng = np.random.default_rng(0)
    curve = rng.random(200)
    assert np.isclose(smoothed(curve, 5).sum(), curve.sum())
    np.testing.assert_allclose(
        smoothed(np.concatenate([curve[::-1], curve, curve[::-1]]), 5)[200:400], smoothed(curve, 5)
    )
    # A single bump is a Gaussian of 5 frames, cut at 20.
    bump = np.zeros(101)
    bump[50] = 1
    wide = smoothed(bump, 5)
    np.testing.assert_allclose(wide[55] / wide[50], np.exp(-0.5))
    assert wide[70] > 0
    assert wide[71] == 0


def test_minima_are_scipys() -> None:
    rng = np.random.default_rng(3)
    joints = np.cumsum(rng.normal(size=(400, 4, 3)), axis=0)
    found = key_motion(joints, 2)
    assert found.minima.tolist() == argrelextrema(found.curve, np.less)[0].tolist()
    np.testing.assert_array_equal(found.curve, smoothed(kinetic_curve(joints), 2))


def test_rows_of_a_clip() -> None:
    found = key_motion(swinging(150))
    rows = found.to_rows()
    assert rows.shape == (150, 3)
    assert rows.dtype == np.float32
    np.testing.assert_allclose(rows[:-1, 0], found.curve, rtol=1e-6)
    assert rows[-1, 0] == rows[-2, 0]
    # The way from m to m + 1 is shortest where cos(2 pi (m + 1) / 40) is 1.
    assert np.flatnonzero(rows[:, 1]).tolist() == found.minima.tolist() == [39, 79, 119]
    assert (found.prominence > 0).all()
    assert set(rows[:, 1].tolist()) == {0, 1}
    assert (rows[rows[:, 1] == 0, 2] == 0).all()
    assert rows[-1, 1:].tolist() == [0, 0]


@pytest.mark.parametrize("n", [1, 2, 3, 10])
def test_short_clips_have_rows(n: int) -> None:
    rows = key_motion(swinging(n)).to_rows()
    assert rows.shape == (n, 3)
    assert np.isfinite(rows).all()
    assert (rows[:, 0] > 0).all() == (n > 1)


@given(start=st.integers(0, 198), length=st.integers(1, 200))
def test_a_window_of_rows_has_the_clips_minima(start: int, length: int) -> None:
    found = key_motion(swinging(200))
    part = KeyMotion.from_rows(found.to_rows()[start : start + length])
    stop = min(start + length, 200)
    inside = (found.minima >= start) & (found.minima < stop)
    assert (part.minima + start).tolist() == found.minima[inside].tolist()
    np.testing.assert_allclose(part.prominence, found.prominence[inside], rtol=1e-6)
    np.testing.assert_allclose(part.curve, found.curve[start : stop - 1], rtol=1e-6)


@pytest.mark.parametrize("shape", [(0, 3), (5, 2), (3,), (2, 5, 3)])
def test_rows_of_another_shape(shape: tuple[int, ...]) -> None:
    with raises_message(UsageError, "rows"):
        KeyMotion.from_rows(np.zeros(shape))
