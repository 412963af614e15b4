"""A unit that makes no dancer: flagged, in the summary, in plan and check; an error of a strict build."""

import shutil
from pathlib import Path

import pytest

from dancedata.building.build import build
from dancedata.building.part import Part, build_part
from dancedata.core.errors import DataError
from dancedata.core.implausible import describe_implausible
from dancedata.datasets.folder import Folder
from dancedata.recipes.parse import load_recipe
from dancedata.store import open_store
from tests.commands import run
from tests.messages import raises_message

RECIPE = """\
recipe: 1
name: mine
dataset: {folder: {unit: UNIT, up: y, fps: 60, music: optional}}
windows: {length_s: 2, stride_s: 1}
motion: {edge151: {}}
"""
BODY = "a skeleton of 0.0165 m, where 1 to 2.5 m is plausible"
ROOT = "the root rises and falls 0.001 times as far as the pose requires"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A BVH in centimetres, and SMPL's arrays, whose translation is in metres."""
    Folder().make_example(tmp_path / "example")
    source = tmp_path / "source"
    source.mkdir()
    shutil.copy(tmp_path / "example/motions/own.bvh", source)
    shutil.copy(tmp_path / "example/motions/smpl.npz", source)
    return source


def recipe(folder: Path, unit: str) -> Path:
    path = folder / f"{unit}.yaml"
    path.write_text(RECIPE.replace("UNIT", unit))
    return path


def test_flags_summary_plan_and_check(source: Path, tmp_path: Path) -> None:
    # In millimetres both are a thousand or ten times too small.
    mine, out = recipe(tmp_path, "mm"), tmp_path / "out"
    body = BODY.replace("0.0165", "0.162")
    common = ("--cache", tmp_path / "cache", "-q")
    planned = run("build", "--dry-run", mine, source, *common).output
    built = run("build", mine, source, "--out", out, "--jobs", 1, *common).output
    for text in (planned, built):
        assert "implausible: 2 clips; correct the unit that was declared" in text
        assert f"own: implausible_body: {body}" in text
        assert f"smpl: implausible_root: {ROOT}" in text
    with open_store(out) as store:
        assert [(f["clip"], f["kind"]) for f in store.quality] == [
            ("own", "implausible_body"), ("smpl", "implausible_root"),
        ]  # fmt: skip
        assert [clip.n_flags for clip in store] == [1, 1]
    for text in (run("check", source, "--recipe", mine, "-q").output, run("check", out).output):
        assert f"note: own: implausible_body: {body}" in text
        assert f"note: smpl: implausible_root: {ROOT}" in text


def test_strict_stops_before_and_after_the_build(source: Path, tmp_path: Path) -> None:
    made = load_recipe(recipe(tmp_path, "mm"))
    for number in range(2):
        with raises_message(DataError, "probably", where="own") as caught:
            build(made, source, tmp_path / "out", cache=tmp_path / "cache", strict=True)
        assert (caught.value.reason, caught.value.where) == ("implausible_body", "own")
        assert (tmp_path / "out/dataset.json").exists() == bool(number)
        build(made, source, tmp_path / "out", cache=tmp_path / "cache")
    with raises_message(DataError, "probably", where="own", reason="implausible_body"):
        build_part(made, source, Part(1, 1), cache=tmp_path / "cache", strict=True)
    (source / "own.bvh").unlink()
    with raises_message(DataError, "rises", where="smpl", reason="implausible_root"):
        build(made, source, tmp_path / "root", cache=tmp_path / "cache", strict=True)


@pytest.mark.parametrize(
    ("kind", "line"),
    [("root", "implausible: 6 clips; correct the unit"), ("elbows", "left and right in question: 6 clips; correct")],
)
def test_many_clips_are_counted(kind: str, line: str) -> None:
    lines = describe_implausible({"clip": f"take{k}", "kind": f"implausible_{kind}", "value": 9} for k in range(6))
    assert lines[0].startswith(f"  {line}")
    assert ["take2" in lines[3], lines[4:]] == [True, ["    ... 3 more"]]
