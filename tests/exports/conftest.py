"""Small datasets to export, built once: EDGE's in both scopes, one at 60 frames per second, one of FineDance."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.core.registry import DATASETS
from dancedata.exports.base.run import ExportResult
from dancedata.synthetic import write_synthetic

AIST = {"recipe": 1, "dataset": {"aist++": {}}, "windows": {"length_s": 5, "stride_s": 0.5}}
RECIPES: dict[str, dict[str, Any]] = {
    "edge": {**AIST, "motion": {"edge151": {}}, "audio": {"librosa35": {}}},
    "edge-exact": {
        **AIST,
        "scope": "window",
        "windows": {"length_s": 5, "stride_s": 0.5, "order": "name"},
        "motion": {"edge151": {}},
        "audio": {"librosa35": {}},
    },
    "sixty": {
        **AIST,
        "fps": 60,
        "motion": {"fact219": {}, "bailando72": {}},
        "audio": {"librosa35": {}, "bailando438": {}},
    },
    "finedance": {
        **AIST,
        "dataset": {"finedance": {}},
        "motion": {"lodge139": {}, "lodge319": {}, "finedance319": {}},
        "audio": {"librosa35": {}},
    },
}


@dataclass(frozen=True)
class Built:
    """A dataset and its source."""

    path: Path
    source: Path

    @property
    def store(self) -> Any:
        return dancedata.open(self.path)


@pytest.fixture(scope="session")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Sources that nothing writes into: six seconds of four clips to two songs, and FineDance's example."""
    folder = tmp_path_factory.mktemp("sources")
    DATASETS.get("finedance")().make_example(folder / "finedance")
    return {
        "aist++": write_synthetic(folder / "aist", songs=2, clips_per_song=2, clip_s=6),
        "finedance": folder / "finedance",
    }


@pytest.fixture(scope="session")
def built(sources: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Built]:
    """Return a function that builds one of `RECIPES`, once."""
    folder, known = tmp_path_factory.mktemp("exports"), {}

    def of(name: str, **keys: Any) -> Built:
        label = f"{name}{keys or ''}"
        if label not in known:
            recipe = {**RECIPES[name], **keys, "name": name}
            source = sources[next(iter(recipe["dataset"]))]
            out = folder / str(len(known))
            dancedata.build(recipe, source, out, jobs=1, cache=folder / "cache", progress=False)
            known[label] = Built(out, source)
        return known[label]

    return of


@pytest.fixture
def export(tmp_path: Path, built: Callable[[str], Built]) -> Callable[..., ExportResult]:
    """Return a function that exports one of `RECIPES` to a folder of the test."""

    def run(name: str, to: str, out: str = "out", **options: Any) -> ExportResult:
        made = built(name)
        options = {"source": made.source, "progress": False, **options}
        return dancedata.export(made.path, to, tmp_path / out, **options)

    return run
