"""Reports: names in tables, numbers that overflow, files that are not replaced."""

import csv
import json
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import UsageError
from dancedata.evaluation.pool import load_pool
from dancedata.evaluation.protocol import MotionRule, protocol_named
from dancedata.evaluation.protocols.aistpp import BailandoAistpp
from dancedata.evaluation.tables import latex, markdown
from dancedata.metrics.kinetic_features import Kinetic
from dancedata.scene.inputs.songs import read_songs
from dancedata.store import Store
from tests.evaluation.test_command import run
from tests.evaluation.test_refusals import beats_of_music, dance, dances
from tests.messages import raises_message


def test_names_in_tables() -> None:
    report = dancedata.evaluate(dances(), fps=30, metrics=["pfc"], intervals=False)
    hostile = replace(report, source="/home/me/~a^b_<c>\\|%")
    assert r"\textasciitilde{}a\textasciicircum{}b\_\textless{}c\textgreater{}" in latex([hostile])
    assert r"\textbackslash{}\textbar{}\%" in latex([hostile])
    assert r"| ~a^b_\<c>\\\|% |" in markdown([hostile])
    protocol = BailandoAistpp()
    object.__setattr__(protocol, "name", "my_protocol")
    one = replace(report, protocol=protocol, clips=("d0",), recordings=1)
    assert r"\caption{Protocol my\_protocol, version 1; 1 clip, 30 frames" in latex([one])


def test_several_sets_have_a_row_each(store: Store) -> None:
    how: dict[str, Any] = {"fps": 30, "intervals": False, "pool": store}
    reports = [dancedata.evaluate(what, metrics=["pfc", "kinetic"], **how) for what in (dances(), store)]
    of_one = dancedata.evaluate(dances(), metrics=["pfc"], **how)
    lines = markdown([of_one, reports[1]]).split("\n")
    assert {line.count("|") for line in (lines[0], *lines[2:4])} == {5}
    assert [line.split(" | ")[0] for line in lines[2:4]] == ["| clips in memory", "| small, split test"]
    assert sum("Protocol" in line for line in lines) == 2
    assert latex(reports).count(r"\begin{table}") == 1


@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
@pytest.mark.parametrize("intervals", [False, True])
def test_numbers_that_overflow_are_undefined_by_name(store: Store, intervals: bool) -> None:
    far = dances() | {"far": dance() * 1e100}
    report = dancedata.evaluate(far, fps=30, pool=store, intervals=intervals)
    found = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert found["scores"]["fid_k"]["value"] is None
    assert found["scores"]["fid_k"]["undefined"] == {"not_finite": []}
    assert "the numbers overflow (not_finite)" in str(report)


def test_scores_and_clips_as_tables_of_pandas(store: Store) -> None:
    pytest.importorskip("pandas")
    report = dancedata.evaluate(store, split="all", metrics=["pfc", "skating"])
    scores = report.to_pandas().set_index("score")
    assert list(scores.index) == [score.name for score in report.scores]
    assert list(scores["verdict"]) == [score.verdict for score in report.scores]
    assert scores.loc["pfc", "value"] == report["pfc"].value
    assert {"low", "high", "reason", "recordings", "truth", "same_n_median"} <= set(scores.columns)
    clips = report.to_pandas("clips")
    assert clips.to_dict("records") == [dict(row) for row in report.per_clip]
    with raises_message(UsageError, "table"):
        report.to_pandas("score")


def test_intervals_stay_within_the_range_of_a_score(store: Store) -> None:
    report = dancedata.evaluate(store, split="all", metrics=["pfc", "skating"])
    intervals = {score.name: score.interval for score in report.scores}
    assert set(intervals) == {"pfc", "skating_left", "skating_right", "skating"}
    assert intervals["pfc"] is not None
    for name, interval in intervals.items():
        if interval is not None:
            assert 0 <= interval.low < report[name].value < interval.high <= (np.inf if name == "pfc" else 1)


