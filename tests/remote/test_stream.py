"""stream=True: rows of an address by ranges, equal to those of the disk, verified, bounded, under every fault."""

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import dancedata
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import json_sha256
from dancedata.readers import BatchLoader, ClipDataset, EpochSampler, GroupDataset, WindowDataset
from dancedata.remote import Stream, http, local_folder, pull
from dancedata.store.leaves import LEAF
from dancedata.store.schema import Field
from dancedata.testing.stores import random_columns
from tests.groups_store import write_groups
from tests.messages import raises_message
from tests.remote.servers import Hub, Server, cut, other, serving, status

SECRET = "hf_thisIsTheSecretToken"


@pytest.fixture(scope="session")
def large(tmp_path_factory: pytest.TempPathFactory, random_store: Callable[..., Any]) -> Path:
    """Return a dataset with shards of several pieces."""
    out = tmp_path_factory.mktemp("large") / "store"
    fields = (
        Field("pose", "motion", random_columns(151), Fraction(30)),
        Field("tune35", "audio", random_columns(35, mirror=False), Fraction(30)),
    )
    clips = {"train": 24, "val": 2, "test": 2}
    random_store(out, fields=fields, clips=clips, n_frames=(1500, 2000), shard_bytes=4 << 20)
    return out


@pytest.fixture
def site(large: Path) -> Iterator[Server]:
    with serving(Server(large.parent)) as server:
        yield server


@pytest.fixture
def address(site: Server) -> str:
    return f"{site.url}/store"


def _shard(large: Path) -> str:
    return next(p.name for p in sorted(large.iterdir()) if p.name.startswith("train-00000-of"))


def _fetched_whole(address: str) -> list[str]:
    return sorted(p.name for p in local_folder(address).iterdir() if "-of-" in p.name)


def _first(address: str, **options: Any) -> Any:
    store = dancedata.open(address, stream=Stream(**options) if options else True)
    return store.read(store.windows("train")[0], "pose")


def _local(large: Path) -> Any:
    with dancedata.open(large) as local:
        return local.read(local.windows("train")[0], "pose")


def test_rows_are_those_of_the_disk_and_no_shard_comes_whole(site: Server, address: str, large: Path) -> None:
    with dancedata.open(address, stream=True) as remote, dancedata.open(large) as local:
        assert len(local.shards("train")) > 2
        for window in local.windows("train"):
            for field in local.fields:
                np.testing.assert_array_equal(remote.read(window, field), local.read(window, field))
        clip = local.tables("train").ids[3]
        np.testing.assert_array_equal(remote.read_clip(clip, "pose"), local.read_clip(clip, "pose"))
        assert remote.stats == local.stats
    assert _fetched_whole(address) == []
    for name, n in ((name, n) for name, n in site.sent.items() if "-of-" in name):
        assert n <= (large / name).stat().st_size  # every piece came once, although windows overlap


def test_a_window_asks_for_the_pieces_of_its_rows_alone(site: Server, address: str, large: Path) -> None:
    ds = WindowDataset(address, "train", normalize=False, stream=True)
    site.requests.clear()
    sample = ds[0]
    with dancedata.open(large) as local:
        assert torch.equal(sample["pose"], torch.from_numpy(local.read(local.windows("train")[0], "pose")))
    asked = [h["Range"] for path, h in site.headers if "train-00000" in path]
    assert 1 <= len(asked) <= 2  # a range per field; one where they are neighbours
    for text in asked:
        first, last = map(int, text.removeprefix("bytes=").split("-"))
        assert first % LEAF == 0
        assert last - first < 2 * LEAF


