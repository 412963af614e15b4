"""Distances between halves of a pool, beside every distance; metrics that a protocol does not have, by name."""

from copy import copy
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import sqrtm

import dancedata
from dancedata.core.errors import UsageError
from dancedata.evaluation.protocol import MotionRule, protocol_named
from dancedata.evaluation.scores import halves_of
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.metrics.physical_contact import Pfc
from dancedata.store import Store
from tests.messages import raises_message


def rows(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, len(Kinetic().columns)))


def test_halves_divide_clips_and_are_the_distance_of_their_rows() -> None:
    numbers, clips = rows(400), np.repeat(np.arange(100.0), 4)
    found = halves_of(Kinetic("fixed"), numbers, clips)
    assert list(found) == ["fid_k"]
    assert found == halves_of(Kinetic("fixed"), numbers, clips)
    first = np.arange(400) < 200
    pool = numbers[~first]
    one, two = ((part - pool.mean(0)) / pool.std(0) for part in (numbers[first], pool))
    covariances = [np.cov(part, rowvar=False) for part in (one, two)]
    root = sqrtm(covariances[0] @ covariances[1]).real
    by_hand = ((one.mean(0) - two.mean(0)) ** 2).sum() + np.trace(covariances[0] + covariances[1] - 2 * root)
    assert found["fid_k"] == pytest.approx(by_hand, rel=0.25)
    # Pieces of one clip that are alike are never in both halves: the halves then differ more.
    alike = np.repeat(rows(100), 4, axis=0)
    apart = halves_of(Kinetic("fixed"), alike, np.arange(400.0))["fid_k"]
    assert halves_of(Kinetic("fixed"), alike, clips)["fid_k"] > 1.2 * apart


def test_what_has_no_halves() -> None:
    assert halves_of(Pfc(), np.ones((8, 1)), np.arange(8.0)) == {}
    assert halves_of(Kinetic(), rows(9), np.repeat(np.arange(3.0), 3)) == {}


def test_a_report_and_a_pool_file_have_halves(store: Store, tmp_path: Path) -> None:
    report = dancedata.evaluate(store, bootstrap=0, save_pool=tmp_path / "pool.npz")
    scores = {score.name: score for score in report.scores}
    assert scores["fid_k"].halves is not None
    assert scores["fid_k"].halves > 0
    assert scores["div_k"].halves is None
    assert "halves" in str(report)
    assert report.to_json()["scores"]["fid_g"]["halves"] == scores["fid_g"].halves
    again = dancedata.evaluate(store, bootstrap=0, pool=tmp_path / "pool.npz")
    assert {s.name: s.halves for s in again.scores} == {s.name: s.halves for s in report.scores}


def test_a_metric_that_the_protocol_does_not_have(store: Store) -> None:
    protocol = copy(protocol_named("dancedata"))
    object.__setattr__(protocol, "motion", MotionRule("smpl24", 30))
    object.__setattr__(protocol, "measures", protocol.measures[:1])
    object.__setattr__(protocol, "music", None)
    whole = dancedata.evaluate(store, protocol=protocol, bootstrap=0)
    assert [score.name for score in whole.scores] == ["fid_k", "div_k"]
    report = dancedata.evaluate(store, protocol=protocol, metrics=["pbc", "fid_k"], bootstrap=0)
    assert [score.name for score in report.scores] == ["fid_k", "div_k", "pbc"]
    assert report["fid_k"] == whole["fid_k"]
    assert report.scores[2].n
    # A protocol without music gets the usual rule for a metric that needs beats.
    beats = dancedata.evaluate(store, protocol=protocol, metrics=["beat_alignment"], bootstrap=0)
    assert [score.name for score in beats.scores] == ["bas"]
    assert beats.scores[0].n


def test_unknown_metrics_and_those_of_groups(store: Store) -> None:
    for name in ("group_kinetic", "collision"):
        with raises_message(UsageError, "metric", where="protocol dancedata"):
            dancedata.evaluate(store, metrics=[name], bootstrap=0)