def test_tables_of_clips_are_not_run_by_spreadsheets(tmp_path: Path) -> None:
    names = ["=1+1", "+a", "-a", "@a", "\ta", "\ra", "'=a", "'a", "a=,b"]
    folder = tmp_path / "generated"
    folder.mkdir()
    for name in names:
        np.save(folder / f"{name}.npy", dance())
    run(
        folder, "--fps", 30, "--up", "y", "--protocol", "popdg", "--metric", "pbc", "--jobs", 1,
        "--out", tmp_path / "rows.csv", "--quiet",
    )  # fmt: skip
    with open(tmp_path / "rows.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(names)
    assert not [row["clip"] for row in rows if row["clip"][0] in "=+-@\t\r"]
    assert all(np.isfinite(float(row["pbc"])) for row in rows)  # numbers, including those below 0, unchanged
    with open(tmp_path / "songs.csv", "w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows((row["clip"], "song") for row in rows)
    assert set(read_songs(tmp_path / "songs.csv")) == set(names)


def test_clips_in_memory_that_are_not_dances() -> None:
    for clips, message in (
        ({0: dance()}, "a clip's id must be a string; found 0, int"),
        ({"a": [["x"]]}, "clip a: the joints are not real numbers"),
        ({"a": dance().astype(complex)}, "clip a: the joints are not real numbers; found complex128"),
        ({"a": [[1, 2], [3]]}, "clip a: the joints are not an array"),
    ):
        with pytest.raises(UsageError, match=message):
            dancedata.evaluate(clips, fps=30)  # type: ignore[arg-type]


def test_only_the_requested_metrics(store: Store, tmp_path: Path) -> None:
    whole = dancedata.evaluate(store, split="test", intervals=False)
    for metrics, names in (
        (["pfc"], ["pfc"]), (["fid_k"], ["fid_k", "div_k"]),
        (["skating", "kinetic"], ["fid_k", "div_k", "skating_left", "skating_right", "skating"]), (["bas"], ["bas"]),
    ):  # fmt: skip
        found = dancedata.evaluate(store, split="test", metrics=metrics, intervals=False)
        assert {s.name: s.value for s in found.scores} == {name: whole[name].value for name in names}
    found = dancedata.evaluate(store, split="all", metrics=["pfc"], save_pool=tmp_path / "pool.npz", intervals=False)
    again = dancedata.evaluate(store, pool=tmp_path / "pool.npz", split="test", intervals=False)
    assert again["fid_k"].value == whole["fid_k"].value  # a pool is whole, for any request
    text = run(store.path, "--metric", "pfc", "--metric", "bas", "--split", "test", "--quiet", "--jobs", 1)
    assert "  PFC " in text
    assert "FID" not in text
    assert "nown: bas, beat_alignment, " in run(store.path, "--metric", "fid", code=2)


def test_only_beats_without_music() -> None:
    with raises_message(UsageError, "could", where="clips in memory"):
        dancedata.evaluate(dances(), fps=30, metrics=["bas"])
    some = dancedata.evaluate(
        dances(n_frames=200), fps=30, metrics=["bas"], music={"d0": beats_of_music()}, intervals=False
    )
    assert [s.undefined for s in some.scores] == [{"no_music": ("d1", "d2")}]
    assert some.fps == "30"


def test_a_pool_that_cannot_be_written_is_refused_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.evaluation.evaluate.measure_clips", None)  # would be called
    for path, message in ((tmp_path / "a.txt", "a pool is an .npz file"), (tmp_path / "x" / "p.npz", "the folder")):
        with pytest.raises(UsageError, match=message):
            dancedata.evaluate(dances(), fps=30, pool=dances(), save_pool=path)


def test_pools_of_other_metrics_and_with_nan_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, protocol = tmp_path / "pool.npz", BailandoAistpp()
    dancedata.evaluate(dances(), protocol=protocol, fps=60, pool=dances(4), save_pool=path, intervals=False)
    monkeypatch.setattr(Kinetic, "version", Kinetic.version + 1)
    with raises_message(UsageError, "metrics", where="pool.npz"):
        load_pool(path, protocol)
    monkeypatch.undo()
    with np.load(path) as file:
        arrays = dict(file)
    arrays["rows_0"][1, 2] = np.nan
    np.savez(path, allow_pickle=False, **arrays)
    with raises_message(UsageError, "--out", where="pool.npz"):
        load_pool(path, protocol)


def test_scores_do_not_depend_on_the_order_of_the_pool() -> None:
    pool = {f"p{k}": dance(seed=20 + k) for k in range(7)}
    turned = dict(reversed(pool.items()))
    found = [
        dancedata.evaluate(dances(), fps=30, pool=p, metrics=["kinetic"], intervals=False) for p in (pool, turned)
    ]
    assert found[0].to_json() == found[1].to_json()


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
