"""dancedata init --plugin-kind: every template passes the conformance suite unchanged, and nothing is overwritten."""

import ast
import importlib
import json
import sys
import tomllib
from pathlib import Path

import pytest

from dancedata.cli.plugins import KINDS, write_plugin
from dancedata.core.errors import UsageError
from dancedata.core.registry import REGISTRIES
from dancedata.exports.base.job import EXPORTS
from dancedata.files.yaml import load_yaml
from dancedata.testing.conformance import check
from tests import warm
from tests.commands import as_json, run
from tests.messages import raises_message


def test_every_kind_has_a_template() -> None:
    assert {id(kind.registry) for kind in KINDS.values()} == {
        id(registry) for registry in (*REGISTRIES.values(), EXPORTS)
    }
    text = as_json("init", "x", "--plugin-kind", "nothing", code=2)["fix"]
    assert all(kind in text for kind in KINDS)


# The second name is that of a class that templates import.
@pytest.mark.parametrize("name", ["my_first2", "motion"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_template_passes_as_it_is(kind: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    made = write_plugin(kind, name, Path())
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
def test_next_steps(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = run("init", "shake", "--plugin-kind", kind)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["shake.py", "test_shake.py"]
    group = KINDS[kind].registry.package
    assert f'[project.entry-points."{group}"]\nshake = "shake"\n' in done.stdout
    assert "python -m pytest test_shake.py" in done.stdout
    if kind == "metric":
        assert 'it is used by: METRICS.get("shake")().measure(dance)' in done.stdout
        return
    if kind == "export":
        assert "it is used by: dancedata export DATASET --to shake --out DIR" in done.stdout
        return
    recipe = load_yaml(done.stdout.split("a recipe may have: ")[1].splitlines()[0])
    assert "shake" in json.dumps(recipe)


@pytest.mark.parametrize(
    ("plugin", "word"),
    [
        ("augmentatoin shake", "'augmentation'"), ("augmentation mirror", "exists already"),
        ("filter two-words", "not a valid name"), ("filter class", "not a valid name"),
        ("filter _hidden", "not a valid name"), ("filter ../up", "--out DIR"),
        ("filter random", "random is the name of an installed Python module"),
        ("filter numpy", "numpy is the name of an installed Python module"),
    ],
)  # fmt: skip
def test_bad_names(plugin: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    kind, name = plugin.split()
    assert word in run("init", name, "--plugin-kind", kind, code=2).stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("taken", ["shake.py", "test_shake.py"])
def test_nothing_is_overwritten(taken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / taken).write_text("mine")
    monkeypatch.chdir(tmp_path)
    with raises_message(UsageError, "exists"):
        write_plugin("filter", "shake", Path())
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [(taken, "mine")]


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with raises_message(UsageError, "plug-in", where="file/out"):
        write_plugin("filter", "shake", tmp_path / "file" / "out")


def test_a_package_holds_several_kinds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their tests pass, and so does that of a plug-in by itself."""
    root = tmp_path / "my_dance"
    done = run("init", "toes", "--plugin-kind", "contact-rule", "--out", root)
    assert f"python -m pytest {root}" in done.stdout
    run("init", "reach", "--plugin-kind", "metric", "--out", root)
    assert as_json("init", "heels", "--plugin-kind", "contact-rule", "--out", root)["package"] == "my_dance"
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    assert project["entry-points"] == {
        "dancedata.contacts": {"toes": "my_dance.toes", "heels": "my_dance.heels"},
        "dancedata.metrics": {"reach": "my_dance.reach"},
    }
    alone = write_plugin("contact-rule", "sole", tmp_path / "others").test
    monkeypatch.chdir(root)
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    code = f"import pytest; pytest.main(['-q', '-p', 'no:cacheprovider', '.', {str(alone)!r}])"
    done_tests = warm.run([sys.executable, "-c", code])
    assert "4 passed" in done_tests.stdout, done_tests.stdout


@pytest.mark.parametrize(("name", "package"), [("toes", "a-b"), ("toes", "numpy"), ("toes", "theirs")])
def test_packages_that_cannot_be_written(name: str, package: str, tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs/pyproject.toml").write_text("[project]\n")
    with raises_message(UsageError, "package") if package != "numpy" else pytest.raises(UsageError, match="numpy is"):
        write_plugin("contact-rule", name, tmp_path / package)
    assert not list(tmp_path.rglob("*.py"))


def test_a_dataset_in_a_checkout(tmp_path: Path) -> None:
    """Reader, recipe, page, test and a line of changes, where they belong; the test passes."""
    for folder in ("dancedata/datasets", "pipelines", "docs/datasets", "tests/datasets"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## [Unreleased]\n\n## [0.1]\n")
    about = as_json("init", "lab19", "--plugin-kind", "dataset", "--in-tree", "--out", tmp_path)
    names = [str(Path(path).relative_to(tmp_path)) for path in about["files"]]
    assert names == [
        "dancedata/datasets/lab19.py", "tests/datasets/test_lab19.py", "pipelines/lab19.yaml",
        "docs/datasets/lab19.md",
        "CHANGELOG.md",
    ]  # fmt: skip
    assert "`lab19`" in (tmp_path / "CHANGELOG.md").read_text().split("## [0.1]")[0]
    assert "from dancedata.datasets.lab19 import Lab19" in (tmp_path / names[1]).read_text()
    for tree in (ast.parse((tmp_path / name).read_text()) for name in names[:2]):
        nodes = list(ast.walk(tree))
        imports = {(a.asname or a.name) for n in nodes if isinstance(n, ast.Import | ast.ImportFrom) for a in n.names}
        assert imports <= {node.id for node in nodes if isinstance(node, ast.Name)} | {"annotations"}
    assert load_yaml((tmp_path / names[2]).read_text())["dataset"] == {"lab19": {}}
