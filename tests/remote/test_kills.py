"""Kills at any byte of an upload and a download: python -m pytest tests/remote/test_kills.py -m nightly for all."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.store import open_store
from tests.remote import children
from tests.remote.servers import Handler, Server, serving
from tests.remote.upload_hub import TOKEN, UploadHub

pytest.importorskip("huggingface_hub")
WHERE = "hf://datasets/org/name"
#: Places, evenly spaced over all bytes of the requests or answers.
FEW, MANY = 3, 200
PLACES = [pytest.param(FEW, id="few"), pytest.param(MANY, id="many", marks=pytest.mark.nightly)]


@pytest.fixture(scope="module")
def processes() -> Any:
    """Return processes that start at once: a server forks them that has the packages."""
    return multiprocessing.get_context("forkserver")


def ran(processes: Any, call: Callable[..., None], *args: Any, kill: Callable[[int], None] | None = None) -> bool:
    """Run a function of `children` in a process; return whether it came to its end."""
    process = processes.Process(target=call, args=args)
    process.start()
    if kill is not None:
        kill(process.pid)
    process.join(120)
    assert process.exitcode in (0, -signal.SIGKILL)
    return bool(process.exitcode == 0)


@pytest.fixture
def small(random_store: Callable[..., Any], tmp_path: Path) -> Path:
    out: Path = random_store(tmp_path / "small", clips={"train": 3, "val": 1}, shard_bytes=1 << 14).path
    return out


def hub_environment(hub: UploadHub, cache: Path) -> dict[str, str]:
    return {"HF_ENDPOINT": hub.url, "HF_TOKEN": TOKEN, "DANCEDATA_CACHE": str(cache)}


@pytest.mark.parametrize("places", PLACES)
def test_pushes_that_are_killed(places, small, tmp_path, processes, own_cache, monkeypatch):
    """What is there then is absent or whole; the same call goes on, and does not send what is there."""
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    expected, total, sizes = None, 0, []
    for k in range(places + 1):
        with serving(UploadHub(tmp_path / f"hub{k}")) as hub:
            assert isinstance(hub, UploadHub)
            monkeypatch.setenv("HF_ENDPOINT", hub.url)
            environment = hub_environment(hub, own_cache)
            if k > 0:
                at = total * k // (places + 1)

                def arm(pid: int, hub: UploadHub = hub, at: int = at) -> None:
                    hub.kill = (pid, at)

                assert not ran(processes, children.push, environment, small, WHERE, kill=arm)
                hub.received, before = 0, hub.received
                there = hub.files() if "main" in hub.branches else {}
                assert there in ({}, expected)
                stored = sum(map(len, hub.storage.values()))
                if there:
                    with dancedata.open(WHERE) as remote, open_store(small) as local:
                        assert remote.info["self_sha256"] == local.info["self_sha256"]
                assert before >= at
            assert ran(processes, children.push, environment, small, WHERE)
            if k == 0:
                expected, total = hub.files(), hub.received
            else:
                sizes.append(hub.received + stored)
            assert hub.files() == expected
            assert len(hub.tags) == 1
    # What was there was not sent again: preparing takes a few requests more.
    assert max(sizes) < 1.3 * total


class Watched(Handler):
    """Counts the bytes that are sent, and kills the client after some."""

    server: "WatchedServer"

    def give(self, data: bytes, *, only: int | None = None) -> None:
        body = self.head(data) or b""
        for at in range(0, len(body), 512):
            self.wfile.write(body[at : at + 512])
            self.server.counted(len(body[at : at + 512]))


class WatchedServer(Server):
    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.RequestHandlerClass = Watched
        self.kill: tuple[int, int] | None = None
        self.given = 0

    def counted(self, n: int) -> None:
        self.given += n
        if self.kill is not None and self.given >= self.kill[1]:
            process, self.kill = self.kill[0], None
            os.kill(process, signal.SIGKILL)


@pytest.fixture
def watched(small: Path) -> Iterator[WatchedServer]:
    with serving(WatchedServer(small.parent)) as server:
        assert isinstance(server, WatchedServer)
        yield server


@pytest.mark.parametrize("places", PLACES)
def test_pulls_that_are_killed(places, small, watched, tmp_path, processes, monkeypatch):
    """Files in the cache are whole, and the same call goes on from the bytes that are there."""
    address = f"{watched.url}/{small.name}"
    expected = {p.name: p.read_bytes() for p in small.iterdir() if p.name != "README.md"}
    total = sum(map(len, expected.values()))
    for k in range(1, places + 1):
        cache = tmp_path / f"cache{k}"
        environment = {"DANCEDATA_CACHE": str(cache)}
        at = total * k // (places + 1)
        watched.given = 0

        def arm(pid: int, at: int = at) -> None:
            watched.kill = (pid, at)

        assert not ran(processes, children.pull, environment, address, kill=arm)
        folders = [p for p in (cache / "datasets").glob("*") if len(p.name) == 64 and p.is_dir()]
        for file in (file for folder in folders for file in folder.iterdir()):
            assert expected.get(file.name) == file.read_bytes() or file.name.startswith(".dancedata-")
        assert ran(processes, children.pull, environment, address)
        monkeypatch.setenv("DANCEDATA_CACHE", str(cache))
        (folder,) = [p for p in (cache / "datasets").glob("*") if len(p.name) == 64 and p.is_dir()]
        found = {p.name: p.read_bytes() for p in folder.iterdir() if not p.name.startswith(".dancedata-")}
        assert found == expected
        monkeypatch.setenv("HF_HUB_OFFLINE", "1")
        with dancedata.open(address) as store:
            store.require_intact()
        monkeypatch.delenv("HF_HUB_OFFLINE")
