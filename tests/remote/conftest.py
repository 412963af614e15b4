"""A small dataset, and servers that have it."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from dancedata.core.licence import Licence
from dancedata.core.registry import DATASETS
from dancedata.remote import fetch
from dancedata.store import write_store
from dancedata.store.schema import Field
from dancedata.testing.stores import random_columns
from tests.remote.servers import Hub, Server, serving
from tests.remote.upload_hub import TOKEN, UploadHub


@pytest.fixture(scope="session")
def published(tmp_path_factory: pytest.TempPathFactory, random_store: Callable[..., Any]) -> Path:
    """Return a dataset of several shards."""
    out = tmp_path_factory.mktemp("published") / "store"
    fields = (
        Field("pose", "motion", random_columns(7), Fraction(30)),
        Field("music", "audio", random_columns(5, mirror=False), Fraction(30)),
    )
    random_store(out, fields=fields, clips={"train": 18, "val": 2, "test": 2}, shard_bytes=1 << 13)
    return out


@pytest.fixture
def server(published: Path) -> Iterator[Server]:
    with serving(Server(published.parent)) as server:
        yield server


@pytest.fixture
def hub(published: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    pytest.importorskip("huggingface_hub")
    with serving(Hub(published)) as server:
        assert isinstance(server, Hub)
        monkeypatch.setenv("HF_ENDPOINT", server.url)
        monkeypatch.delenv("HF_TOKEN", raising=False)
        yield server


@pytest.fixture
def uploads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[UploadHub]:
    constants = pytest.importorskip("huggingface_hub.constants")
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    with serving(UploadHub(tmp_path / "hub", TOKEN)) as server:
        assert isinstance(server, UploadHub)
        monkeypatch.setenv("HF_ENDPOINT", server.url)
        yield server


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give each test an empty cache, and no waits."""
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("HF_HUB_OFFLINE", raising=False)
    monkeypatch.setattr(fetch, "WAIT_S", 0.0)
    return tmp_path / "cache"


@pytest.fixture
def relabelled_random(random_store: Callable[..., Any], tmp_path: Path) -> Callable[[list[Licence]], Path]:
    """Return a function that writes a dataset of a folder whose clips have these terms in turn."""

    def make(terms: list[Licence]) -> Path:
        written = random_store(tmp_path / "without")
        clips = [replace(clip, terms=terms[k % len(terms)]) for k, clip in enumerate(written.clips)]
        out = tmp_path / "with"
        out.mkdir()
        meta = {"source": {"reader": "folder"}, "licence": DATASETS.get("folder").licence}
        write_store(out, replace(written.header, meta=meta), clips)
        return out

    return make