def test_readers(site: Server, address: str, large: Path, tmp_path: Path) -> None:
    def batches(where: object, **stream: Any) -> list[Any]:
        ds = WindowDataset(where, "train", mirror=0.5, augment=["crop"], **stream)  # type: ignore[arg-type]
        return list(BatchLoader(ds, 8, sampler=EpochSampler(ds, seed=3)))

    for a, b in zip(batches(address, stream=True), batches(large), strict=True):
        assert torch.equal(a["pose"], b["pose"])
        assert torch.equal(a["tune35"], b["tune35"])
        assert a["id"] == b["id"]
    clips = [ClipDataset(address, "val", stream=True), ClipDataset(large, "val")]
    assert all(torch.equal(a["pose"], b["pose"]) for a, b in zip(*clips, strict=True))
    assert _fetched_whole(address) == []
    site.folder = tmp_path
    write_groups(tmp_path / "groups", 60)
    groups = [
        GroupDataset(f"{site.url}/groups", "train", stream=True, choose="left_to_right"),
        GroupDataset(tmp_path / "groups", "train", choose="left_to_right"),
    ]
    for a, b in zip(*groups, strict=True):
        assert torch.equal(a["edge151"], b["edge151"])
    assert _fetched_whole(f"{site.url}/groups") == []


@pytest.mark.parametrize("context", ["fork", pytest.param("spawn", marks=pytest.mark.nightly), "forkserver"])
def test_workers(address: str, large: Path, context: str) -> None:
    remote, local = WindowDataset(address, "train", stream=True), WindowDataset(large, "train")
    assert torch.equal(remote[5]["pose"], local[5]["pose"])  # threads and pieces of this process
    loader = DataLoader(
        remote, batch_size=16, num_workers=2 if context == "fork" else 1, multiprocessing_context=context, timeout=60
    )
    for a, b in zip(loader, DataLoader(local, batch_size=16), strict=True):
        assert torch.equal(a["pose"], b["pose"])


def test_pickling_drops_pieces_and_threads(address: str) -> None:
    store = dancedata.open(address, stream=Stream(memory_mb=9))
    window = store.windows("train")[0]
    before = store.read(window, "pose")
    data = pickle.dumps(store)
    assert len(data) < 1000
    copy = pickle.loads(data)
    assert copy.stream == Stream(memory_mb=9)
    np.testing.assert_array_equal(copy.read(window, "pose"), before)


def test_memory_is_bounded(site: Server, address: str) -> None:
    store = dancedata.open(address, stream=Stream(memory_mb=8))
    for window in store.windows("train"):
        store.read(window, "pose")
    [pieces] = {id(s._ranged._reader): s._ranged._reader.pieces for s in store.shards("train") if s._ranged}.values()
    assert len(pieces._kept) * LEAF <= 8_000_000
    assert sum(site.sent.values()) > 8_000_000


