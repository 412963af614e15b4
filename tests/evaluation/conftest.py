"""A small dataset, and its clips as a model could have generated them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.audio.bailando438.feature import Bailando438
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.store import Store

RECIPE = {
    "recipe": 1,
    "name": "small",
    "dataset": {"synthetic": {"songs": 4, "clips_per_song": 2, "clip_s": 6}},
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


@pytest.fixture(scope="session")
def bailando438_rows() -> Callable[..., Any]:
    """Rows of bailando438 without librosa, whose kernels take seconds to compile: tests/audio has the feature."""

    def extract(self: Bailando438, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> Any:
        n_rows = self.n_rows(signal.n_samples, signal.sample_rate, grid)
        rows = np.random.default_rng(signal.n_samples).random((n_rows, self.columns.width), dtype=np.float32)
        period = 20 + int(signal.samples.argmax()) % 20
        rows[:, self.columns.slice("beat")] = (np.arange(n_rows) % period == 5)[:, None]
        return rows

    return extract


@pytest.fixture(autouse=True)
def _quick(folder: Path, bailando438_rows: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Bailando438, "extract", bailando438_rows)
    monkeypatch.setenv("DANCEDATA_CACHE", str(folder / "cache"))
