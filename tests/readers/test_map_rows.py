"""Rows of windows from mapped shards, and what is read where they cannot be mapped."""

import json
import logging
import mmap
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import self_hash
from dancedata.files.regular_file import sha256_file
from dancedata.store.dataset import Store, open_store
from dancedata.store.window_list import WindowList
from dancedata.testing.stores import random_fields, write_random_store
from dancedata.torch import WindowDataset
from tests.messages import raises_message


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A store of several shards with a field of 60 rows per second and one of half precision."""
    pose, fast, music = random_fields({"pose": 21, "fast": 30}, {"tune": 35}, fast=60)
    fields = (pose, fast, replace(music, dtype="float16"))
    folder = tmp_path_factory.mktemp("store")
    clips = {"train": 5, "test": 2}
    write_random_store(folder, fields=fields, n_frames=(110, 140), shard_bytes=1 << 15, clips=clips)
    return open_store(folder)


def copy_of(store: Store, folder: Path) -> Store:
    """A copy that may be spoilt."""
    return open_store(shutil.copytree(store.path, folder / "copy"))


def repacked(store: Store, name: str, change: str, first: int) -> Store:
    """Store a field of the first train shard otherwise, and state its first byte in dataset.json."""
    document = json.loads((store.path / "dataset.json").read_text(encoding="utf-8"))
    entry = next(s for s in document["shards"] if s["split"] == "train")
    path = store.path / entry["file"]
    with h5py.File(path, "r+") as file:
        rows = file[name][...]
        del file[name]
        if change == "virtual":
            file.create_virtual_dataset(name, h5py.VirtualLayout(rows.shape, rows.dtype))
        else:
            options = {"chunks": (7, rows.shape[1]), "compression": "gzip", "shuffle": True}
            file.create_dataset(name, data=rows, **(options if change == "chunks" else {}))
        entry["fields"][name.rpartition("/")[2]][0] = first
    entry.update(size=path.stat().st_size, sha256=sha256_file(path))
    document["self_sha256"] = self_hash(document)
    (store.path / "dataset.json").write_text(json.dumps(document), encoding="utf-8")
    return open_store(store.path)


def assert_reads_as_the_store(store: Store, windows: WindowList) -> None:
    for field in store.fields:
        rows = store._window_rows(windows, field)
        out = np.empty(rows.shape, dtype=rows.dtype)
        for place, window in enumerate(windows):
            out.fill(7)
            of_window = rows.read(place, out)
            assert (of_window is out) == of_window.flags.writeable
            np.testing.assert_array_equal(of_window, store.read(window, field))


@pytest.mark.parametrize("mapped", [True, False])
def test_windows_equal_those_of_the_store(store: Store, mapped: bool) -> None:
    assert len(list(store.path.glob("train*.h5"))) > 2
    store = open_store(store.path, mapped=mapped)
    windows = WindowList.joined("both", [store.windows("train"), store.windows("test")])
    assert_reads_as_the_store(store, windows)
    assert_reads_as_the_store(store, windows.take(np.random.default_rng(0).permutation(len(windows))))


def test_windows_that_cannot_be_read(store: Store) -> None:
    windows = store.windows("train")
    for start, length in ((-1, 30), (10_000, 30), (130, 30), (0, 0)):
        outside = replace(windows, start=windows.start * 0 + start, length=windows.length * 0 + length)
        with raises_message(UsageError, "extends"):
            WindowDataset(store, fields=("pose",), scale=None, windows=outside)
    odd = replace(windows, length=windows.length - (np.arange(len(windows)) == 1))
    with pytest.raises(StoreError, match="differ in length"):
        store._window_rows(odd, "pose")
    with pytest.raises(UsageError, match="no windows"):
        store._window_rows(windows.take(np.zeros(0, dtype=np.int64)), "pose")


@pytest.mark.parametrize("wrong", [-3, 10**6, 2**62])
def test_a_table_that_points_outside_its_shard(tmp_path: Path, store: Store, wrong: int) -> None:
    store = copy_of(store, tmp_path)
    with h5py.File(store.path / "tables.h5", "r+") as file:
        file["clips/motion/fast/start"][0] = wrong
    document = json.loads((store.path / "dataset.json").read_text())
    document["files"]["tables.h5"]["sha256"] = sha256_file(store.path / "tables.h5")
    (store.path / "dataset.json").write_text(json.dumps({**document, "self_sha256": self_hash(document)}))
    for read in (lambda ds: ds.windows("train"), lambda ds: WindowDataset(ds, fields=("pose",), scale=None)):
        with raises_message(StoreError, "outside the rows", where="/clips/motion/fast"):
            read(open_store(store.path))


@pytest.mark.parametrize("change", ["chunks", "elsewhere", "virtual"])
def test_a_field_that_does_not_lie_where_the_description_says(tmp_path: Path, store: Store, change: str) -> None:
    store = repacked(copy_of(store, tmp_path), "motion/pose", change, 4096)
    window, shard = store.windows("train")[0], next(store.path.glob("train-00000*.h5"))
    for read in (lambda: store.read(window, "pose"), lambda: WindowDataset(store, fields=("pose",), scale=None)[0]):
        with raises_message(StoreError, "states|not contiguous", where=f"{shard.name}, /motion/pose"):
            read()


def test_a_file_system_that_maps_nothing(store, caplog, monkeypatch):
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(19, "No such device")

    store = open_store(store.path)
    monkeypatch.setattr(mmap, "mmap", refuse)
    assert_reads_as_the_store(store, store.windows("train"))
    with caplog.at_level(logging.WARNING):
        dataset = WindowDataset(store, fields=("pose",), scale=None, augment={"mirror": 1.0})
        mirror = store.fields["pose"].mirror
        assert mirror is not None
        wanted = mirror.apply(store.read(dataset.windows[5], "pose"))
        np.testing.assert_array_equal(dataset[5]["pose"].numpy(), wanted)
    assert "No such device" in caplog.text


def test_mapped_rows_stay_readable_after_closing(store: Store) -> None:
    store = open_store(store.path)
    rows = store._window_rows(store.windows("train"), "pose")
    store.close()
    rows.read_ahead([0, 1])
    out = np.empty(rows.shape, dtype=rows.dtype)
    np.testing.assert_array_equal(rows.read(0, out), store.read(store.windows("train")[0], "pose"))