def test_threads_ask_once_for_a_piece(site: Server, address: str) -> None:
    store = dancedata.open(address, stream=True)
    window, results = store.windows("train")[0], []
    threads = [threading.Thread(target=lambda: results.append(store.read(window, "pose"))) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 16
    ranges = [h["Range"] for path, h in site.headers if "train-00000" in path]
    assert len(ranges) == len(set(ranges))


def test_pieces_on_the_disk(site: Server, address: str, large: Path, own_cache: Path, monkeypatch: Any) -> None:
    np.testing.assert_array_equal(_first(address, disk_mb=1), _local(large))
    site.requests.clear()
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    np.testing.assert_array_equal(_first(address, disk_mb=1), _local(large))
    with pytest.raises(
        StoreError, match=r"train-00000-of-\d+.h5: a part of the dataset is not in the cache; found HF_HUB"
    ):
        _first(address)
    monkeypatch.delenv("HF_HUB_OFFLINE")
    pieces = sorted(own_cache.glob("datasets/*.pieces/*"))
    pieces[0].write_bytes(bytes(LEAF))  # damaged: fetched again
    np.testing.assert_array_equal(_first(address, disk_mb=1), _local(large))
    store = dancedata.open(address, stream=Stream(disk_mb=1))
    for window in store.windows("train"):
        store.read(window, "pose")
    assert sum(p.stat().st_size for p in own_cache.glob("datasets/*.pieces/*")) <= 1_000_000


def test_shards_that_were_pulled_are_read_from_the_disk(site: Server, address: str, large: Path) -> None:
    pull(address, "train", progress=False)
    site.requests.clear()
    np.testing.assert_array_equal(_first(address), _local(large))
    assert not [name for name in site.requests if "train-0" in name]


def test_a_local_dataset_is_read_as_ever(large: Path) -> None:
    np.testing.assert_array_equal(dancedata.open(large, stream=True).read(*_window(large)), _local(large))
    with dancedata.open(large) as store, raises_message(UsageError, "opened", where="store"):
        WindowDataset(store, stream=True)
    with raises_message(UsageError, "memory_mb"):
        Stream(memory_mb=0)


def _window(large: Path) -> tuple[Any, str]:
    with dancedata.open(large) as local:
        return local.windows("train")[0], "pose"


def _without_leaves(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    path = folder / "dataset.json"
    document = json.loads(path.read_text())
    change(document)
    del document["self_sha256"]
    path.write_text(json.dumps({**document, "self_sha256": json_sha256(document)}))


@pytest.mark.parametrize("what", ["leaves", "rows"])
def test_a_dataset_without_leaves_says_so(server: Server, published: Path, tmp_path: Path, what: str) -> None:
    shutil.copytree(published, tmp_path / "site" / "store")
    server.folder = tmp_path / "site"

    def change(document: dict[str, Any]) -> None:
        if what == "leaves":
            del document["leaves"]
        else:
            document["shards"][0]["fields"]["pose"][0] = None

    _without_leaves(tmp_path / "site" / "store", change)
    with pytest.raises(StoreError, match=r"cannot be read by ranges.*without stream=True"):
        dancedata.open(f"{server.url}/store", stream=True)
    assert not [name for name in server.requests if "-of-" in name]


# Faults of section D.


@pytest.mark.parametrize("answers", [[cut(1000)] * 8, [status(503), status(429, Retry_After="0")], [cut(0)] * 2])
def test_faults_that_pass(site: Server, address: str, large: Path, answers: list[Any]) -> None:
    site.fault(_shard(large), *answers)
    np.testing.assert_array_equal(_first(address), _local(large))
    assert site.requests[_shard(large)] >= len(answers)


@pytest.mark.parametrize("code", [400, 401, 403, 404, 416])
def test_faults_that_stay(site: Server, address: str, large: Path, code: int) -> None:
    store = dancedata.open(address, stream=True)
    site.fault(_shard(large), *[status(code)] * 2)
    with pytest.raises(StoreError, match=_shard(large)):
        store.read(store.windows("train")[0], "pose")
    site.faults.clear()
    # The same store reads on, once the server does.
    np.testing.assert_array_equal(store.read(store.windows("train")[0], "pose"), _local(large))


def test_wrong_bytes_once_and_twice(site: Server, address: str, large: Path) -> None:
    def wrong(data: bytes) -> bytes:
        return bytes(len(data))

    site.fault(_shard(large), other(wrong))
    np.testing.assert_array_equal(_first(address), _local(large))
    assert site.requests[_shard(large)] == 2
    site.fault(_shard(large), *[other(wrong)] * 2)
    with pytest.raises(StoreError, match=r"other bytes than those of the dataset, twice; found bytes 0 to"):
        _first(address)


def test_a_dataset_that_is_replaced(site: Server, address: str, large: Path, tmp_path: Path) -> None:
    store = dancedata.open(address, stream=True)
    window = store.windows("train")[0]
    (tmp_path / "store").mkdir()
    data = (large / _shard(large)).read_bytes()
    site.folder = tmp_path
    for content, problem in (
        (data[::-1], "other bytes"),
        (data[:9], r"too short|HTTP 416|got 'bytes"),
        (None, "404"),
    ):
        (tmp_path / "store" / _shard(large)).unlink(missing_ok=True)
        if content is not None:
            (tmp_path / "store" / _shard(large)).write_bytes(content)
        with pytest.raises(StoreError, match=problem):
            store.read(window, "pose")


def test_a_server_without_ranges(site: Server, address: str, large: Path) -> None:
    site.ranges = False
    with pytest.raises(StoreError, match=r"does not give parts of files; found HTTP 200.*without stream=True"):
        _first(address)
    assert site.requests[_shard(large)] == 1


def test_a_slow_server(site: Server, address: str, large: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http, "TIMEOUT_S", 0.1)
    gone = threading.Event()

    def silent(handler: Any, data: bytes) -> bool:
        gone.wait(5)
        return True

    site.fault(_shard(large), *[silent] * 6)
    with pytest.raises(StoreError, match=r"the server failed 6 times"):
        _first(address)
    gone.set()


def test_an_expired_address_of_a_hub(
    hub: Hub, site: Server, large: Path, monkeypatch: pytest.MonkeyPatch, own_cache: Path
) -> None:
    """The hub redirects once a file; what it redirects to gets no token, and is asked for again when it expires."""
    hub.commits, hub.token = {"a" * 40: large}, SECRET
    monkeypatch.setenv("HF_TOKEN", SECRET)
    name = _shard(large)
    hub.fault(name, *[status(302, Location=f"{site.url}/store/{name}?Signature={SECRET}")] * 9)
    remote = dancedata.open("hf://datasets/org/name", stream=Stream(memory_mb=8, connections=1))
    with dancedata.open(large) as local:
        windows = [w for w in local.windows("train") if local.locate(w, "pose").shard.path.name == name]
        for k, window in enumerate(windows):
            if k == len(windows) // 2:
                site.fault(name, status(403))
            np.testing.assert_array_equal(remote.read(window, "pose"), local.read(window, "pose"))
    assert hub.requests[name] == 2
    assert site.requests[name] > 3
    assert all("Authorization" not in headers for _, headers in site.headers)
    assert not any(SECRET.encode() in p.read_bytes() for p in own_cache.rglob("*") if p.is_file())


def test_a_token_that_is_refused_in_the_middle(hub: Hub, large: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hub.commits, hub.token = {"a" * 40: large}, SECRET
    monkeypatch.setenv("HF_TOKEN", SECRET)
    store = dancedata.open("hf://datasets/org/name", stream=True)
    store.tables("train")
    hub.token = "another"
    with pytest.raises(StoreError, match="the hub does not accept the token") as caught:
        store.read(store.windows("train")[0], "pose")
    assert SECRET not in str(caught.value)
    monkeypatch.setenv("HF_TOKEN", "another")
    np.testing.assert_array_equal(store.read(store.windows("train")[0], "pose"), _local(large))


def test_a_client_does_not_cross_a_fork(address: str, large: Path) -> None:
    """A forked child has threads and connections of its own, although the parent's are in use."""
    store = dancedata.open(address, stream=True)
    window = store.windows("train")[0]
    store.read(window, "pose")
    parent = store.shards("train")[0]._ranged
    assert parent is not None
    mine = parent._reader.pieces
    child = os.fork()
    if child == 0:
        signal.alarm(30)  # a hang fails
        good = parent._reader.pieces is not mine and np.array_equal(store.read(window, "pose"), _local(large))
        os._exit(0 if good else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_blocks_come_in_few_requests_and_the_first_batch_does_not_wait_for_all(
    site: Server, address: str, large: Path
) -> None:
    ds, local = WindowDataset(address, "train", stream=True), WindowDataset(large, "train")
    sampler = EpochSampler(ds, seed=1, block=400)
    site.requests.clear()
    batches = iter(BatchLoader(ds, 8, sampler=sampler, threads=1, prefetch=1))
    for a, b in zip(batches, BatchLoader(local, 8, sampler=EpochSampler(local, seed=1, block=400)), strict=True):
        assert torch.equal(a["pose"], b["pose"])
    shards = {name: n for name, n in site.requests.items() if "-of-" in name}
    assert sum(shards.values()) < 0.4 * sum(p.stat().st_size for p in large.glob("train-0*")) / LEAF
    assert all(site.sent[name] <= (large / name).stat().st_size for name in shards)  # nothing twice


_LEAVES_EARLY = """
import sys
import dancedata
from dancedata.remote import Stream
store = dancedata.open(sys.argv[1], stream=Stream(connections=1))
windows = list(store.windows("train"))
reader = store.window_rows(store.windows("train"), "pose")
reader.read_ahead(range(len(windows)))
store.read(windows[0], "pose")
"""


def test_a_process_that_ends_does_not_fetch_what_it_noted(site: Server, address: str, large: Path) -> None:
    slow = [lambda handler, data: bool(time.sleep(1.0))] * 99
    for path in large.glob("train-0*"):
        site.fault(path.name, *slow)
    subprocess.run([sys.executable, "-c", _LEAVES_EARLY, address], check=True, timeout=60)
    assert sum(n for name, n in site.requests.items() if "-of-" in name) <= 5
