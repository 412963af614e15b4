"""Still, short and beatless dances have named outcomes; no function returns NaN."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dancedata.core.dance import OUTCOMES, Dance, MusicBeats, Undefined
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import METRICS
from dancedata.metrics import (
    beat_alignment,
    chance_level,
    constant_columns,
    diversity,
    frechet,
    geometric,
    jackknife,
    kinetic,
    motion_beats,
    pbc,
    pfc,
    physics,
    skating,
)
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.key_motion import local_minima
from dancedata.metrics.kinetic_features import KINETIC_VARIANTS, Kinetic
from dancedata.metrics.set_statistics import STATISTICS, SetScores
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)


def outcome_of(call: Callable[[], object]) -> str:
    with raises_message(Undefined, "undefined") as caught:
        call()
    assert caught.value.reason in OUTCOMES
    assert OUTCOMES[caught.value.reason] in str(caught.value)
    return caught.value.reason


def still(frames: int = 40) -> np.ndarray:
    return np.broadcast_to(np.random.default_rng(0).normal(0, 0.5, (1, 24, 3)), (frames, 24, 3)).copy()


def walk(frames: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return still(frames) + rng.normal(0, 0.02, (frames, 24, 3)).cumsum(axis=0)


def dance(joints: np.ndarray, beats: Any = (3, 9)) -> Dance:
    return Dance(joints, THIRTY, MusicBeats.of(list(beats), THIRTY))


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5])
def test_few_frames_as_the_originals(frames: int, metrics_golden: Any) -> None:
    golden = metrics_golden.json("edge_cases")
    joints = np.array(golden[f"input_T{frames}"])
    if frames >= 3:
        found = KINETIC_VARIANTS["code"](joints, 60)
        np.testing.assert_allclose(found, golden[f"kinetic_api_T{frames}"], rtol=1e-6)
    else:  # ZeroDivisionError, and NaN for the energy
        for variant in KINETIC_VARIANTS.values():
            assert outcome_of(lambda v=variant: v(joints, 60.0)) == "short"  # type: ignore[misc]
    if frames >= 2:
        np.testing.assert_allclose(geometric(joints), golden[f"manual_api_T{frames}"], rtol=1e-6)
    else:  # NaN
        assert outcome_of(lambda: geometric(joints)) == "short"


def test_still_dances_as_the_originals(metrics_golden: Any) -> None:
    golden = metrics_golden.json("edge_cases")
    joints = np.repeat([golden["input_static"]], 40, axis=0)
    np.testing.assert_allclose(KINETIC_VARIANTS["code"](joints, 60), golden["kinetic_static"], rtol=1e-6)
    np.testing.assert_allclose(geometric(joints), golden["manual_static"], rtol=1e-6)
    assert math.isnan(golden["pfc_static"])
    assert outcome_of(lambda: pfc(joints, 30)) == outcome_of(lambda: pbc(joints, 30)) == "still"
    assert golden["pfc_T2"].startswith("ValueError")
    assert outcome_of(lambda: pfc(joints[:2], 30)) == outcome_of(lambda: pbc(joints[:2], 30)) == "short"
    assert outcome_of(lambda: physics(joints[:2])) == "short"
    assert outcome_of(lambda: skating(joints[:1], 30)) == "short"


def test_minima_as_the_originals(metrics_golden: Any) -> None:
    golden = metrics_golden.json("edge_cases")
    assert local_minima(np.array(golden["plateau_input"])).tolist() == golden["argrelextrema_less_order1"]
    assert local_minima(np.abs(np.arange(30.0) - 4), 10).tolist() == golden["argrelextrema_less_order10_edge"]
    assert local_minima(np.arange(30.0), 10).tolist() == golden["argrelextrema_order10_at_0"] == []
    curve = np.ones(30)
    curve[[2, 27]] = 0
    assert local_minima(curve, 10).tolist() == golden["argrelextrema_order10_two"] == [2, 27]


def test_no_beats_as_the_originals(metrics_golden: Any) -> None:
    golden = metrics_golden.json("edge_cases")
    moving, resting = walk(60), still(60)
    assert len(motion_beats(moving, 30))
    assert not len(motion_beats(resting, 30))
    aside = BeatAlignment("bailando", "music", 3.0, "frames")
    zero = BeatAlignment(no_motion_beats="zero", no_music_beats="zero")
    fact = BeatAlignment("fact", "motion", 3.0, "frames", "frames", no_motion_beats="zero")
    # Bailando and MEGADance raise; FACT and Motius have 0.
    assert "Error" in golden["ba_no_motion_beats"]
    assert "Error" in golden["ba_megadance_no_motion_beats"]
    assert outcome_of(lambda: aside.measure(dance(resting))) == "no_motion_beats"
    assert zero.measure(dance(resting))[0] == golden["motius_no_motion_beats"] == 0
    assert fact.measure(dance(resting))[0] == golden["fact_no_motion_beats"] == 0
    assert "Error" in golden["ba_no_music_beats"]
    assert "Error" in golden["fact_no_music_beats"]
    assert outcome_of(lambda: aside.measure(dance(moving, []))) == "no_music_beats"
    assert outcome_of(lambda: fact.measure(dance(moving, []))) == "no_music_beats"
    assert zero.measure(dance(moving, []))[0] == golden["motius_no_music_beats"] == 0
    mega = BeatAlignment("bailando", "music", 3.0, "frames", "frames", no_music_beats="zero")
    assert mega.measure(dance(moving, []))[0] == golden["ba_megadance_no_music_beats"] == 0
    assert outcome_of(lambda: beat_alignment(np.array([]), np.array([1]), sigma=3)) == "no_beats"
    assert outcome_of(lambda: beat_alignment(np.array([1]), np.array([]), sigma=3)) == "no_beats"


def test_the_first_two_frames_are_beats_not_a_mask() -> None:
    """Motius reads the beats [0, 1] as a mask; here they are frames."""
    metric = BeatAlignment("seconds")
    assert metric.measure(dance(walk(60), [0, 1]))[0] < 1
    assert metric.measure(dance(walk(60), [0, 1]))[0] == metric.measure(dance(walk(60), [1, 0]))[0]


def test_skating_of_made_up_feet(metrics_golden: Any) -> None:
    golden = metrics_golden.json("skating_extra")

    def glide(x: float, z: float) -> np.ndarray:
        joints = np.zeros((40, 24, 3))
        return joints + np.arange(40.0)[:, None, None] * (x, 0, z)

    def code(joints: np.ndarray) -> list[float]:
        return skating(joints, 30, rule="lodge-code").ratios.tolist()

    assert code(glide(0.015, -0.015)) == golden["fsr: glides along x=-z 1.5 cm each a frame"] == [0, 0]
    assert code(glide(0.015, 0)) == golden["fsr: glides along x 1.5 cm a frame"] == [0, 0]
    assert code(glide(0.025, 0)) == pytest.approx(golden["fsr: glides along x 2.5 cm a frame"], abs=1e-6)
    # 0.36 m/s at 60 frames per second
    assert skating(glide(0.006, 0), 60).ratios.tolist() == [0.975, 0.975]
    assert skating(glide(0.006, 0), 60, rule="lodge-norm").ratios.tolist() == [0, 0]
    assert skating(glide(0.006, 0), 30).ratios.tolist() == [0, 0]
    pitched = np.zeros((40, 24, 3))
    pitched[:, (7, 10, 8, 11), 1] = golden["fsr: ankle 7,8 pitched, heights of 7,10,8,11"]
    assert code(pitched) == golden["fsr: pitched"]
    for rule in ("lodge-norm", "speed"):
        for step in ((0.015, 0.0), (0.015, -0.015), (0.0, 0.015)):
            assert skating(glide(*step), 30, rule=rule).ratios.tolist() == [0.975, 0.975]
    # Duolando's: the first step is counted and never slides; up and down is no glide.
    found = [skating(glide(*step), 30, rule="duolando") for step in ((0.04, 0.0), (0.0, 0.04), (0.02, 0.02))]
    assert [(int(f.sliding[0]), int(f.counted[0])) for f in found] == [(38, 39), (38, 39), (0, 39)]
    rising = glide(0.0, 0.04)[..., (0, 2, 1)]
    assert skating(rising, 30, rule="duolando").ratio == 0
    jumping, lying = glide(0, 0), glide(0, 0)
    jumping[6:, :, 1] += 2
    edge = metrics_golden.json("edge_cases")
    assert code(jumping) == edge["fsr_jumps_2m_up_after_frame_5"]
    assert code(lying) == edge["fsr_lying"]


def test_a_foot_without_contact() -> None:
    joints = np.zeros((10, 24, 3))
    joints[:, 7, 1] = 1  # the left ankle is a metre above its toe
    found = skating(joints, 30)
    assert found.counted.tolist() == [0, 10]
    assert (
        outcome_of(lambda: found.ratios)
        == outcome_of(lambda: METRICS.get("skating")().measure(dance(joints)))
        == "no_contact"
    )


@pytest.mark.parametrize("name", METRICS.names())
def test_metrics_never_return_nan(name: str) -> None:
    metric = METRICS.get(name)()
    outcomes = set()

    def taken(joints: Any) -> Any:
        return np.stack([joints, joints[..., ::-1] + 1]) if metric.of_groups else joints

    for joints in (
        still(1), still(2), still(), walk(3), walk(40), np.zeros((40, 24, 3)), 1e-200 * walk(40), 1e6 * walk(40),
    ):  # fmt: skip
        for beats in ((), (3, 9), (10_000,)):
            try:
                row = metric.measure(dance(taken(joints), beats))
            except Undefined as outcome:
                outcomes.add(outcome.reason)
            else:
                assert row.shape == (len(metric.columns),)
                assert np.isfinite(row).all()
    assert outcomes <= OUTCOMES.keys()
    rows = np.array([metric.measure(dance(taken(0.01 * walk(40, seed)))) for seed in range(4)])
    scores = metric.summarise(rows, rows)
    assert all(math.isfinite(value) for value in scores.values())
    assert set(metric.better) <= scores.keys()
    assert outcome_of(lambda: metric.summarise(rows[:0], rows)) == "few_clips"


def test_one_clip() -> None:
    rng = np.random.default_rng(0)
    one, many = rng.normal(size=(1, 5)), rng.normal(size=(9, 5))
    assert outcome_of(lambda: frechet(one, many)) == outcome_of(lambda: frechet(many, one)) == "few_clips"
    assert outcome_of(lambda: diversity(one)) == "few_clips"
    assert outcome_of(lambda: jackknife(one, lambda rows: {"mean": rows.mean()})) == "few_clips"
    assert outcome_of(lambda: STATISTICS["torch"](one, many)) == "few_clips"
    assert outcome_of(lambda: SetScores.of(one, many)) == "few_clips"


def test_constant_columns_are_reported() -> None:
    rng = np.random.default_rng(0)
    pool, rows = rng.normal(size=(50, 6)), rng.normal(size=(20, 6))
    pool[:, 2] = 0.1
    assert constant_columns(pool).tolist() == [2]
    scores = SetScores.of(rows, pool).named("k")
    assert scores["constant_columns_k"] == 1
    assert scores["fid_k"] > 1e15 > 1e3 > scores["fid_k_varying"]
    alone = SetScores.of(np.delete(rows, 2, axis=1), np.delete(pool, 2, axis=1))
    assert scores["fid_k_varying"] == pytest.approx(alone.fid, rel=1e-12)
    rows[:, 2] = 0.1
    scores = SetScores.of(rows, pool).named("k")
    assert scores["fid_k"] == pytest.approx(scores["fid_k_varying"], rel=1e-12)
    assert "constant_columns_k" not in alone.named("k")


@pytest.mark.parametrize("call", [
    lambda joints: kinetic(joints, 60), geometric, physics, lambda joints: pfc(joints, 30),
    lambda joints: pbc(joints, 30), lambda joints: skating(joints, 30), lambda joints: motion_beats(joints, 30),
    lambda joints: motion_beats(joints, 30, detector="fact"), lambda joints: Dance(joints, THIRTY),
])  # fmt: skip
def test_bad_joints(call: Callable[[np.ndarray], object]) -> None:
    broken = walk(20)
    broken[7, 3, 1] = np.nan
    for joints, reason in (
        (broken, "nan"), (np.zeros((0, 24, 3)), "empty"), (np.zeros((9, 24)), "bad_shape"),
        (np.full((9, 24, 3), np.inf), "nan"),
    ):  # fmt: skip
        with raises_message(DataError, "joints", reason=reason) as caught:
            call(joints)
        assert not isinstance(caught.value, Undefined)
    with raises_message(DataError, "infinity", reason="nan"):
        call(broken)


def test_too_few_joints() -> None:
    joints = walk(20)
    for call, n in (
        (lambda p: geometric(p), 22), (lambda p: pbc(p, 30), 24), (lambda p: pfc(p, 30), 12),
        (lambda p: physics(p), 22),
        (lambda p: skating(p, 30), 12), (lambda p: Kinetic(joints=24).measure(Dance(p, THIRTY)), 24),
    ):  # fmt: skip
        call(joints[:, :n])
        with raises_message(DataError, "metric", reason="missing_joints") as caught:
            call(joints[:, : n - 1])
        assert str(n) in str(caught.value)


@pytest.mark.parametrize("call", [
    lambda p: kinetic(p, 0),
    lambda p: kinetic(p, float("nan")),
    lambda p: kinetic(p, 60, energy="cod"),
    lambda p: kinetic(p, 60, up="x"),
    lambda p: pfc(p, 30, variant="kode"),
    lambda p: pbc(p, 30, variant="paper"),
    lambda p: skating(p, 30, rule="lodge"),
    lambda p: motion_beats(p, 30, detector="fct"),
    lambda p: beat_alignment(np.array([1]), np.array([1]), sigma=0),
    lambda p: BeatAlignment(sigma=-1),
    lambda p: BeatAlignment(detector="x"),
    lambda p: Kinetic(variant="x"),
    lambda p: Kinetic(statistics="x"),
    lambda p: BeatAlignment().measure(Dance(p, THIRTY)),
    lambda p: SetScores.of(np.ones((3, 2)), None),
    lambda p: MusicBeats.of([0.5], THIRTY),
    lambda p: MusicBeats.of([-1], THIRTY),
    lambda p: jackknife(np.ones((3, 2)), lambda r: {}, n=0),
    lambda p: BeatAlignment(unit="frames", sigma=3),
    lambda p: BeatAlignment("seconds", unit="frames", sigma=3).measure(
        Dance(p, THIRTY, MusicBeats.of([1], FrameGrid.of(60)))),
])  # fmt: skip
def test_bad_arguments(call: Callable[[np.ndarray], object]) -> None:
    with raises_message(
        UsageError, "above|beats|detector|energy|interval|normalisation|scores|sigma|skating|variant|vertical"
    ):
        call(walk(60))


@pytest.mark.parametrize("bad", [np.ones(5), np.ones((3, 0)), np.array([[1.0, np.nan]] * 3)])
def test_bad_features(bad: np.ndarray) -> None:
    for call in (lambda: diversity(bad), lambda: frechet(bad, bad), lambda: STATISTICS["numpy"](bad, bad)):
        with raises_message(DataError, "features"):
            call()


def test_chance_level_is_that_of_random_shifts() -> None:
    rng = np.random.default_rng(0)
    to, beats = np.sort(rng.choice(600, 20, replace=False)), np.sort(rng.choice(600, 15, replace=False))
    shifted = [beat_alignment((beats + shift) % 600, to, sigma=3) for shift in range(600)]
    assert chance_level(to, 600, sigma=3) == pytest.approx(np.mean(shifted), rel=1e-12)
    seconds = chance_level(to / 60, 10, sigma=0.05, step=1 / 60)
    assert seconds == pytest.approx(chance_level(to, 600, sigma=3), rel=1e-9)
    assert outcome_of(lambda: chance_level(np.array([]), 600, sigma=3)) == "no_beats"
    assert outcome_of(lambda: chance_level(to, 0, sigma=3)) == "short"
