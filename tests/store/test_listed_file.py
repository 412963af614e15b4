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
from tests.messages import raises_message

SHARD = "train-00000-of-00001.h5"


def read(store: Store) -> Any:
    return store.read(store.windows("train")[0], "pose")


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


def test_another_dataset_in_its_place(make_store: Any) -> None:
    made, other = make_store(), make_store(seed=1)
    store = open_store(made.path)
    pickled = pickle.dumps(store)
    shutil.rmtree(made.path)
    shutil.copytree(other.path, made.path)
    for look in (lambda: pickle.loads(pickled), lambda: store.windows("train"), lambda: store.stats):
        with raises_message(StoreError, "opened", where="store1"):
            look()


@pytest.mark.parametrize("name", ["stats.json", SHARD])
@pytest.mark.parametrize("what", ["missing", "longer", "pipe"])
def test_another_file_in_the_place_of_a_file(make_store: Any, name: str, what: str) -> None:
    """A named pipe would be waited for without end."""
    store = open_store(make_store().path)
    (store.path / name).rename(store.path / "aside")
    if what == "longer":
        (store.path / name).write_bytes((store.path / "aside").read_bytes() + b"\0" * 64)
    elif what == "pipe":
        os.mkfifo(store.path / name)
    with raises_message(StoreError, "build|shard", where=f"store1/{name}"):
        _ = store.stats if name == "stats.json" else read(store)


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
