"""dancedata new: every template passes the conformance suite unchanged, and nothing is overwritten."""

import importlib
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dancedata.building import plugins as building
from dancedata.cli.plugins import KINDS, write_plugin
from dancedata.core.errors import UsageError
from dancedata.core.registry import REGISTRIES
from dancedata.exports.base.job import EXPORTS
from dancedata.files.yaml import load_yaml
from dancedata.testing.conformance import check
from tests.commands import as_json, run
from tests.messages import raises_message


def test_every_kind_has_a_template() -> None:
    assert {id(kind.registry) for kind in KINDS.values()} == {
        id(registry) for registry in (*REGISTRIES.values(), *building.REGISTRIES.values(), EXPORTS)
    }
    text = " ".join(run("new", "--help").stdout.split())
    assert all(kind in text for kind in KINDS)


# The second name is that of a class that templates import.
@pytest.mark.parametrize("name", ["my_first2", "motion"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_template_passes_as_it_is(kind: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = write_plugin(kind, name, tmp_path / "here")
    registry = made.kind.registry
    registry.names()
    monkeypatch.setattr(registry, "_classes", dict(registry._classes))
    monkeypatch.syspath_prepend(tmp_path / "here")
    importlib.import_module(name)
    try:
        assert name in registry.names()
        if name == "my_first2":
            check(registry.get(name), tmp_path)
    finally:
        del sys.modules[name]


@pytest.mark.parametrize("kind", KINDS)
def test_next_steps(kind: str, tmp_path: Path) -> None:
    done = run("new", kind, "shake", "--out", tmp_path / "a folder")
    assert sorted(p.name for p in (tmp_path / "a folder").iterdir()) == ["shake.py", "test_shake.py"]
    group = KINDS[kind].registry.package
    assert f'[project.entry-points."{group}"]\nshake = "shake"\n' in done.stdout
    assert f"'{tmp_path}/a folder/test_shake.py'" in done.stdout
    if kind == "metric":
        assert 'it is used by: METRICS.get("shake")().measure(dance)' in done.stdout
        return
    if kind == "export":
        assert "it is used by: dancedata export STORE --to shake --out DIR" in done.stdout
        return
    recipe = load_yaml(done.stdout.split("a recipe may have: ")[1].splitlines()[0])
    assert "shake" in json.dumps(recipe)


def test_as_json(tmp_path: Path) -> None:
    about = as_json("new", "filter", "shake", "--out", tmp_path)
    assert about == {
        "name": "shake",
        "group": "dancedata.filters",
        "module": str(tmp_path / "shake.py"),
        "test": str(tmp_path / "test_shake.py"),
    }


@pytest.mark.parametrize(
    ("plugin", "word"),
    [
        ("augmentatoin shake", "'augmentation'"), ("augmentation mirror", "exists already"),
        ("filter two-words", "not a valid name"), ("filter class", "not a valid name"),
        ("filter _hidden", "not a valid name"), ("filter ../up", "not a valid name"),
        ("filter random", "random is the name of an installed Python module"),
        ("filter numpy", "numpy is the name of an installed Python module"),
    ],
)  # fmt: skip
def test_bad_names(plugin: str, word: str, tmp_path: Path) -> None:
    assert word in run("new", *plugin.split(), "--out", tmp_path / "out", code=2).stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("taken", ["shake.py", "test_shake.py"])
def test_nothing_is_overwritten(taken: str, tmp_path: Path) -> None:
    (tmp_path / taken).write_text("mine")
    with raises_message(UsageError, "exists"):
        write_plugin("filter", "shake", tmp_path)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [(taken, "mine")]


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with raises_message(UsageError, "plug-in", where="file/out"):
        write_plugin("filter", "shake", tmp_path / "file" / "out")


def test_a_package_holds_several_kinds(tmp_path: Path) -> None:
    """Their tests pass, and so does that of a plug-in by itself."""
    done = run("new", "contact-rule", "toes", "--out", tmp_path, "--package", "my_dance")
    assert f"python -m pytest {tmp_path}/my_dance" in done.stdout
    run("new", "metric", "reach", "--out", tmp_path, "--package", "my_dance")
    about = as_json("new", "contact-rule", "heels", "--out", tmp_path, "--package", "my_dance")
    assert about["package"] == "my_dance"
    root = tmp_path / "my_dance"
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    assert project["entry-points"] == {
        "dancedata.contacts": {"toes": "my_dance.toes", "heels": "my_dance.heels"},
        "dancedata.metrics": {"reach": "my_dance.reach"},
    }
    alone = write_plugin("contact-rule", "sole", tmp_path / "alone").test
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", ".", str(alone)]
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done_tests = subprocess.run(command, cwd=root, capture_output=True, text=True, env=environment, check=False)
    assert "4 passed" in done_tests.stdout, done_tests.stdout


@pytest.mark.parametrize(("name", "package"), [("toes", "a-b"), ("toes", "numpy"), ("toes", "theirs")])
def test_packages_that_cannot_be_written(name: str, package: str, tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs/pyproject.toml").write_text("[project]\n")
    with raises_message(UsageError, "package") if package != "numpy" else pytest.raises(UsageError, match="numpy is"):
        write_plugin("contact-rule", name, tmp_path, package)
    assert not list(tmp_path.rglob("*.py"))
