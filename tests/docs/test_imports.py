"""The house: no import circles, rings that are broken less and less, a short road, and a place for every room."""

from __future__ import annotations

import graphlib
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dancedata import kernel
from tests.docs.pages import ROOT, load

RINGS = load(ROOT / "benchmarks" / "rings.py")
#: Pairs of files that break the rings, by rooms; the numbers only shrink, and the table ends empty.
BREAKS: dict[str, int] = {}
#: Most lines that a build of aist++ and a batch of it load.
ROAD = 19_543


def circle(root: Path) -> list[str]:
    """Return the modules of a circle of imports; empty if there is none."""
    modules = RINGS.module_files(root)
    arrows = {name: RINGS.imports(path, modules).keys() for name, path in modules.items()}
    sorter = graphlib.TopologicalSorter(arrows)
    try:
        sorter.prepare()
    except graphlib.CycleError as error:
        return list(error.args[1])
    return []


def test_no_module_imports_itself_through_others() -> None:
    assert circle(ROOT / "dancedata") == []


def test_rings_are_broken_less_and_less() -> None:
    pairs = RINGS.breaks()
    more = {rooms for rooms, number in RINGS.by_room(pairs).items() if number > BREAKS.get(rooms, 0)}
    new = [f"{a} -> {b}" for a, b in sorted(pairs) if not more.isdisjoint(RINGS.by_room({(a, b): set()}))]
    assert new == [], "pairs of rooms that broke the rings less: import the kernel and shelves alone"


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


@pytest.mark.parametrize(("text", "found"), [
    ("from house import a", True), ("try:\n    from house.a import x\nexcept ImportError:\n    x = None", True),
    ("def f():\n    from house import a", True), ("import json", False),
])  # fmt: skip
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
    named = [name.strip(" ()\n") for layer in layers["layers"] for name in layer.replace("|", ":").split(":")]
    package = ROOT / "dancedata"
    there = {path.stem for path in package.glob("*.py")} | {
        path.parent.name for path in package.glob("*/__init__.py")
    }
    assert layers["exhaustive"]
    assert sorted([*named, *layers["exhaustive_ignores"]]) == sorted(there - {"__init__"})
