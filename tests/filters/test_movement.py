"""The movement filter's rule, against the sentence in Lodge's and FineDance's loaders: std(axis=0).mean() > 0.07."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dancedata.core.columns import Columns, Group
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.filters.movement import MIN_STD, Movement
from tests.messages import raises_message

COLUMNS = Columns((Group("pose", 139, "1"),))


def _keeps(rows: np.ndarray, **parameters: float) -> bool:
    return Movement(**parameters).reject(rows, COLUMNS, FrameGrid.of(30)) is None  # type: ignore[arg-type]


def _rows(std: float, width: int = 139, length: int = 256) -> np.ndarray:
    """Columns that swing between -std and std: their standard deviation (ddof 0) is std."""
    swing = np.where(np.arange(length) % 2, 1.0, -1.0)
    return np.tile(swing[:, None] * std, (1, width)).astype(np.float32)


@pytest.mark.parametrize("std", [0.0, 0.05, 0.0699, 0.06999, 0.07001, 0.0701, 0.2])
def test_windows_about_the_limit_fall_on_the_references_side(std: float) -> None:
    rows = _rows(std)
    assert _keeps(rows) == bool(rows.std(axis=0).mean() > 0.07)
    assert _keeps(rows) == (std > 0.07)


@pytest.mark.parametrize("steps", [-2, -1, 0, 1, 2])
def test_a_float32_step_from_the_limit(steps: int) -> None:
    std = np.float32(MIN_STD)
    for _ in range(abs(steps)):
        std = np.nextafter(std, np.float32(np.sign(steps)))
    rows = _rows(float(std))
    # float32 sums round; what counts is that the reference's own sentence decides.
    assert _keeps(rows) == bool(rows.std(axis=0).mean() > 0.07)


@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.integers(1, 20), st.floats(0, 0.2))
def test_any_rows(seed: int, length: int, width: int, scale: float) -> None:
    rows = np.random.default_rng(seed).normal(0, scale, (length, width)).astype(np.float32)
    assert _keeps(rows) == bool(rows.std(axis=0).mean() > 0.07)


def test_the_limit_itself_is_rejected() -> None:
    assert not _keeps(_rows(0.5), min_std=0.5)


def test_another_limit_and_the_reject() -> None:
    assert not _keeps(_rows(0.09), min_std=0.1)
    reject = Movement().reject(_rows(0.01), COLUMNS, FrameGrid.of(30))
    assert reject is not None
    assert reject.reason == "still"
    assert reject.detail == "lodge139 hardly moves: mean standard deviation 0.01, the limit is 0.07"
    assert reject.numbers == {"std": pytest.approx(0.01)}
    with raises_message(UsageError, "min_std"):
        Movement(min_std=-1)
