"""A small dataset, and its clips as a model could have generated them."""

from pathlib import Path

import pytest

import dancedata
from dancedata.audio.bailando438 import Bailando438
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.store import Store
from tests.features import bailando438_rows

RECIPE = {
    "recipe": 1, "name": "small", "dataset": {"synthetic": {"songs": 4, "clips_per_song": 2, "clip_s": 6}}, "fps": 30,
    "windows": {"length_s": 5, "stride_s": 0.5}, "motion": {"edge151": {}, "joints": {}, "lodge139": {}},
    "audio": {"librosa35": {}},
}  # fmt: skip


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
    return {c.id: dancedata.decode(c.read("edge151"), "edge151", fps=30) for c in store}


@pytest.fixture(scope="session")
def duets(tmp_path_factory: pytest.TempPathFactory, folder: Path) -> Store:
    """The example of DD100."""
    path = tmp_path_factory.mktemp("duets")
    DATASETS.make("dd100", {}).make_example(path / "source")
    recipe = {
        "recipe": 1, "name": "duets", "dataset": {"dd100": {}}, "fps": 30,
        "windows": {"length_s": 5, "stride_s": 0.5}, "motion": {"edge151": {}}, "audio": {"librosa35": {}},
    }  # fmt: skip
    dancedata.build(
        recipe, source=path / "source", out=path / "duets", jobs=1, cache=folder / "cache", progress=False
    )
    return dancedata.open(path / "duets")


@pytest.fixture(autouse=True)
def _quick(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Bailando438, "extract", bailando438_rows)
    monkeypatch.setenv("DANCEDATA_CACHE", str(folder / "cache"))
