"""Files of an open dataset: a file opened later is the one that dataset.json listed."""

import os
import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.errors import StoreError
from dancedata.store import listed_file
from dancedata.store.dataset import Store, open_store
from dancedata.testing.stores import random_fields
from tests.messages import raises_message

SHARD = "train-00000-of-00001.h5"


def read(store: Store) -> Any:
    return store.read(store.windows("train")[0], "pose")


def test_a_file_that_got_the_inode_of_the_old_one(make_store: Any) -> None:
    """The system gives a removed file's inode to the next one; programs that unpack files set their times."""
    fields = random_fields({"pose": 7}, {})
    made, other = (make_store(n_frames=(90, 90), fields=fields, seed=seed) for seed in (0, 1))
    store = open_store(made.path)
    window = store.windows("train")[0]
    before = (made.path / SHARD).stat()
    for path in other.path.iterdir():
        (made.path / path.name).write_bytes(path.read_bytes())
        os.utime(made.path / path.name, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = (made.path / SHARD).stat()
    for name in ("st_dev", "st_ino", "st_size", "st_mtime_ns"):
        assert getattr(before, name) == getattr(after, name)
    with raises_message(StoreError, "opened", where="store1"):
        store.read(window, "pose")


@pytest.mark.parametrize("how", ["touched", "mode", "linked", "copied", "moved"])
def test_the_same_bytes_are_the_same_dataset(make_store: Any, tmp_path: Path, how: str) -> None:
    made = make_store()
    wanted = read(open_store(made.path))
    store = open_store(made.path)
    if how == "touched":
        os.utime(made.path / SHARD, (0, 0))
    elif how == "mode":
        (made.path / SHARD).chmod(0o400)
    elif how == "linked":
        os.link(made.path / SHARD, tmp_path / "link")
    else:
        shutil.copytree(made.path, tmp_path / "copy")
        shutil.rmtree(made.path)
        (shutil.copytree if how == "copied" else os.rename)(tmp_path / "copy", made.path)
    np.testing.assert_array_equal(read(store), wanted)


@pytest.mark.parametrize("what", ["windows", "read", "map", "stats", "pickle"])
def test_every_way_to_a_file_looks_at_it(make_store: Any, what: str) -> None:
    made, other = make_store(), make_store(seed=1)
    store = open_store(made.path)
    if what in ("read", "map"):
        window = store.windows("train")[0]
        shard = store._locate(window, "pose").shard
    pickled = pickle.dumps(store)
    shutil.rmtree(made.path)
    shutil.copytree(other.path, made.path)
    ways = {
        "pickle": lambda: pickle.loads(pickled),
        "windows": lambda: store.windows("train"),
        "read": lambda: store.read(window, "pose"),
        "map": lambda: shard.mapped_rows("pose"),
        "stats": lambda: store.stats,
    }
    with raises_message(StoreError, "opened", where="store1"):
        ways[what]()


@pytest.mark.parametrize("gone", ["all", "dataset.json and a shard"])
def test_a_dataset_that_is_removed_or_being_built(make_store: Any, gone: str) -> None:
    made = make_store()
    store = open_store(made.path)
    if gone == "all":
        shutil.rmtree(made.path)
    else:
        (made.path / "dataset.json").unlink()
        (made.path / SHARD).unlink()
    with raises_message(StoreError, "opened", where="store1"):
        read(store)


@pytest.mark.parametrize("name", ["stats.json", SHARD])
def test_a_named_pipe_in_the_place_of_a_file(make_store: Any, name: str) -> None:
    """It would be waited for without end."""
    store = open_store(make_store().path)
    (store.path / name).unlink()
    os.mkfifo(store.path / name)
    with raises_message(StoreError, "build"):
        _ = store.stats if name == "stats.json" else read(store)


@pytest.mark.parametrize("more", [None, b"\0" * 64])
def test_a_shard_that_is_missing_or_has_another_size_is_named(make_store: Any, more: bytes | None) -> None:
    store = open_store(make_store().path)
    (store.path / SHARD).rename(store.path / "aside")
    if more is not None:
        (store.path / SHARD).write_bytes((store.path / "aside").read_bytes() + more)
    with raises_message(StoreError, "shard", where="store1/train-00000-of-00001.h5"):
        read(store)


@pytest.mark.parametrize("when", ["before the shards", "after the shards"])
def test_opening_while_a_dataset_is_replaced(make_store: Any, monkeypatch: pytest.MonkeyPatch, when: str) -> None:
    """Description and shards are of one and the same dataset."""
    made, other = make_store(), make_store(seed=1)
    load = listed_file.load_description
    wanted = read(open_store(other.path))
    replaced = []

    def replacing(folder: Path) -> Any:
        found = load(folder)
        if not replaced:
            replaced.append(made.path.rename(made.path.with_name("old")))
            if when == "after the shards":
                shutil.copytree(other.path, made.path)
            else:
                other.path.rename(made.path)
        return found

    monkeypatch.setattr(listed_file, "load_description", replacing)
    store = open_store(made.path)
    assert replaced
    np.testing.assert_array_equal(read(store), wanted)


def test_a_dataset_that_never_comes_to_rest(make_store: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made = make_store()
    load = listed_file.load_description

    def touching(folder: Path) -> Any:
        found = load(folder)
        os.utime(folder / "dataset.json")
        return found

    monkeypatch.setattr(listed_file, "load_description", touching)
    with raises_message(StoreError, "being", where="store1"):
        open_store(made.path)
