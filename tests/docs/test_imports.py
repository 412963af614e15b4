"""The house: no import circles, whole rings, a short road, and satellites that can be taken out."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

import dancedata
from dancedata import kernel
from tests.docs.pages import ROOT, load

RINGS = load(ROOT / "benchmarks" / "rings.py")
#: Most lines that a build of aist++ and a batch of it load.
ROAD = 19_516


def circles(root: Path) -> list[int]:
    """Return the sizes of the circles of imports of a package."""
    modules = RINGS.module_files(root)
    return list(RINGS.circles({name: set(RINGS.imports(path, modules)) for name, path in modules.items()}))


def test_no_module_imports_itself_through_others() -> None:
    assert circles(ROOT / "dancedata") == []


@pytest.mark.parametrize(("text", "sizes"), [
    ("from house import a", [2]), ("try:\n    from house.a import x\nexcept ImportError:\n    x = None", [2]),
    ("def f():\n    from house import a", [2]), ("import json", []),
])  # fmt: skip
def test_circles_are_found(tmp_path: Path, text: str, sizes: list[int]) -> None:
    house = tmp_path / "house"
    house.mkdir()
    (house / "__init__.py").write_text("")
    (house / "a.py").write_text("from house.b import y\nx = 1\n")
    (house / "b.py").write_text(f"{text}\ny = 1\n")
    assert circles(house) == sizes


def test_no_pair_of_files_breaks_the_rings() -> None:
    assert RINGS.breaks() == {}


def test_satellites_import_the_public_names_of_the_kernel() -> None:
    assert RINGS.names_of_kernel() == {}
    assert len(kernel.__all__) <= 60


def test_the_road_of_a_build_and_a_batch_is_short() -> None:
    assert RINGS.lines(RINGS.road()[-1]) <= ROAD


#: Satellites whose plug-ins the demo names.
NAMED = {"audio", "contacts", "datasets", "representations"}
SATELLITES = {
    room for name in RINGS.module_files(ROOT / "dancedata") for place in [RINGS.Place.of(name)]
    if (room := place.room) and place.ring == "satellite"
}  # fmt: skip
DEMO = """
import sys, dancedata
small = {f"dataset.synthetic.{key}": n for key, n in {"songs": 2, "clips_per_song": 2, "clip_s": 6}.items()}
options = {"overrides": {**small, "dataset.synthetic.split": "all"}, "cache": "cache", "progress": False}
dancedata.build("demo", out="out", jobs=1, **options)
print(*sorted({name.split(".")[1] for name in sys.modules if name.startswith("dancedata.")}))
"""


def demo_without(rooms: set[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Build the demo with a package that lacks rooms."""
    (folder / "dancedata").mkdir()
    for path in (ROOT / "dancedata").iterdir():
        if path.stem not in rooms:
            (folder / "dancedata" / path.name).symlink_to(path)
    for name in ("pipelines", "manifests"):
        (folder / name).symlink_to(ROOT / name)
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run([sys.executable, "-c", DEMO], cwd=folder, env=environment, capture_output=True, text=True)


def test_the_demo_is_built_without_the_satellites_that_it_does_not_name(tmp_path: Path) -> None:
    done = demo_without(SATELLITES - NAMED, tmp_path)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) & SATELLITES <= NAMED


@pytest.mark.parametrize("room", sorted(NAMED))
def test_without_a_satellite_the_error_names_its_plug_in(room: str, tmp_path: Path) -> None:
    done = demo_without({room}, tmp_path)
    words = {"audio": "librosa35", "contacts": "velocity", "datasets": "synthetic", "representations": "edge151"}
    assert done.returncode != 0
    assert re.search(rf"dancedata\.core\.errors\.\w+Error: .*unknown .*{words[room]}", done.stderr, flags=re.DOTALL)


@pytest.mark.nightly
@pytest.mark.parametrize("room", sorted(SATELLITES - NAMED))
def test_the_demo_is_built_without_each_satellite(room: str, tmp_path: Path) -> None:
    done = demo_without({room}, tmp_path)
    assert done.returncode == 0, done.stderr


def test_only_the_registry_imports_by_name() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in (ROOT / "dancedata").rglob("*.py")}
    named = [str(path) for path, text in texts.items() if re.search(r"""import_module\(\s*f?["']dancedata""", text)]
    assert named == []


# docs/reference/inside.md is true: its rooms, the picture of its layers, and the functions that data pass.


PAGE = (ROOT / "docs" / "reference" / "inside.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def function_of(path: str) -> Callable[..., Any]:
    module, _, name = path.rpartition(".")
    found = getattr(importlib.import_module(module), name)
    assert found.__module__ == module, f"{path} is defined in {found.__module__}"
    return found


def first_column(text: str) -> list[str]:
    return re.findall(r"^\| `([^`]+)` \|", text, flags=re.MULTILINE)


def test_the_rooms_are_those_of_the_tree_and_of_the_picture() -> None:
    package = ROOT / "dancedata"
    modules = {path.name.removesuffix(".py") for path in package.iterdir() if path.suffix == ".py"}
    rooms = {path.parent.name for path in package.glob("*/__init__.py")}
    listed = sorted(first_column(section("Rooms")))
    assert listed == sorted((modules | rooms) - {"__init__", "__main__"})
    picture = (ROOT / "docs" / "images" / "layers.svg").read_text(encoding="utf-8")
    assert sorted(re.findall(r'class="name" text-anchor="start">(\w+)<', picture)) == listed


def test_every_function_on_the_page_exists() -> None:
    named = set(re.findall(r"`(dancedata(?:\.\w+)+)`", PAGE))
    modules = {name for name in named if (ROOT / name.replace(".", "/")).with_suffix(".py").exists()}
    modules |= {name for name in named if (ROOT / name.replace(".", "/")).is_dir()}
    assert len(named - modules) >= 10
    for name in named - modules:
        assert callable(function_of(name))
    for name in modules:
        importlib.import_module(name)


def test_data_pass_the_functions_in_this_order(tmp_path: Path) -> None:
    names = first_column(section("From build to write_store").split("One function runs in workers")[0])
    assert len({name.rpartition(".")[0] for name in names}) == len(names) >= 8, "each file once"
    codes: dict[CodeType, str] = {function_of(name).__code__: name for name in names}
    passed: list[str] = []

    def trace(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call" and frame.f_code in codes:
            passed.append(codes[frame.f_code])

    small = {"dataset.synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 6, "split": "all"}, "audio": {}}
    before = sys.getprofile()
    sys.setprofile(trace)
    try:
        dancedata.build(
            "demo", out=tmp_path / "demo", overrides=small, jobs=1, cache=tmp_path / "cache", progress=False
        )
    finally:
        sys.setprofile(before)
    assert passed == names
