"""The package's front door: build, plan, check and diff do what the commands do; features, encode, decode."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import dancedata
from dancedata import comparison
from dancedata.building.describe import store_json
from dancedata.building.plan import make_plan
from dancedata.core.errors import DanceDataError, DataError, RecipeError, UsageError
from dancedata.core.resources import resource
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.synthetic import Synthetic
from dancedata.recipes.parse import load_recipe
from dancedata.testing.examples import random_motion
from tests.commands import as_json, run
from tests.messages import raises_message

#: Small, and the same in the three ways to say it.
CHANGED = {"dataset.synthetic.songs": 2, "dataset.synthetic.clips_per_song": 2, "dataset.synthetic.clip_s": 6}
SET = [f"{key}={value}" for key, value in CHANGED.items()]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Any:
    """A small demo, built from Python, with its source next to it."""
    out = tmp_path_factory.mktemp("api") / "demo"
    return dancedata.build("demo", out=out, overrides=CHANGED, jobs=1, cache=cache, progress=False)


def test_build_prints_its_result(demo: Any) -> None:
    assert demo.built
    assert demo.path.with_name("demo-source").is_dir()
    about = store_json(demo.path)
    assert demo.counts == about["splits"]
    assert demo.left_out == about["rejects"]
    assert demo.notes == tuple(about["notes"])
    assert demo.summary.startswith("demo: 4 clips, ")
    assert repr(demo) == f"BuildResult({str(demo.path)!r}, 4 clips, 12 windows, 0 left out, built=True)"
    with demo.open() as ds:
        assert (ds.path, ds.info["licence"]) == (demo.path, Synthetic.licence)


def test_python_and_the_command_line_make_the_same_dataset(demo, tmp_path, hashes):
    out = tmp_path / "demo"
    words = [word for text in SET for word in ("--set", text)]
    source = demo.path.with_name("demo-source")
    text = run("build", "demo", source, "--out", out, *words, "--jobs", 1).stdout
    assert text == f"{demo.summary.replace(str(demo.path), str(out))}\n"
    assert hashes(out) == hashes(demo.path)
    again = dancedata.build("demo", source, out, overrides=SET, progress=False)
    assert not again.built
    assert again.counts == demo.counts
    assert run("build", "demo", source, "--out", out, *words, "--jobs", 1).stdout == f"{again.summary}\n"
    assert comparison.diff(demo.path, out) == []


def test_a_recipe_is_a_name_a_file_a_document_or_checked(demo: Any, tmp_path: Path) -> None:
    path = resource("pipelines", "demo.yaml")
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    before = json.dumps(document)
    ways: list[Any] = ["demo", path, str(path), document]
    plans = [make_plan(way, out=demo.path, overrides=CHANGED, progress=False) for way in ways]
    plans.append(make_plan(load_recipe("demo", SET), out=demo.path, progress=False))
    assert len({plan.recipe.sha256 for plan in plans}) == 1
    assert json.dumps(document) == before, "the caller's dict is left alone"
    with raises_message(UsageError, "parsed"):
        make_plan(load_recipe("demo"), out=demo.path, overrides=CHANGED)


def test_plan_prints_the_same_as_the_command(demo: Any) -> None:
    words = [word for text in SET for word in ("--set", text)]
    plan = make_plan("demo", out=demo.path, overrides=CHANGED, progress=False)
    arguments = ("build", "--dry-run", "demo", "--out", demo.path, *words)
    assert as_json(*arguments) == json.loads(json.dumps(plan.to_json()))
    assert run(*arguments).stdout == f"{plan.describe(demo.path)}\n"
    assert plan.summary == plan.describe(demo.path).replace(f" into {demo.path}", "", 1)
    assert "in the cache: 4 of 4 clips" in plan.summary


def test_progress_is_printed_or_not(demo: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_plan("demo", out=demo.path, overrides=CHANGED, cache=tmp_path)
    assert "measuring motion: 4/4" in capsys.readouterr().err
    make_plan("demo", out=demo.path, overrides=CHANGED, progress=False)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("call", [
    pytest.param(lambda: dancedata.build("aist++"), id="no source"),
    pytest.param(lambda: dancedata.build("demmo"), id="name"),
    pytest.param(lambda: dancedata.build("demo", jobs=0), id="jobs"),
    pytest.param(lambda: dancedata.build("demo", backend="slurm"), id="backend"),
    pytest.param(lambda: make_plan("aist++", "none"), id="no such source"),
    pytest.param(lambda: make_plan({"recipe": 1}), id="document"),
    pytest.param(lambda: dancedata.check("x", dataset="a", recipe="b"), id="two readers"),
    pytest.param(lambda: dancedata.check("x", overrides=["fps=30"]), id="overrides"),
    pytest.param(lambda: comparison.diff("none", "none"), id="no dataset"),
])  # fmt: skip
def test_errors_are_ours(call: Callable[[], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with raises_message(DanceDataError, "aist|backend|finished|overrides|reader|worker"):
        call()
    assert list(tmp_path.iterdir()) == []


def test_a_value_without_rotations_is_a_usage_error():
    with raises_message(UsageError, "SMPL24"):
        dancedata.encode(np.zeros((90, 72)), "edge151")  # type: ignore[arg-type]
    positions = dancedata.encode(random_motion(SMPL24, 30), "joints")
    with raises_message(UsageError, "turns"):
        dancedata.decode(positions, "joints")


def test_misspelt_names_are_explained(tmp_path: Path):
    motion = random_motion(SMPL24, 3)
    with raises_message(UsageError, "root_place"):
        dancedata.encode(motion, "edge")
    with raises_message(RecipeError, "height"):
        dancedata.encode(motion, "edge151", contacts="velo")
    with raises_message(DataError, "exist", where="none.wav", reason="missing_file"):
        dancedata.features(tmp_path / "none.wav", "librosa35")
    with pytest.raises(AttributeError, match="no attribute 'encoder'"):
        _ = dancedata.encoder
