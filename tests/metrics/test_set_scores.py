"""Scores of sets; intervals: they cover as often as is stated, lie within the bounds, and one seed gives one."""

import numpy as np
import pytest
from scipy import stats

from dancedata.metrics import jackknife
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.foot_skating import FootSkating
from dancedata.metrics.physical_contact import Pfc
from dancedata.metrics.set_statistics import SetScores


def _mean(rows: np.ndarray) -> dict[str, float]:
    return {"mean": float(rows.mean())}


#: Shapes of scores over clips: how they are drawn, their mean, their bounds, and the lowest coverage that is stated.
SHAPES = {
    "normal": (lambda rng, n: rng.normal(10, 5, n), 10, (-np.inf, np.inf), 0.94),
    "positive": (lambda rng, n: rng.gamma(4, 2.5, n), 10, (0, np.inf), 0.93),
    "skewed, as PFC": (lambda rng, n: rng.lognormal(0, 1, n), np.exp(0.5), (0, np.inf), 0.89),
    "ratio, as BAS": (lambda rng, n: rng.beta(8, 12, n), 0.4, (0, 1), 0.94),
    "small ratio, as FSR": (lambda rng, n: rng.beta(0.6, 10, n), 0.6 / 10.6, (0, 1), 0.94),
}


@pytest.mark.parametrize("n", [3, 10])
@pytest.mark.parametrize("shape", SHAPES)
def test_coverage(shape: str, n: int) -> None:
    draw, mean, bounds, least = SHAPES[shape]
    rng = np.random.default_rng(0)
    found = [jackknife(draw(rng, (n, 1)), _mean, bounds=bounds)["mean"] for _ in range(500)]
    assert all(bounds[0] <= each.low < each.high <= bounds[1] for each in found)
    covered = np.mean([each.low <= mean <= each.high for each in found])
    assert covered > least - 2 * np.sqrt(0.05 * 0.95 / len(found))  # two standard errors of 500 sets


def test_of_a_mean_of_normal_numbers_it_is_that_of_student() -> None:
    rows = np.random.default_rng(0).normal(3, 2, (40, 1))
    for level in (0.5, 0.95):
        theirs = stats.t.interval(level, 39, rows.mean(), stats.sem(rows[:, 0]))
        found = jackknife(rows, _mean, level=level)["mean"]
        assert (found.low, found.high) == pytest.approx(theirs, rel=1e-9)
        assert (found.level, found.clips) == (level, 40)


def test_large_sets_leave_out_groups_that_the_seed_deals() -> None:
    rows = np.random.default_rng(0).normal(3, 2, (1000, 1))
    found = jackknife(rows, _mean, n=50)["mean"]
    assert found.high - found.low == pytest.approx(2 * 1.96 * rows.std() / np.sqrt(1000), rel=0.3)
    assert found == jackknife(rows, _mean, n=50)["mean"] != jackknife(rows, _mean, n=50, seed=1)["mean"]


def test_scores_that_no_clip_changes_have_no_interval() -> None:
    rows = np.ones((5, 1))
    assert jackknife(rows, _mean, bounds=(0, 1)) == {} == jackknife(rows, _mean)
    one = np.eye(8)[:, :1]  # one clip carries all
    assert jackknife(one, _mean, bounds=(0, np.inf))["mean"].clips == pytest.approx(1)


def test_of_distances_and_diversity() -> None:
    """The score of the population is that of sets of this size, whose mean is simulated."""
    rng = np.random.default_rng(0)
    pool = rng.normal(0.3, 1, (200, 6))

    def scores(rows: np.ndarray) -> dict[str, float]:
        return SetScores.of(rows, pool).named("k")

    sets = [rng.normal(size=(8, 6)) for _ in range(150)]
    own = [scores(rows) for rows in sets]
    found = [jackknife(rows, scores, bounds=(0, np.inf)) for rows in sets[:50]]
    assert found[0].keys() == {"fid_k", "div_k"}  # that of the pool is the same without any clip
    for name in ("fid_k", "div_k"):
        mean = np.mean([each[name] for each in own])
        assert np.mean([each[name].low <= mean <= each[name].high for each in found]) > 0.9


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
