"""Frame rates, times, windows: exact at any rate."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid, WindowGrid, as_rate
from tests.messages import raises_message

rates = st.sampled_from(["24", "25", "29.97", "30000/1001", "30", "50", "60", "100", "120"]).map(FrameGrid.of)


@pytest.mark.parametrize(
    ("value", "exact"),
    [
        (30, Fraction(30)), (29.97, Fraction(2997, 100)), ("30000/1001", Fraction(30000, 1001)),
        (0.1, Fraction(1, 10)), ("59.94", Fraction(5994, 100)), (np.float64(29.97), Fraction(2997, 100)),
        (Fraction(1, 3), Fraction(1, 3)),
    ],
)  # fmt: skip
def test_rates_are_exact_decimals(value: Any, exact: Fraction) -> None:
    assert as_rate(value) == exact
    assert FrameGrid.of(value) == FrameGrid(exact)


@pytest.mark.parametrize("value", [0, -30, "", "thirty", "30/0", float("nan"), float("inf"), None, [30]])
def test_invalid_rates(value: Any) -> None:
    with raises_message(UsageError, "rate"):
        as_rate(value)


def test_frames_are_exact_or_refused() -> None:
    grid = FrameGrid.of(30)
    assert grid.frames(5) == 150
    assert grid.frames(0.1) == 3  # 3.0000000000000004 in floating point
    assert grid.frames("1001/30") == 1001
    with raises_message(UsageError, "stride") as error:
        grid.frames(0.05, "stride")
    for part in ("stride", "0.05 s = 1.5 frames", "0.0333333 s", "0.0666667 s"):
        assert part in str(error.value)
    with raises_message(UsageError, "multiples"):
        FrameGrid.of("30000/1001").frames(1)


def test_frames_up_rounds_up() -> None:
    grid = FrameGrid.of(30)
    assert [grid.frames_up(Fraction(n, 60)) for n in range(4)] == [0, 1, 1, 2]


@given(rates, rates, st.integers(1, 5000))
def test_resampled_length_is_the_number_of_instants_within_the_span(a: FrameGrid, b: FrameGrid, n: int) -> None:
    length = a.resampled_length(n, b)
    assert b.seconds(length - 1) <= a.seconds(n - 1) < b.seconds(length)


@given(rates, rates, st.integers(0, 5000))
def test_rows_are_at_the_same_instant(a: FrameGrid, b: FrameGrid, frame: int) -> None:
    try:
        assert b.seconds(a.rows(frame, of=b)) == a.seconds(frame)
    except UsageError:
        assert (a.seconds(frame) * b.rate).denominator != 1


def test_numbers_of_the_real_data() -> None:
    sixty, thirty = FrameGrid.of(60), FrameGrid.of(30)
    assert sixty.resampled_length(1919, thirty) == 960
    assert thirty.rows(149, of=sixty) == 298
    assert sixty.rows(300, of=thirty) == 150
    assert thirty.step_to(sixty) is None
    assert FrameGrid.of(100).step_to(thirty) is None
    assert FrameGrid.of(120).step_to(thirty) == 4
    assert FrameGrid.of("30000/1001").resampled_length(1, thirty) == 1
    assert thirty.resampled_length(0, sixty) == 0
    with raises_message(UsageError, "multiples"):
        sixty.rows(301, of=thirty)


@given(st.integers(0, 700), st.integers(1, 300), st.integers(1, 60))
def test_windows_are_all_that_fit(n: int, length: int, stride: int) -> None:
    windows = WindowGrid(length, stride)
    starts = list(windows.starts(windows.count(n)))
    assert starts == [s for s in range(0, n, stride) if s + length <= n]
    assert starts == [windows.start(k) for k in range(len(starts))]
    assert [windows.number(start) for start in starts] == list(range(len(starts)))


@pytest.mark.parametrize(("length", "stride"), [(0, 1), (1, 0), (-1, 1), (1, -5)])
def test_windows_of_no_length(length: int, stride: int) -> None:
    with raises_message(UsageError, "stride"):
        WindowGrid(length, stride)


@given(frames=st.lists(st.integers(0, 10**6), max_size=20), here=rates, there=rates)
def test_nearest_rows_are_nearest(frames: list[int], here: FrameGrid, there: FrameGrid) -> None:
    rows = here.nearest_rows(np.array(frames, dtype=np.int64), of=there)
    for frame, row in zip(frames, rows.tolist(), strict=True):
        exact = here.seconds(frame) * there.rate
        assert row - Fraction(1, 2) <= exact < row + Fraction(1, 2)
