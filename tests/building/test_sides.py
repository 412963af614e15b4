"""Left, right and up from the source to a built dataset: rejects, flags, strict builds, the cache, `check`."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.building.annotators import vitals
from dancedata.building.build import build
from dancedata.building.check import check
from dancedata.building.plan import make_plan
from dancedata.core.errors import DataError
from dancedata.datasets.folder import Folder
from dancedata.recipes.parse import load_recipe
from dancedata.recipes.recipe import Recipe
from dancedata.store import open_store
from tests.messages import raises_message

RECIPE = """\
recipe: 1
name: mine
dataset: {folder: {unit: m, up: y, fps: 60, music: optional}}
windows: {length_s: 2, stride_s: 1}
motion: {FIELD: {}}
audio: {}
"""


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("example")
    Folder().make_example(folder)
    return folder / "motions"


@pytest.fixture
def mirrored(example: Path, tmp_path: Path) -> Path:
    """A folder with SMPL's arrays reflected across x = 0, their joints in the old order."""
    source = tmp_path / "mirrored"
    source.mkdir()
    with np.load(example / "smpl.npz") as arrays:
        poses = arrays["poses"].reshape(-1, 24, 3) * (1, -1, -1)
        np.savez(source / "take.npz", poses=poses.reshape(-1, 72), trans=arrays["trans"] * (-1, 1, 1))
    return source


def recipe(folder: Path, field: str = "edge151") -> Recipe:
    path = folder / f"{field}.yaml"
    path.write_text(RECIPE.replace("FIELD", field))
    return load_recipe(path)


def notes(path: Path, **parameters: Any) -> list[tuple[str, str, str]]:
    found = check(path, **parameters)
    return [(p.severity, p.where, p.message.split(":")[0]) for p in found if "implausible" in p.message]


def test_mirrored_arrays_are_flagged(mirrored: Path, tmp_path: Path) -> None:
    made, cache, flag = recipe(tmp_path), tmp_path / "cache", ("note", "take", "implausible_elbows")
    build(made, mirrored, tmp_path / "out", cache=cache)
    with open_store(tmp_path / "out") as store:
        assert [(row["clip"], row["kind"]) for row in store.quality] == [("take", "implausible_elbows")]
    assert notes(mirrored, dataset=made.dataset) == notes(tmp_path / "out") == [flag]
    assert "left and right in question: 1 clip" in make_plan(made, mirrored, cache=cache).summary
    with raises_message(DataError, "usual", where="take", reason="implausible_elbows"):
        build(made, mirrored, tmp_path / "strict", cache=cache, strict=True)


@pytest.mark.parametrize(
    ("field", "kind"), [("edge151", "implausible_elbows"), ("joints", "implausible_up"), ("humanml263", "")]
)
def test_check_finds_it_in_a_dataset_without_flags(mirrored, tmp_path, monkeypatch, field, kind):
    if kind == "implausible_up":
        (mirrored / "manifest.csv").write_text("motion,up\ntake.npz,-y\n")
    monkeypatch.setattr(vitals, "quality_flags", lambda motion: [])
    build(recipe(tmp_path, field), mirrored, tmp_path / "out", cache=tmp_path / "cache")
    with open_store(tmp_path / "out") as store:
        assert store.quality == []
    assert notes(tmp_path / "out") == [("note", "take", kind)] * bool(kind)
