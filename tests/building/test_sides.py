"""Left, right and up of a built dataset whose flags were not stored: `check` computes them."""

from pathlib import Path

import numpy as np
import pytest

from dancedata.building.annotators import vitals
from dancedata.building.build import build
from dancedata.building.check import check
from dancedata.datasets.folder import Folder
from dancedata.recipes.parse import load_recipe
from dancedata.recipes.recipe import Recipe
from dancedata.store import open_store

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


def recipe(folder: Path, field: str) -> Recipe:
    path = folder / f"{field}.yaml"
    path.write_text(RECIPE.replace("FIELD", field))
    return load_recipe(path)


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
    found = [p for p in check(tmp_path / "out") if "implausible" in p.message]
    assert [(p.severity, p.where, p.message.split(":")[0]) for p in found] == [("note", "take", kind)] * bool(kind)
