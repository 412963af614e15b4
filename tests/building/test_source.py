"""The spine knows no plug-in: no name of one in its source, no branch on one, and short ways through it."""

from __future__ import annotations

import ast
import dataclasses
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import dancedata
from dancedata.core.registry import ANNOTATORS, AUGMENTATIONS, FIELDS, FILTERS, RULES, TRANSFORMS
from dancedata.store import StoredClip

ROOT = Path(__file__).parents[2]


def stages(*names: str) -> dict[str, ast.Module]:
    """The files of `building` that these import, without the folders of plug-ins."""
    trees: dict[str, ast.Module] = {}
    for name in names:
        trees[f"{name}.py"] = tree = ast.parse((ROOT / f"dancedata/building/{name}.py").read_text(encoding="utf-8"))
        modules = [(n.module or "").split(".") for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        trees |= stages(*{m[2] for m in modules if m[:2] == ["dancedata", "building"] and len(m) == 3})
    return trees


#: The spine: the stages of a build, and what they stand on.
SPINE = stages("measuring", "spine")
#: Names that the spine gives to plug-ins.
PARTS = {
    "a", "annotator", "chosen", "f", "field", "maker", "rule", "step", "transform", "plugin", "parent_step", "self",
}  # fmt: skip


def words(tree: ast.Module) -> Iterator[str]:
    """The identifiers, modules and texts of a file, without docstrings."""
    docs = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from (*(node.module or "").split("."), *(alias.name for alias in node.names))
        for key in ("id", "attr", "arg", "name"):
            if isinstance(word := getattr(node, key, None), str):
                yield word
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node.value


def conditions(tree: ast.Module) -> Iterator[ast.expr]:
    """Everything that a file branches on."""
    for node in ast.walk(tree):
        if isinstance(node, ast.If | ast.IfExp | ast.While | ast.Assert):
            yield node.test
        elif isinstance(node, ast.comprehension):
            yield from node.ifs
        elif isinstance(node, ast.Match):
            yield node.subject


def is_about_a_plugin(test: ast.expr) -> bool:
    """Whether a condition reads a plug-in's name or kind, or asks for a class of plug-ins."""
    bases = {"Transform", "Field", "Annotator", "WindowRule", "Maker", "Plugin"}
    for node in ast.walk(test):
        of_part = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in PARTS
        if of_part and node.attr in ("name", "kind", "stage", "version", "__class__"):
            return True
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("isinstance", "type"):
            named = {n.id for arg in node.args[1:] for n in ast.walk(arg) if isinstance(n, ast.Name)}
            if (
                node.func.id == "type"
                or named & bases
                or any(name.endswith(("Rows", "Field")) for name in named - {"Rows"})
            ):
                return True
    return False


def test_no_capability_is_named_in_the_spine() -> None:
    registries = (FIELDS, TRANSFORMS, ANNOTATORS, RULES, AUGMENTATIONS, FILTERS)
    package = Path(dancedata.__file__).parent
    names = {name for r in registries for name in r.names() if Path(module_file(r.get(name))).is_relative_to(package)}
    names -= {field.name for field in dataclasses.fields(StoredClip)}  # a clip has a genre without any annotator
    assert {"repair", "facts", "curate", "mirror", "movement"} <= names
    classes = {r.get(name).__name__ for r in registries for name in names if name in r}
    found = {(file, word) for file, tree in SPINE.items() for word in words(tree) if word.lower() in names | classes}
    assert found == set()
    modules = {"transforms", "annotators", "rules", "fields"}
    imported = {
        (file, n.module) for file, tree in SPINE.items() for n in ast.walk(tree)
        if isinstance(n, ast.ImportFrom) and modules & {*(n.module or "").split(".")}
    }  # fmt: skip
    assert imported == set()


def module_file(cls: type) -> str:
    """The file of a class's module; local plug-ins of other tests have none in the package."""
    return getattr(sys.modules[cls.__module__], "__file__", None) or "/"


def test_the_spine_branches_on_no_plugin() -> None:
    found = [(file, ast.unparse(t)) for file, tree in SPINE.items() for t in conditions(tree) if is_about_a_plugin(t)]
    assert found == []
    # The check sees what it has to.
    for line in (
        "field.kind != 'audio'",
        "step.name == 'mirror'",
        "isinstance(field, MusicField)",
        "type(step) is X",
    ):
        assert is_about_a_plugin(ast.parse(line, mode="eval").body)


def test_the_main_function_has_no_branch() -> None:
    (main,) = (n for n in ast.walk(SPINE["spine.py"]) if isinstance(n, ast.FunctionDef) and n.name == "build_clips")
    assert not [n for n in ast.walk(main) if isinstance(n, ast.If | ast.IfExp)]
    assert len(main.body) <= 10


def test_parts_of_recipes_and_inputs_travel_little() -> None:
    spec = importlib.util.spec_from_file_location("walk", ROOT / "benchmarks" / "walk.py")
    assert spec is not None
    assert spec.loader is not None
    walk = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "walk", walk)
        spec.loader.exec_module(walk)
    trips = walk.parts()
    assert trips.keys() >= {"takes", "transforms", "fields", "annotators", "rules", "windows"}
    for name, trip in trips.items():
        stays, returns = (20, 12) if name == "takes" else (12, 3)
        assert 0 < len(trip.stays) <= stays, f"{name}: {trip}"
        assert trip.returns <= returns, f"{name}: {trip}"
    most = {
        "a batch": 8, "the input of an evaluation": 35, "the music of an evaluation": 43,
        "a store into the report": 3, "a source into a scan": 1,
    }  # fmt: skip
    assert {name: trip for name, trip in walk.ways().items() if len(trip.stays) > most[name]} == {}
