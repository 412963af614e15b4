"""A small dataset that every reader test here reads: four fields, music and key motions, track scope."""

from pathlib import Path

import pytest

from dancedata.building.build import build
from dancedata.core.registry import DATASETS
from dancedata.recipes.parse import parse_recipe

RECIPE = {
    "recipe": 1, "name": "small", "fps": 30, "windows": {"length_s": 2, "stride_s": 0.5},
    "dataset": {"synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 5}},
    "motion": {"edge151": {}, "lodge139": {}, "joints": {}, "fact219": {}},
    "keymotion": {"lodge": {}}, "audio": {"librosa35": {}},
}  # fmt: skip


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("augment") / "source"
    parse_recipe(RECIPE).dataset.scan(folder)
    return folder


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="session")
def store_path(source: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    assert "synthetic" in DATASETS.names()
    out = tmp_path_factory.mktemp("built") / "out"
    build(parse_recipe(RECIPE), source, out, cache=cache)
    return out
