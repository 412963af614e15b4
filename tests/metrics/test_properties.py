"""Properties that the formulas have, and a Frechet distance in exact arithmetic."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from dancedata.core.dance import Dance, MusicBeats
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import Metric
from dancedata.metrics import frechet, jackknife, kinetic, motion_beats, pfc, physics
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.foot_skating import SKATING_RULES, FootSkating
from dancedata.metrics.geometric_features import Geometric
from dancedata.metrics.kinetic_features import KINETIC_VARIANTS, Kinetic, kinetic_flowerdance, kinetic_megadance
from dancedata.metrics.motius_physics import MotiusPhysics
from dancedata.metrics.physical_contact import PFC_VARIANTS, Pbc, Pfc
from dancedata.metrics.root import ROOTS
from dancedata.metrics.set_statistics import SetScores
from dancedata.synthetic import synthesise_motion

SIXTY = FrameGrid.of(60)


@pytest.fixture(scope="module")
def joints() -> np.ndarray:
    """Two seconds of a dance, 60 frames per second, away from the origin; its feet glide, so that PFC is not 0."""
    positions = synthesise_motion("gHO_sBM_cAll_d19_mHO3_ch07", n_frames=120)[0].joints()
    sway = 0.05 * np.sin(np.arange(120) / 7)[:, None, None] * np.array([1, 0, 0.5])
    return positions + sway + np.array([0.3, 0.1, -1.2])


#: frechet() of `_numbers`, computed with 60 digits by mpmath.
STORED = {(5, 20): 430.6696578902527022572535360931507022575, (20, 30): 125.5446943708643597248106745722191815374}


def _numbers(n: int, seed: int) -> list[list[int]]:
    """Small whole numbers (n, 8) that need no random generator."""
    return [[(seed * (i * i + 3) * (j + 2) + 7 * i * j) % 23 - 11 for j in range(8)] for i in range(n)]


@pytest.mark.parametrize(("n", "m"), STORED)
def test_frechet_in_exact_arithmetic(n: int, m: int) -> None:
    found = frechet(np.array(_numbers(n, 5), float), np.array(_numbers(m, 3), float))
    assert found == pytest.approx(STORED[n, m], rel=1e-13)


def _turned(joints: np.ndarray, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return joints @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


ALL: dict[str, Metric] = {
    **{f"kinetic {v} {r}": Kinetic(v, r) for v in KINETIC_VARIANTS for r in ROOTS},
    **{f"geometric {r}": Geometric(r) for r in ROOTS},
    **{f"beats {d}": BeatAlignment(d) for d in ("seconds", "bailando", "fact", "gcd")},
    **{f"pfc {v}": Pfc(v) for v in PFC_VARIANTS},
    "pbc": Pbc(),
    **{f"skating {rule}": FootSkating(rule) for rule in SKATING_RULES},
    "physics": MotiusPhysics(),
}
#: Metrics that depend on the dancer's direction, on her position, and on the height of the floor.
FEEL_YAW = {"skating lodge-code"}
FEEL_PLACE = {f"kinetic {v} absolute" for v in ("code", "gcd-code")}
FEEL_FLOOR = FEEL_PLACE | {"skating gmd"}


def _rows(metric: Metric, joints: np.ndarray) -> np.ndarray:
    beats = MusicBeats.of([5, 35, 66, 96], SIXTY)
    return metric.measure(Dance(joints, SIXTY, beats))


@pytest.mark.parametrize("name", ALL)
def test_what_changes_a_metric(name: str, joints: np.ndarray) -> None:
    slid = joints - (0, joints[:, 10:12, 1].min(), 0)  # the floor at 0, feet that slide somewhat
    slid = slid + 0.35 * np.sin(np.arange(120) / 6)[:, None, None] * (0.3, 0, 1)
    slid[:, :, 2] += 0.0 if "duolando" not in name else np.cumsum(np.tile([0.0, 0.034], 60))[:, None]
    metric = ALL[name]
    before = _rows(metric, slid)
    changes = {
        "yaw": (_turned(slid, 40), name in FEEL_YAW),
        "place": (slid + np.array([1.5, 0, -2.5]), name in FEEL_PLACE),
        "floor": (slid + np.array([0, 0.3, 0]), name in FEEL_FLOOR),
    }
    for change, (changed, feels) in changes.items():
        same = np.allclose(_rows(metric, changed), before, rtol=1e-6, atol=1e-9)
        assert same != feels, change


@pytest.mark.parametrize("name", [name for name, metric in ALL.items() if hasattr(metric, "up")])
def test_z_up(name: str, joints: np.ndarray) -> None:
    metric: Any = ALL[name]
    z_up = joints[..., (0, 2, 1)] * (1, -1, 1)
    np.testing.assert_allclose(_rows(replace(metric, up="z"), z_up), _rows(metric, joints), rtol=1e-6, atol=1e-12)


def test_rates(joints: np.ndarray) -> None:
    """Metrics in seconds hardly depend on the rate; those per frame do."""
    half = joints[::2]
    assert np.allclose(motion_beats(half, 30) * 2, motion_beats(joints, 60), atol=2)
    assert pfc(half, 30, variant="paper") == pytest.approx(pfc(half, 30) / 10_000 * 900)
    assert pfc(joints, 60) == pytest.approx(4 * pfc(joints, 60, variant="code"))
    assert pfc(half, 30) == pytest.approx(pfc(half, 30, variant="code"))
    assert physics(half).dynamic > 1.5 * physics(joints).dynamic


def test_the_other_kinetic_definitions() -> None:
    """Even motion has its speed, except at the ends."""
    path = np.arange(200.0)[:, None, None] * (0.01, 0.02, 0.03) + np.zeros((1, 4, 3))
    found = kinetic(path, 10).reshape(4, 3)
    np.testing.assert_allclose(found, [[0.1, 0.04, 0]] * 4, atol=1e-9)
    np.testing.assert_allclose(kinetic_megadance(path, 10).reshape(4, 3)[:, :2], [[0.1, 0.04]] * 4, rtol=0.02)
    # The last frame of FlowerDance is followed by the first: a circle continues, a line jumps back.
    angle = np.arange(200) * (2 * np.pi / 200)
    circle = np.stack([np.cos(angle), np.zeros(200), np.sin(angle)], axis=1)[:, None]
    np.testing.assert_allclose(kinetic_flowerdance(circle, 10)[0], (10 * 2 * np.pi / 200) ** 2, rtol=0.02)
    assert kinetic_flowerdance(path, 10)[0] > 10 * found[0, 0]


# Scores of sets; intervals: they cover as often as is stated, lie within the bounds, and one seed gives one.


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
