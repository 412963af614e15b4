"""A dataset of an address reads as its copy on the disk; what is fetched, pulled, shown by cache and pruned."""

import os
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest
import torch

import dancedata
from dancedata.core.errors import StoreError, UsageError
from dancedata.execution.cache_admin import prune
from dancedata.files.addresses import is_address
from dancedata.remote.pull import pull
from dancedata.torch import BatchLoader, EpochSampler, WindowDataset
from tests.commands import as_json
from tests.messages import raises_message
from tests.remote.servers import Handler, Hub, Server, cut


def _shards(counter: object, split: str = "") -> list[str]:
    return sorted(name for name in counter if "-of-" in name and name.startswith(split))  # type: ignore[attr-defined]


def _errors(address: str) -> list[str]:
    return [p.message for p in dancedata.check(address, progress=False) if p.severity == "error"]


def test_a_store_of_an_address_is_that_of_the_disk(server: Server, published: Path) -> None:
    with dancedata.open(f"{server.url}/store") as remote, dancedata.open(published) as local:
        assert server.requests == {"dataset.json": 1}
        assert len(remote._shards("train")) > 2
        for window in local.windows("train"):
            for field in local.fields:
                np.testing.assert_array_equal(remote.read(window, field), local.read(window, field))
        assert remote.stats == local.stats
    assert not _shards(server.requests, "val") + _shards(server.requests, "test")
    assert max(server.requests.values()) == 1


# Of few shards under fork, where a new process fetches each.
@pytest.mark.parametrize(("context", "split"), [("fork", "val"), ("forkserver", "train")])
def test_readers_and_workers(server: Server, published: Path, context: str, split: str) -> None:
    address = f"{server.url}/store"
    remote, local = (WindowDataset(where, split, scale=None) for where in (address, published))
    assert len(remote) == len(local)
    loader = torch.utils.data.DataLoader(remote, batch_size=4, num_workers=2, multiprocessing_context=context)
    for a, b in zip(loader, torch.utils.data.DataLoader(local, batch_size=4), strict=True):
        assert torch.equal(a["pose"], b["pose"])
    assert {n for name, n in server.requests.items() if name.startswith(f"{split}-0")} == {1}  # workers fetch once


