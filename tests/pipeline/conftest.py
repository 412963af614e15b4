"""One small corpus, built once in each scope, and one cache; tests that need fresh ones make their own."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from dancedata.core.hashing import sha256_file
from dancedata.pipeline.build import BuildResult, build
from dancedata.recipes.parse import load_recipe
from dancedata.synthetic import write_synthetic

Build = Callable[..., BuildResult]
RECIPES = {"track": "aist++", "window": "aist++-edge-exact"}


@pytest.fixture(scope="session")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four clips of 6 s to two songs, official layout. Not to be written into."""
    return write_synthetic(tmp_path_factory.mktemp("corpus") / "source", songs=2, clips_per_song=2, clip_s=6)


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that tests share."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def _no_other_cache(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DANCEDATA_CACHE", str(cache))


@pytest.fixture(scope="session")
def run_build(cache: Path) -> Build:
    """Return a function that builds a recipe, given by name, with overrides as on the command line."""

    def run(source: Path, out: Path, name: str = "aist++", set: Sequence[str] = (), **options: Any) -> BuildResult:
        return build(load_recipe(name, set), source, out, **{"cache": cache, **options})

    return run


@pytest.fixture(scope="session")
def built_in(run_build: Build, corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The corpus built in both scopes. Not to be written into."""
    outs = {scope: tmp_path_factory.mktemp("built") / scope for scope in RECIPES}
    for scope, out in outs.items():
        run_build(corpus, out, RECIPES[scope])
    return outs


@pytest.fixture(scope="session")
def built(built_in: dict[str, Path]) -> Path:
    """The corpus built in track scope. Not to be written into."""
    return built_in["track"]


@pytest.fixture
def source(corpus: Path, tmp_path: Path) -> Path:
    """A copy of the corpus to bend."""
    return shutil.copytree(corpus, tmp_path / "source")


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Where to build; not there yet, nothing beside it."""
    return tmp_path / "outs" / "out"


@pytest.fixture
def built_copy(built: Path, out: Path) -> Path:
    """A built dataset to bend."""
    return shutil.copytree(built, out)


@pytest.fixture(scope="session")
def hashes() -> Callable[[Path], dict[str, str]]:
    """Return a function: SHA-256 of every file in a folder, by name."""
    return lambda folder: {p.name: sha256_file(p) for p in sorted(folder.iterdir())}


@pytest.fixture(scope="session")
def rejects() -> Callable[[Path], list[dict[str, Any]]]:
    """Return a function: the rows of rejects.jsonl."""

    def read(out: Path) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (out / "rejects.jsonl").read_text(encoding="utf-8").splitlines()]

    return read
