"""Verdicts: each rule by numbers that are made for it, and what toys of a first day look like."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.plugins import Metric
from dancedata.evaluation import verdicts
from dancedata.evaluation.pool import MetricRows, Pool
from dancedata.evaluation.report import Report
from dancedata.evaluation.scores import MeaninglessScore, SameN, Score, scores_of
from dancedata.evaluation.tables import latex, markdown
from dancedata.evaluation.verdicts import Circumstances, judged, same_n_of
from dancedata.execution.cache import Cache
from dancedata.execution.cache_admin import entries, prune
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.intervals import Interval
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pfc
from dancedata.store import Store
from tests.messages import raises_message

MANY = np.linspace(1, 2, 30)


def rows_of(values: Any, clips: Any = None, undefined: Mapping[str, tuple[str, ...]] | None = None) -> MetricRows:
    numbers = np.asarray(values, dtype=float)
    numbers = numbers[:, None] if numbers.ndim == 1 else numbers
    of = np.arange(len(numbers)) if clips is None else np.asarray(clips)
    return MetricRows(numbers, of.astype(float), tuple(f"c{k}#{n}" for n, k in enumerate(of)), dict(undefined or {}))


def verdict(metric: Metric, rows: MetricRows, **given: Any) -> Score:
    """Judge the first score of a metric."""
    pool = given.get("pool")
    (score, *_), _ = scores_of(metric, rows, pool, draws=200)
    usual: dict[str, Any] = {
        "pool": None, "generated": True, "truth": {}, "same_n": {}, "in_pool": 0, "pool_of_all": False, "doubt": "",
        "draws": 200,
    }  # fmt: skip
    return judged(score, Circumstances(metric=metric, rows=rows, **(usual | given)))


def of_chance(bas: float, chance: float) -> MetricRows:
    """Rows of beat alignment around a value, with the chance level of all."""
    values = bas + np.linspace(-0.02, 0.02, 24)
    return rows_of(np.stack([values, np.full(24, chance)], axis=1))


def features(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, len(Kinetic().columns)))


KINETIC = Kinetic("fixed", statistics="varying")
POOL = features(200)


@pytest.mark.parametrize(("score", "verdict_", "code"), [
    (lambda: verdict(Pfc(), rows_of(MANY)), "ok", ""),
    (lambda: verdict(Pfc(), rows_of([1, 2])), "void", "few_clips"),
    (lambda: verdict(Pfc(), rows_of(MANY, np.arange(30) % 2)), "void", "few_clips"),
    (lambda: verdict(KINETIC, rows_of(features(100), np.arange(100) % 10), pool=POOL), "void", "few_clips"),
    (lambda: verdict(KINETIC, rows_of(features(40)), pool=POOL), "weak", "rank"),
    (lambda: verdict(KINETIC, rows_of(features(100, 2)), pool=POOL), "ok", ""),
    (lambda: verdict(KINETIC, rows_of(features(100, 2)), pool=POOL, in_pool=3), "void", "in_pool"),
    (lambda: verdict(KINETIC, rows_of(features(100, 2)), pool=POOL, in_pool=3, pool_of_all=True), "weak", "in_pool"),
    (lambda: verdict(KINETIC, rows_of(features(100, 2)), pool=POOL, same_n={"fid_k": SameN(0, 1, 1e6)}), "weak",
     "same_n"),
    (lambda: verdict(KINETIC, rows_of(features(100, 2)), pool=POOL, same_n={"fid_k": SameN(1e5, 1e6, 1e7)}), "weak",
     "below_truth"),
    (lambda: verdict(KINETIC, rows_of(features(100, 2)), pool=POOL, same_n={"fid_k": SameN(0, 1, 1e6)},
                     generated=False), "ok", ""),
    (lambda: verdict(KINETIC, rows_of(features(100, 2)), pool=POOL, truth={"fid_k": Score("fid_k", 1e6, 9)}), "ok",
     "below_truth"),
    (lambda: verdict(Pfc(), rows_of(MANY), truth={"pfc": Score("pfc", 3, 9, Interval(2, 4, 0.95, 9))}), "ok",
     "below_truth"),
    (lambda: verdict(BeatAlignment(), of_chance(0.5, 0.2)), "ok", ""),
    (lambda: verdict(BeatAlignment(), of_chance(0.5, 0.5)), "void", "chance"),
    (lambda: verdict(BeatAlignment(), of_chance(0.2, 0.5)), "void", "chance"),
    (lambda: verdict(Pfc(), rows_of(np.ones(30))), "weak", "no_interval"),
    (lambda: verdict(Pfc(), rows_of([0.1, 1, 2, 4])), "weak", "no_interval"),
    (lambda: verdict(Pfc(), rows_of([*MANY * 0.01, 9, 8])), "weak", "few_carry"),
    (lambda: verdict(Pfc(), rows_of(MANY, undefined={"short": tuple("abcd")})), "weak", "undefined"),
    (lambda: verdict(Pfc(), rows_of(MANY, undefined={"short": tuple(map(str, range(31)))})), "void", "undefined"),
    (lambda: verdict(Pfc(), rows_of([], undefined={"short": ("a",)})), "void", "undefined"),
    (lambda: verdict(Pfc(), rows_of(MANY), doubt="vectors are 23 % off unit length"), "void", "scaler"),
])  # fmt: skip
def test_each_rule(score: Any, verdict_: str, code: str) -> None:
    found = score()
    assert found.verdict == verdict_
    assert (found.why[0].code if found.why else "") == code
    assert found.to_json()["why"] == [vars(why) for why in found.why]
    if verdict_ == "void":
        with raises_message(MeaninglessScore, "nothing"):
            float(found)
    else:
        assert float(found) == found.value
    assert (found.to_json()["interval_95"] is None) == (verdict_ != "ok" or found.interval is None)


def test_real_dances_at_this_n_are_drawn_by_recordings() -> None:
    clips = np.repeat(np.arange(50.0), 4)
    pool = Pool("p", 1, "30", (), {0: POOL}, "", {}, "", {0: clips})
    found = same_n_of(pool, 0, KINETIC, 20, 80)
    assert list(found) == ["fid_k"]
    assert 0 < found["fid_k"].low < found["fid_k"].median < found["fid_k"].high
    assert same_n_of(pool, 0, KINETIC, 5, 20)["fid_k"].median > 2 * found["fid_k"].median
    # Pieces of one recording that are alike are drawn together: few recordings are then farther away.
    alike = Pool("p", 1, "30", (), {0: np.repeat(POOL[::4], 4, axis=0)}, "", {}, "", {0: clips})
    assert same_n_of(alike, 0, KINETIC, 20, 80)["fid_k"].median > found["fid_k"].high
    assert same_n_of(pool, 0, Pfc(), 0, 0) == {}


def test_distances_of_real_dances_are_kept_until_they_are_pruned(tmp_path, monkeypatch):
    pool = Pool("p", 1, "30", (), {0: POOL}, "", {}, "", {0: np.repeat(np.arange(50.0), 4)})
    cache = Cache(tmp_path)
    drawn = same_n_of(pool, 0, KINETIC, 20, 80, cache)
    monkeypatch.setattr(verdicts, "summary_of", None)  # would be called
    assert same_n_of(pool, 0, KINETIC, 20, 80, cache) == drawn
    assert [entry.stage for entry in entries(tmp_path)] == ["evaluate"]
    assert prune(tmp_path, max_bytes=0).removed == 1
    for of, recordings in ((replace(pool, rows={0: POOL + 1}), 20), (pool, 21), (pool, 20)):
        with pytest.raises(TypeError):
            same_n_of(of, 0, KINETIC, recordings, 80, cache)


# ------------------------------------------------------------------------------------------------- a first day's toys

RECIPE = {
    "recipe": 1, "name": "toys", "dataset": {"synthetic": {"songs": 6, "clips_per_song": 9, "clip_s": 6}}, "fps": 30,
    "windows": {"length_s": 5, "stride_s": 2.5}, "motion": {"edge151": {}}, "audio": {"librosa35": {}},
}  # fmt: skip


@pytest.fixture(scope="module")
def toys(folder: Path) -> Store:
    dancedata.build(RECIPE, out=folder / "toys", jobs=1, cache=folder / "cache", progress=False)
    return dancedata.open(folder / "toys")


def judge(store: Store, folder: Path, samples: Mapping[str, np.ndarray], **options: Any) -> Report:
    folder.mkdir()
    for name, rows in samples.items():
        np.save(folder / f"{name}.npy", rows)
    return dancedata.evaluate(folder, like=store, **{"normalized": False, **options})


def made(store: Store, what: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    train = list(store.clips("train"))
    windows = {f"{clip.id}@0+150": clip.read("edge151") for clip in train[:20]}
    rng = np.random.default_rng(0)
    if what == "ten_windows_of_one":
        whole = train[0].read("edge151")
        return {f"{train[0].id}@{k}+140": whole[k : k + 140] for k in range(10)}, {}
    if what == "toy":  # a network that was hardly trained gives noise about the middle of the scaler
        return {name: rng.normal(0, 0.05, (150, 151)) for name in windows}, {"normalized": True}
    if what == "still":
        return {name: np.repeat(rows[:1], 150, axis=0) for name, rows in windows.items()}, {}
    if what == "copies":  # dances of train under the ids of others
        return {name: train[29 - k].read("edge151")[:150] for k, name in enumerate(windows)}, {}
    begin = 1 if what == "good" else 0
    return {name: rows[begin : begin + 150] for name, rows in windows.items()}, {}


@pytest.mark.parametrize(("what", "is_void", "words"), [
    ("ten_windows_of_one", ["fid_k", "div_k", "bas", "pfc", "skating"], "Nothing here is a result: 10 samples of"),
    ("toy", ["fid_k", "div_k", "bas", "pfc", "skating"], "Nothing here is a result: 20 clips"),
    ("still", ["bas", "pfc", "skating"], "have no value: the motion has no beat"),
    ("copies", [], "better than real dances: look for copies of train"), ("good", [], "20 clips: 9 scores"),
    ("truth", [], "20 of 20 samples are the dances of the dataset themselves"),
])  # fmt: skip
def test_what_toys_look_like(toys: Store, tmp_path: Path, what: str, is_void: list[str], words: str) -> None:
    samples, options = made(toys, what)
    report = judge(toys, tmp_path / what, samples, **options)
    text = str(report)
    assert words in text
    assert [name for name in ("fid_k", "div_k", "bas", "pfc", "skating") if report[name].verdict == "void"] == is_void
    assert set(report.numbers()) == {
        "n_clips",
        *(s.name for s in report.scores if s.verdict != "void" and s.value is not None),
    }
    for table in (markdown([report]), latex([report])):
        for name in is_void:
            value = report[name].value
            assert not value or f"{value:.4f}" not in table
    if len(is_void) == 5:
        assert report.verdict.startswith("Nothing here is a result")
