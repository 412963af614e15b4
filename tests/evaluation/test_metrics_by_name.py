"""Metrics that a protocol does not have, by name."""

from copy import copy

import dancedata
from dancedata.core.errors import UsageError
from dancedata.evaluation.protocol import MotionRule, protocol_named
from dancedata.store import Store
from tests.messages import raises_message


def test_a_metric_that_the_protocol_does_not_have(store: Store) -> None:
    protocol = copy(protocol_named("dancedata"))
    object.__setattr__(protocol, "motion", MotionRule("smpl24", 30))
    object.__setattr__(protocol, "measures", protocol.measures[:1])
    object.__setattr__(protocol, "music", None)
    whole = dancedata.evaluate(store, split="all", protocol=protocol, intervals=False)
    assert [score.name for score in whole.scores] == ["fid_k", "div_k"]
    report = dancedata.evaluate(store, split="all", protocol=protocol, metrics=["pbc", "fid_k"], intervals=False)
    assert [score.name for score in report.scores] == ["fid_k", "div_k", "pbc"]
    assert report["fid_k"].value == whole["fid_k"].value
    assert report.scores[2].n
    # A protocol without music gets the usual rule for a metric that needs beats.
    beats = dancedata.evaluate(store, split="all", protocol=protocol, metrics=["beat_alignment"], intervals=False)
    assert [score.name for score in beats.scores] == ["bas"]
    assert beats.scores[0].n


def test_unknown_metrics_and_those_of_groups(store: Store) -> None:
    for name in ("group_kinetic", "collision"):
        with raises_message(UsageError, "metric", where="protocol dancedata"):
            dancedata.evaluate(store, split="all", metrics=[name], intervals=False)
