"""A small dataset, and what a model could have generated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.motion import Motion
from dancedata.store import Store

RECIPE = {
    "recipe": 1,
    "name": "small",
    "dataset": {"synthetic": {"songs": 4, "clips_per_song": 2, "clip_s": 8}},
    "fps": 30,
    "windows": {"length_s": 5, "stride_s": 0.5},
    "motion": {"edge151": {}, "joints": {}, "lodge139": {}},
    "audio": {"librosa35": {}},
}


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``small``, ``small-source`` and a cache."""
    path = tmp_path_factory.mktemp("evaluation")
    dancedata.build(RECIPE, out=path / "small", jobs=1, cache=path / "cache", progress=False)
    return path


@pytest.fixture(scope="session")
def store(folder: Path) -> Store:
    """The dataset."""
    return dancedata.open(folder / "small")


@pytest.fixture(scope="session")
def motions(store: Store) -> dict[str, Motion]:
    """Its clips as motions, decoded from edge151."""
    return {c.id: dancedata.decode(c.read("edge151"), "edge151", fps=30) for c in store.clips}


@pytest.fixture(autouse=True)
def _cache(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DANCEDATA_CACHE", str(folder / "cache"))


def random_walk(n_frames: int = 300, seed: int = 0) -> Motion:
    """Rotations and root that walk at random: what an untrained model may give."""
    from dancedata.core.grid import FrameGrid
    from dancedata.core.skeleton import SMPL24

    rng = np.random.default_rng(seed)
    rotations = rng.normal(0, 0.02, (n_frames, 24, 3)).cumsum(axis=0)
    translation = rng.normal(0, 0.01, (n_frames, 3)).cumsum(axis=0) + (0, 1, 0)
    return Motion(translation, rotations, FrameGrid.of(30), SMPL24)
