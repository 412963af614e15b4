"""Small datasets to look at, built once: every representation, both scopes, one with a copy at another tempo."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.core.registry import DATASETS
from dancedata.synthetic import write_synthetic
from dancedata.viewer import Scenes

_BASE = {"recipe": 1, "dataset": {"aist++": {}}, "windows": {"length_s": 2, "stride_s": 0.5}}
RECIPES: dict[str, dict[str, Any]] = {
    "thirty": {
        **_BASE,
        "motion": {"edge151": {}, "lodge139": {}, "lodge319": {}, "finedance319": {}, "joints": {}},
        "keymotion": {"lodge": {}},
        "audio": {"librosa35": {}},
        "augment": {"mirror": True, "tempo": {"speeds": [1.25]}},
    },
    "window": {**_BASE, "scope": "window", "motion": {"edge151": {}}, "audio": {"librosa35": {}}},
    "sixty": {**_BASE, "fps": 60, "motion": {"fact219": {}, "bailando72": {}}, "audio": {"librosa35": {}}},
    "twenty": {**_BASE, "fps": 20, "motion": {"humanml263": {}}},
}


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five seconds of four clips to two songs."""
    return write_synthetic(tmp_path_factory.mktemp("source") / "aist", songs=2, clips_per_song=2, clip_s=5)


@pytest.fixture(scope="session")
def scenes(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Scenes]:
    """Return a function that builds one of `RECIPES`, once."""
    folder, known = tmp_path_factory.mktemp("scenes"), {}

    def of(name: str) -> Scenes:
        if name not in known:
            recipe = {**RECIPES[name], "name": name}
            dancedata.build(recipe, source, folder / name, jobs=1, cache=folder / "cache", progress=False)
            known[name] = Scenes(dancedata.open(folder / name))
        return known[name]

    return of


@pytest.fixture(scope="session")
def folder_example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example of the dataset `folder`."""
    folder = tmp_path_factory.mktemp("folder") / "source"
    DATASETS.get("folder")().make_example(folder)
    return folder