def test_pull_then_offline(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    address = f"{server.url}/store"
    pulled = pull(address, "train", progress=False)
    assert pulled.fetched_files == pulled.files
    assert pull(address, "train", progress=False).fetched_files == 0
    assert not _shards(server.requests, "val")
    whole = pull(address, progress=False)
    assert whole.path == pulled.path
    assert max(n for name, n in server.requests.items() if name != "dataset.json") == 1
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    server.requests.clear()
    assert _errors(address) == []
    with raises_message(StoreError, "cache", where="https://example.org/not/fetched"):
        dancedata.open("https://example.org/not/fetched")
    assert not server.requests


def test_offline_with_a_part_of_it(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    store = dancedata.open("hf://datasets/org/name")
    assert len(store)
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    again = dancedata.open("hf://datasets/org/name@main")
    with raises_message(StoreError, "cache"):
        again.read(again.windows("val")[0], "pose")


def test_unknown_split(hub: Hub) -> None:
    with raises_message(UsageError, "tran", where="hf://datasets/org/name"):
        pull("hf://datasets/org/name", "tran", progress=False)


def test_check_of_an_address_reads_all(server: Server) -> None:
    assert _errors(f"{server.url}/store") == []
    assert "stats.json" in server.requests


def test_a_branch_is_resolved_once(hub: Hub, published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = dancedata.open("hf://datasets/org/name@main")
    commit = "a" * 40
    assert f"hf://datasets/org/name@main is now commit {commit}" in capsys.readouterr().err
    origin = store.origin
    assert origin is not None
    assert (origin.address, origin.requested) == (f"hf://datasets/org/name@{commit}", "hf://datasets/org/name@main")
    # The branch moves on to something else; what is open, and its copies in workers, stay with the commit.
    hub.branches["main"] = "b" * 40
    copy = pickle.loads(pickle.dumps(store))
    window = copy.windows("val")[0]
    with dancedata.open(published) as local:
        np.testing.assert_array_equal(copy.read(window, "pose"), local.read(window, "pose"))
    hub.requests.clear()
    assert dancedata.open(f"hf://datasets/org/name@{commit}").path == store.path
    # A commit that is known asks for nothing; shards may still be fetched ahead.
    assert [name for name in hub.requests if not name.endswith(".h5")] == []


@pytest.mark.parametrize(
    "text",
    [
        "hf://models/org/name", "hf://datasets/name", "hf://datasets/org/name/../other", "http://example.org/store",
        "https://user:secret@example.org/store", "https://example.org/store?sig=secret",
        "HTTPS://user:secret@example.org/store", "https://user:secret@[example.org/store",
        "hf://user:secret@datasets/org/name", "s3://bucket/../other", "ftp://example.org/store",
    ],
)  # fmt: skip
def test_addresses_that_are_refused(text: str) -> None:
    with raises_message(UsageError, "address") as caught:
        dancedata.open(text)
    assert "secret" not in str(caught.value)


def test_what_is_an_address(tmp_path: Path) -> None:
    assert all(map(is_address, ("s3://bucket/prefix", Path("hf://datasets/org/name"), "S3://bucket/prefix")))
    assert not any(map(is_address, ("data/demo", tmp_path, "C:/demo")))
    with raises_message(UsageError, "address"):
        pull("data/demo")


def test_a_loader_begins_after_the_first_shard_and_two_come_ahead(server: Server, published: Path) -> None:
    """Blocks of one shard: the first batch comes while other shards are still not sent."""
    sent, go_on = [], threading.Event()

    def later(handler: Handler, data: bytes) -> bool:
        sent.append(handler.path)
        return not go_on.wait(120)

    remote, local = (WindowDataset(where, "train", scale=None) for where in (f"{server.url}/store", published))
    size = max(np.diff([*local.shard_starts, len(local)]).tolist())
    orders = [EpochSampler(ds, seed=4, block=size) for ds in (remote, local)]
    shards, numbers = local._shards_of_samples
    first = shards[numbers[int(orders[1].order(0)[0])]].path.name
    for shard in shards:
        if shard.path.name != first:
            server.fault(shard.path.name, later)
    batches = iter(BatchLoader(remote, 2, sampler=orders[0], prefetch=1, threads=1))
    expected = iter(BatchLoader(local, 2, sampler=orders[1]))
    assert torch.equal(next(batches)["pose"], next(expected)["pose"])
    assert server.sent[first] == (published / first).stat().st_size
    assert len(_shards(server.sent, "train")) == 1
    assert len(sent) <= 3  # two blocks ahead; a block may hold two small shards
    go_on.set()
    for a, b in zip(batches, expected, strict=True):
        assert torch.equal(a["pose"], b["pose"])
    assert {n for name, n in server.requests.items() if name.startswith("train-0")} == {1}


def test_ranks_see_each_window_once_and_fetch_once(server: Server, published: Path) -> None:
    world = 2
    local = WindowDataset(published, "train", scale=None)
    seen: list[int] = []
    for rank in range(world):
        ds = WindowDataset(f"{server.url}/store", "train", scale=None)
        sampler = EpochSampler(ds, seed=2, block=64, rank=rank, world_size=world, drop_last=True)
        for batch in BatchLoader(ds, 4, sampler=sampler):
            seen += batch["index"].tolist()
            assert torch.equal(batch["pose"][0], local[int(batch["index"][0])]["pose"])
    assert len(set(seen)) == len(seen) == len(local) // world * world
    assert {n for name, n in server.requests.items() if name.startswith("train-0")} == {1}


def test_info_counts_them(server: Server, own_cache: Path) -> None:
    pulled = as_json("pull", f"{server.url}/store", "--split", "val")
    stage = as_json("cache")["stages"]["datasets"]
    assert stage["entries"] == pulled["files"] == pulled["fetched_files"]
    assert as_json("cache", "verify")["damaged"] == []


def test_prune_by_size_and_what_is_fetched_again(server: Server, own_cache: Path) -> None:
    pulled = pull(f"{server.url}/store", progress=False)
    store = dancedata.open(pulled.path)
    window = store.windows("train")[0]
    before = store.read(window, "pose")
    result = prune(own_cache, max_bytes=0)
    assert result.removed >= pulled.files - 2
    assert result.in_use >= 1  # the shard that is open
    np.testing.assert_array_equal(store.read(window, "pose"), before)
    last = store.windows("train")[-1]
    server.requests.clear()
    assert store.read(last, "pose").shape == before.shape
    assert sum(n for name, n in server.requests.items() if name.startswith("train-0")) >= 1


def test_prune_by_age_is_by_the_last_opening(server: Server, own_cache: Path) -> None:
    pulled = pull(f"{server.url}/store", progress=False)
    for path in (*pulled.path.iterdir(), pulled.path.with_name(f"{pulled.path.name}.json")):
        os.utime(path, (1e9, 1e9))
    assert prune(own_cache, older_than_s=3600, dry=True).removed == pulled.files
    dancedata.open(f"{server.url}/store")
    assert prune(own_cache, older_than_s=3600).removed == 0


def test_parts_are_pruned_too(server: Server, own_cache: Path, published: Path) -> None:
    name = next(p.name for p in published.iterdir() if p.name.startswith("train-00000-of"))
    server.fault(name, cut(500), *[lambda handler, data: (handler.status(400), True)[1]] * 2)
    with pytest.raises(dancedata.core.errors.StoreError):
        pull(f"{server.url}/store", progress=False)
    assert [p.name for p in own_cache.rglob("*.part")] == [f"{name}.part"]
    prune(own_cache, max_bytes=0)
    assert not list(own_cache.rglob("*.part"))
