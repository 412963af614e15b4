"""The stage: left against right, where dancers face over time, and the floor that they use, on planted counts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dancedata
from dancedata.pages.bin_counts import BinCounts, ClipHistogram, fine_edges, nice_edges
from dancedata.pages.measure import _facing
from dancedata.pages.stage import Stage


def added(root: np.ndarray, facing_deg: np.ndarray, seconds: np.ndarray) -> Stage:
    """Count frames that face a direction, degrees from +Z towards +X."""
    stage = Stage()
    speed = np.tile([1.0, 3.0, 9.0], (len(root) - 1, 1))
    stage.add(("left_wrist", "right_wrist", "head"), speed, root, -np.radians(facing_deg), seconds)
    return stage


def test_left_and_right_are_compared_joint_by_joint() -> None:
    stage = added(np.zeros((5, 3)), np.zeros(5), np.arange(5) / 30).numbers()
    assert list(stage.balance) == ["wrist"]
    pair = stage.balance["wrist"]
    assert (pair.left_m_s, pair.right_m_s, pair.left_share) == (1.0, 3.0, 0.25)


def test_facing_is_counted_by_second_and_direction() -> None:
    """Two seconds to the front, two to +X, one to the back: 90 degrees are +X."""
    facing = np.repeat([0.0, 0.0, 90.0, 90.0, 180.0], 10)
    stage = added(np.zeros((50, 3)), facing, np.arange(50) / 10).numbers()
    counts = np.array(stage.facing)
    assert stage.every_s == 1
    assert counts.shape == (5, 24)
    assert [(k, int(j) * 15 - 180, int(counts[k, j])) for k, j in np.argwhere(counts)] == [
        (0, 0, 10), (1, 0, 10), (2, 90, 10), (3, 90, 10), (4, -180, 10)
    ]  # fmt: skip


def test_a_body_that_turns_to_its_left_faces_plus_x() -> None:
    """The front of a body at rest is +Z; a turn about +Y by 90 degrees moves it to +X."""
    turn = np.radians(90)
    left = 0.1 * np.array([np.cos(turn), 0, -np.sin(turn)])
    hips = np.stack([0 * left, left, -left])[None]
    stage = Stage()
    stage.add((), np.zeros((0, 0)), np.zeros((1, 3)), _facing(hips, ("pelvis", "left_hip", "right_hip")), np.zeros(1))
    assert int(np.argwhere(stage.facing)[0, 1]) * 15 - 180 == 90


def test_squares_of_the_floor_hold_the_frames() -> None:
    places = np.array([[0.05, 0.95, 0.05], [0.05, 0.95, 0.05], [-0.35, 1, 1.25], [30, 1, 0]])
    stage = added(places, np.zeros(4), np.zeros(4)).numbers()
    assert stage.beyond == 1
    found = {
        (round(stage.first_m[0] + k * stage.square_m, 2), round(stage.first_m[1] + j * stage.square_m, 2)): n
        for k, row in enumerate(stage.floor) for j, n in enumerate(row) if n
    }  # fmt: skip
    assert stage.square_m == pytest.approx(0.1)
    assert found == {(0.0, 0.0): 2, (-0.4, 1.2): 1}


def test_a_wide_floor_has_few_squares() -> None:
    rng = np.random.default_rng(0)
    places = np.stack([rng.uniform(-6, 6, 500), np.zeros(500), rng.uniform(-2, 9, 500)], axis=1)
    stage = added(places, np.zeros(500), np.zeros(500)).numbers()
    counts = np.array(stage.floor)
    assert max(counts.shape) <= 29
    x = stage.first_m[0] + stage.square_m * np.arange(counts.shape[0] + 1)
    z = stage.first_m[1] + stage.square_m * np.arange(counts.shape[1] + 1)
    wanted = np.histogram2d(places[:, 0], places[:, 2], bins=(x, z))[0]
    np.testing.assert_array_equal(counts, wanted)


def test_the_report_counts_the_frames_of_its_clips(demo: Path, demo_page: Path, document: Any) -> None:
    ds = dancedata.open(demo)
    stage = document["movement"]["stage"]
    frames = sum(clip.n_frames for clip in ds if not clip.source)
    assert sum(map(sum, stage["floor"])) == sum(map(sum, stage["facing"])) == frames
    speeds = {"left": [], "right": []}  # type: ignore[var-annotated]
    for clip in ds:
        joints = dancedata.decode(clip.read("edge151"), "edge151", fps=30).joints()
        for side, of_side in speeds.items():
            wrist = joints[:, ds.skeleton.joints.index(f"{side}_wrist")]
            of_side.append(np.linalg.norm(np.diff(wrist, axis=0), axis=1) * 30)
    left, right = (float(np.concatenate(of_side).mean()) for of_side in speeds.values())
    wrist = stage["balance"]["wrist"]
    assert (wrist["left_m_s"], wrist["right_m_s"]) == pytest.approx((left, right), abs=1e-3)
    page = demo_page.read_text()
    assert all(f'id="r-{key}"' in page for key in ("balance", "facing", "stage"))


# Tallies count as numpy does.


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
