"""Rooms of the house: no import circles, and every top-level module has a place in the layer contract."""

from __future__ import annotations

import ast
import graphlib
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def module_files(root: Path) -> dict[str, Path]:
    """Return the files of a package by the names of their modules."""
    found = {}
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(path: Path, modules: dict[str, Path]) -> set[str]:
    """Return the modules of the package that a file imports, also in functions and for type checkers."""
    found = set()
    for statement in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(statement, ast.Import):
            found |= {alias.name for alias in statement.names}
        elif isinstance(statement, ast.ImportFrom):
            assert not statement.level, f"{path}: a relative import"
            module = statement.module or ""
            # `from package import module` imports the module; other names come from the package.
            found |= {f"{module}.{a.name}" if f"{module}.{a.name}" in modules else module for a in statement.names}
    return found & modules.keys()


def circle(root: Path) -> list[str]:
    """Return the modules of a circle of imports; empty if there is none."""
    modules = module_files(root)
    sorter = graphlib.TopologicalSorter({name: imports(path, modules) for name, path in modules.items()})
    try:
        sorter.prepare()
    except graphlib.CycleError as error:
        return list(error.args[1])
    return []


def test_no_module_imports_itself_through_others() -> None:
    assert circle(ROOT / "dancedata") == []


def test_only_the_registry_imports_by_name() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in (ROOT / "dancedata").rglob("*.py")}
    named = [str(path) for path, text in texts.items() if re.search(r"""import_module\(\s*f?["']dancedata""", text)]
    assert named == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("from house import a", True),
        ("try:\n    from house.a import x\nexcept ImportError:\n    x = None", True),
        ("def f():\n    from house import a", True),
        ("import json", False),
    ],
)
def test_circles_are_found(tmp_path: Path, text: str, found: bool) -> None:
    house = tmp_path / "house"
    house.mkdir()
    (house / "__init__.py").write_text("")
    (house / "a.py").write_text("from house.b import y\nx = 1\n")
    (house / "b.py").write_text(f"{text}\ny = 1\n")
    assert bool(circle(house)) == found


def test_layers_name_every_module() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = next(contract for contract in settings["contracts"] if contract["type"] == "layers")
    named = [name.strip(" ()") for layer in layers["layers"] for name in layer.replace("|", ":").split(":")]
    package = ROOT / "dancedata"
    there = {path.stem for path in package.glob("*.py")} | {
        path.parent.name for path in package.glob("*/__init__.py")
    }
    assert layers["exhaustive"]
    assert sorted([*named, *layers["exhaustive_ignores"]]) == sorted(there - {"__init__"})
