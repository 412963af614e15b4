"""Statistics of a column, and of rows that windows have in common, against numpy over every row: equal to the bit."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.store import open_store, write_store
from dancedata.store.column_stats import QUANTILES, ColumnStats, Workspace, column_stats
from dancedata.store.shard_plan import plan_shards
from dancedata.store.shard_writer import same_columns
from dancedata.store.stats import compute_stats, rows_once

#: Around the sizes at which numpy's sum changes its way, and those of the pieces.
SIZES = (1, 2, 7, 8, 9, 127, 128, 129, 1000, 8191, 8193, 32767, 32768, 32769, 65536, 65537, 100_003, 300_001)


def plain(rows: np.ndarray) -> ColumnStats:
    """Return the statistics of a column by numpy alone, as they were first written."""
    column = np.sort(rows + np.float32(0))
    values = column.astype(np.float64)
    low, high = float(values[0]), float(values[-1])
    mean = low if low == high else float(values.mean())
    difference = values - mean
    quantiles = []
    for q in QUANTILES:
        position = q * (len(values) - 1)
        below = int(position)
        above = min(below + 1, len(values) - 1)
        quantiles.append(float(values[below] + (values[above] - values[below]) * (position - below)))
    return ColumnStats(mean, float(np.sqrt(np.mean(difference * difference))), low, high, tuple(quantiles))


@pytest.mark.parametrize("n", SIZES)
def test_numbers_of_a_column_are_numpys(n: int) -> None:
    values = np.random.default_rng(n).standard_normal(n).astype(np.float32) * 50 + 3
    assert column_stats(values.copy(), Workspace()) == plain(values)
    assert column_stats(np.full(n, 0.1, np.float32), Workspace()) == plain(np.full(n, 0.1, np.float32))


@pytest.mark.parametrize("n", SIZES)
def test_weighted_values_count_as_if_repeated(n: int) -> None:
    random = np.random.default_rng(n)
    values = random.standard_normal(n).astype(np.float32)
    values[::3] = np.float32(1e-45)
    values[1::5] = 0
    values[2::7] = random.choice([-3e38, 3e38, -1e-40], len(values[2::7]))
    weights = random.integers(1, 12, n)
    assert column_stats(values.copy(), Workspace(weights)) == plain(np.repeat(values, weights))


@pytest.mark.parametrize("n", [1, 127, 1000, 8193, 65537])
def test_columns_in_many_parts_one_after_another(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.store.column_stats._PIECE", 1 << 9)
    monkeypatch.setattr("dancedata.store.column_stats._REPEATED", 1 << 8)
    monkeypatch.setattr("dancedata.store.column_stats._PART", 1 << 11)
    random = np.random.default_rng(n)
    weights = random.choice([1, 2, 10, 5000], n, p=[0.1, 0.5, 0.39, 0.01])
    space, unweighted = Workspace(weights), Workspace()
    for _ in range(3):
        values = random.standard_normal(n).astype(np.float32).round(1) + np.float32(0)
        assert column_stats(values.copy(), space) == plain(np.repeat(values, weights))
        assert column_stats(values.copy(), unweighted) == plain(values)


@pytest.mark.parametrize("starts", [[0, 5, 10, 15], [3, 4, 30, 33, 90], [7], [0, 12, 24], []])
def test_rows_are_counted_once_with_all_their_windows(starts: list[int]) -> None:
    frames, length = np.arange(200), 12
    windows = np.array([frames[start : start + length] for start in starts]).reshape(-1, length)
    counts = rows_once(np.array(starts, dtype=np.int64), length)
    assert counts.shape == windows.shape
    np.testing.assert_array_equal(np.sort(np.repeat(windows, counts.reshape(-1))), np.sort(windows, axis=None))
    assert len(np.unique(windows)) == (counts > 0).sum()


def test_columns_that_differ_in_one_value_are_not_the_same() -> None:
    track = np.random.default_rng(0).standard_normal((40, 5)).astype(np.float32)
    starts = np.array([0, 4, 20, 25])
    windows = np.stack([track[start : start + 12] for start in starts])
    assert same_columns(windows, starts).all()
    windows[1, 11, 2] += 1  # no other window has this row
    assert same_columns(windows, starts).all()
    windows[1, 7, 3] += 1
    windows[3, 0, 0] += 1
    assert same_columns(windows, starts).tolist() == [False, True, True, False, True]


@pytest.mark.parametrize("odd", [None, 0, 4])
def test_rows_in_common_change_no_number(tmp_path: Path, make_store: Any, odd: int | None) -> None:
    made = make_store(scope="window", clips={"train": 6, "val": 2}, stride=6, shard_bytes=50_000)
    starts = [np.array(clip.starts) for clip in made.clips]
    random = np.random.default_rng(1)
    for clip, own in zip(made.clips, starts, strict=True):
        for name, ratio in (("pose", 1), ("fast", 2)):
            windows = np.asarray(clip.motion[name])
            track = random.standard_normal((clip.n_frames * ratio, windows.shape[2])).astype(np.float32)
            for window, start in zip(windows, own * ratio, strict=True):
                window[...] = track[start : start + len(window)]
    if odd is not None:
        np.asarray(made.clips[odd].motion["pose"])[1, 0, 3] += 1
    out = tmp_path / "out"
    out.mkdir()
    write_store(out, made.header, made.clips, shard_bytes=50_000)
    plans = plan_shards(made.header, made.clips, 50_000)
    assert len(plans) > 2
    stored = json.loads((out / "stats.json").read_text())
    assert stored == compute_stats(out, made.header, plans)
    store = open_store(out)
    for f in made.header.fields:
        train = [store.read(window, f.name) for window in store.windows("train")]
        rows = np.concatenate(train).astype(np.float32)
        found = stored["fields"][f.name]
        for number, column in enumerate(rows.T):
            expected = plain(column)
            assert [found[what][number] for what in ("mean", "std", "min", "max")] == [
                expected.mean, expected.std, expected.min, expected.max
            ]  # fmt: skip
