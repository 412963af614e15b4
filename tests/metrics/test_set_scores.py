"""Scores of sets; bootstrap intervals: as wide as theory says, the same for one seed, around the score."""

from __future__ import annotations

import numpy as np
import pytest

from dancedata.metrics import bootstrap
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.foot_skating import FootSkating
from dancedata.metrics.physical_contact import Pfc
from dancedata.metrics.set_scores import SetScores


def _mean(rows: np.ndarray) -> dict[str, float]:
    return {"mean": float(rows.mean())}


def test_of_a_mean() -> None:
    rows = np.random.default_rng(0).normal(3, 2, (400, 1))
    found = bootstrap(rows, _mean, n=2000)["mean"]
    assert found.level == 0.95
    assert found.high - found.low == pytest.approx(2 * 1.96 * rows.std() / 20, rel=0.1)
    assert (found.low + found.high) / 2 == pytest.approx(rows.mean(), abs=0.02)
    narrow = bootstrap(rows, _mean, level=0.5)["mean"]
    assert narrow.high - narrow.low == pytest.approx(2 * 0.674 * rows.std() / 20, rel=0.15)


def test_one_seed_gives_one_interval() -> None:
    rows = np.random.default_rng(0).normal(size=(20, 1))
    assert bootstrap(rows, _mean, n=50) == bootstrap(rows, _mean, n=50)
    assert bootstrap(rows, _mean, n=50) != bootstrap(rows, _mean, n=50, seed=1)
    same = bootstrap(np.ones((5, 1)), _mean, n=10)["mean"]
    assert (same.low, same.high) == (1, 1)


def test_the_bias_of_frechet_distances_is_left_out() -> None:
    rng = np.random.default_rng(0)
    rows, pool = rng.normal(size=(40, 10)), rng.normal(size=(200, 10))
    score = SetScores.of(rows, pool).named("k")
    drawn = [SetScores.of(rows[rng.integers(0, 40, 40)], pool).fid for _ in range(100)]
    assert np.quantile(drawn, 0.05) > score["fid_k"]  # duplicates: nearly every drawn set is further away
    found = bootstrap(rows, lambda part: SetScores.of(part, pool).named("k"), n=100)
    assert found.keys() == score.keys()
    for name in ("fid_k", "div_k"):
        assert found[name].low < score[name] < found[name].high
    assert found["div_k_pool"].low == pytest.approx(found["div_k_pool"].high)


def test_scores_of_sets() -> None:
    rows = np.array([[0.2, 0.1], [0.4, 0.3], [0.9, 0.5]])
    assert BeatAlignment().summarise(rows) == pytest.approx({"bas": 0.5, "bas_chance": 0.3})
    assert BeatAlignment(clips=24).summarise(rows) == pytest.approx({"bas": 1.5 / 24, "bas_chance": 0.3})
    assert Pfc().summarise(np.array([[1.0], [2.0], [30.0]])) == {"pfc": 11.0, "pfc_median": 2.0}
    feet = FootSkating("lodge-code").summarise(rows)
    assert feet == pytest.approx({"skating_left": 0.5, "skating_right": 0.3, "skating": 0.4})
    frames = np.array([[1.0, 10.0], [30.0, 50.0]])
    assert FootSkating("gmd").summarise(frames) == pytest.approx({"skating": 0.35})
    assert FootSkating("duolando").summarise(frames) == pytest.approx({"skating": 31 / 60})
