"""Tallies count as numpy does."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dancedata.pages.bin_counts import BinCounts, ClipHistogram, fine_edges, nice_edges

values = st.lists(st.floats(0, 9.99), min_size=1, max_size=200)


@given(values, st.floats(0, 1))
def test_quantiles_are_right_to_a_bin(numbers: list[float], q: float) -> None:
    tally = BinCounts.of(0, 10, 0.01)
    tally.add(np.array(numbers))
    quantile = tally.quantile(q)
    low, high = np.quantile(numbers, [max(0, q - 1e-9), min(1, q + 1e-9)], method="inverted_cdf")
    assert quantile is not None
    assert low - 0.0101 <= quantile <= high + 0.0101
    assert tally.mean == pytest.approx(np.mean(numbers), abs=1e-9)


@given(values)
def test_histograms_lose_nothing(numbers: list[float]) -> None:
    tally = BinCounts.of(0, 10, 0.01)
    for number in numbers:
        tally.add(np.array([number]))
    edges = fine_edges([tally])
    assert tally.histogram(edges).sum() == len(numbers)
    assert len(edges) <= 32
    assert tally.share_above(0) == 1


def test_values_on_borders_and_outside() -> None:
    tally = BinCounts.of(0, 1, 0.1)
    tally.add(np.array([0.1 + 0.2, 0.3, -5.0, 7.0]))  # 0.30000000000000004
    assert tally.counts.tolist() == [1, 0, 0, 2, 0, 0, 0, 0, 0, 1]
    assert tally.histogram([0, 0.5, 1]).tolist() == [3, 1]
    empty = BinCounts.of(0, 1, 0.1)
    assert (empty.mean, empty.quantile(0.5), empty.share_above(0.5)) == (None, None, None)
    assert fine_edges([empty]) == (0.0, 0.1)
    assert fine_edges([empty], beyond=0.3) == (0.0, 0.1, 0.2, 0.3, 0.4)


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=50))
def test_round_edges_hold_everything(numbers: list[float]) -> None:
    edges = nice_edges(min(numbers), max(numbers))
    slack = 1e-9 * (edges[1] - edges[0]) + 1e-10
    assert edges[0] - slack <= min(numbers)
    assert edges[-1] + slack >= max(numbers)
    assert 1 <= len(edges) - 1 <= 26
    assert np.all(np.diff(edges) > 0)


def test_a_histogram_of_groups() -> None:
    counted = ClipHistogram.of_groups({"a": [1, 2, 2], "b": []}, [0, 2, 4])
    assert counted.counts == {"a": [1, 2], "b": [0, 0]}
    assert (counted.n, counted.p50) == (3, 2.0)
