"""docs/reference/inside.md is true: its rooms, the picture of its layers, and the functions that data pass."""

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import dancedata
from tests.docs.pages import ROOT

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
