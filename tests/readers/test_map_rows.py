"""Rows of windows from mapped shards, and what is read where they cannot be mapped."""

from __future__ import annotations

import json
import logging
import mmap
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

pytest.importorskip("torch")

from dancedata.core.errors import DanceDataError, StoreError
from dancedata.core.hashing import sha256_file
from dancedata.readers import WindowDataset
from dancedata.store.dataset import Store, open_store
from dancedata.store.dataset_json import self_hash
from dancedata.store.window_list import WindowList
from dancedata.testing.stores import random_fields, write_random_store


def store_of(folder: Path, scope: str, **options: Any) -> Store:
    """A store of several shards with a field of 60 rows a second and one of half precision."""
    pose, fast, music = random_fields({"pose": 21, "fast": 30}, {"tune": 35}, fast=60)
    fields = (pose, fast, replace(music, dtype="float16"))
    given = {"scope": scope, "fields": fields, "shard_bytes": 1 << 15, "order": "name", **options}
    return open_store(write_random_store(folder, **given).path)


def repacked(store: Store, *names: str) -> Store:
    """Compress fields of the first train shard, as h5repack does, and tell dataset.json."""
    document = json.loads((store.path / "dataset.json").read_text(encoding="utf-8"))
    entry = next(s for s in document["shards"] if s["split"] == "train")
    path = store.path / entry["file"]
    with h5py.File(path, "r+") as file:
        for name in names:
            rows = file[name][...]
            del file[name]
            file.create_dataset(name, data=rows, chunks=(7, rows.shape[1]), compression="gzip", shuffle=True)
    entry.update(size=path.stat().st_size, sha256=sha256_file(path))
    document["self_sha256"] = self_hash(document)
    (store.path / "dataset.json").write_text(json.dumps(document), encoding="utf-8")
    return open_store(store.path)


def assert_reads_as_the_store(store: Store, windows: WindowList, **options: Any) -> None:
    for field in store.fields:
        rows = store.window_rows(windows, field, **options)
        out = np.empty(rows.shape, dtype=rows.dtype)
        for place, window in enumerate(windows):
            out.fill(7)
            rows.read_into(place, out)
            np.testing.assert_array_equal(out, store.read(window, field))
            view = rows.view(place)
            if view is not None:
                assert not view.flags.writeable
                np.testing.assert_array_equal(view, out)


@pytest.mark.parametrize("mapped", [True, False])
@pytest.mark.parametrize("scope", ["track", "window"])
def test_windows_are_what_the_store_reads(tmp_path: Path, scope: str, mapped: bool) -> None:
    store = store_of(tmp_path, scope)
    assert len(list(tmp_path.glob("train*.h5"))) > 2
    windows = WindowList.joined("both", [store.windows("train"), store.windows("test")])
    assert_reads_as_the_store(store, windows, mapped=mapped)
    shuffled = windows.take(np.random.default_rng(0).permutation(len(windows)))
    assert_reads_as_the_store(store, shuffled, mapped=mapped)
    assert store.window_rows(windows, "tune", mapped=mapped).unmapped == ("" if mapped else "mapped=False")


def test_other_windows_of_a_track(tmp_path: Path) -> None:
    store = store_of(tmp_path, "track")
    assert_reads_as_the_store(store, store.windows("train", length_frames=17, stride_frames=3))


@pytest.mark.parametrize("scope", ["track", "window"])
@pytest.mark.parametrize(("start", "length"), [(-1, 30), (10_000, 30), (7, 30), (0, 29), (0, 0), (130, 30)])
def test_a_window_that_the_store_does_not_have(tmp_path: Path, scope: str, start: int, length: int) -> None:
    store = store_of(tmp_path, scope, n_frames=(120, 140))
    known = store.windows("train")
    odd = replace(known, start=known.start.copy(), length=np.full(len(known), length))
    odd.start[3] = start
    found: list[str] = []
    for read in (lambda: store.window_rows(odd, "pose"), lambda: [store.locate(w, "pose") for w in odd]):
        try:
            read()
        except DanceDataError as error:
            found.append(str(error))
        else:
            found.append("read")
    assert found[0] == found[1]
    assert (found[0] == "read") == (scope == "track" and (start, length) in ((7, 30), (0, 29)))


def test_windows_of_several_lengths(tmp_path: Path) -> None:
    store = store_of(tmp_path, "track")
    windows = store.windows("train")
    windows.length[1] -= 1
    with pytest.raises(StoreError, match="several lengths"):
        store.window_rows(windows, "pose")


@pytest.mark.parametrize("scope", ["track", "window"])
def test_compressed_fields_are_read_and_named(tmp_path: Path, caplog: pytest.LogCaptureFixture, scope: str) -> None:
    plain = store_of(tmp_path, scope)
    windows = plain.windows("train")
    wanted = {field: [plain.read(window, field) for window in windows] for field in plain.fields}
    store = repacked(plain, "motion/pose", "audio/tune")
    with caplog.at_level(logging.WARNING):
        dataset = WindowDataset(store, fields=tuple(store.fields), normalize=False)
        for place in range(len(dataset)):
            for field in store.fields:
                np.testing.assert_array_equal(dataset[place][field].numpy(), wanted[field][place])
    assert list(dataset.unmapped) == ["pose", "tune"]
    assert "train-00000" in dataset.unmapped["pose"]
    assert "chunked or compressed" in dataset.unmapped["pose"]
    said = [r.getMessage() for r in caplog.records if r.name.startswith("dancedata")]
    assert len(said) == 2
    assert "field pose is not read from mapped files: /motion/pose of train-00000" in said[0]
    assert not plain.window_rows(windows, "fast").unmapped


def test_a_compressed_field_that_is_broken(tmp_path: Path) -> None:
    store = repacked(store_of(tmp_path, "track"), "motion/pose")
    path = next(tmp_path.glob("train-00000*.h5"))
    with h5py.File(path, "r") as file:
        chunk = file["motion/pose"].id.get_chunk_info(0)
    with path.open("r+b") as file:
        file.seek(chunk.byte_offset)
        file.write(bytes(chunk.size))
    with pytest.raises(StoreError, match=r"train-00000.*cannot be read"):
        store.read(store.windows("train")[0], "pose")


def test_a_file_system_that_maps_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(19, "No such device")

    store = store_of(tmp_path, "track")
    monkeypatch.setattr(mmap, "mmap", refuse)
    assert_reads_as_the_store(store, store.windows("train"))
    with caplog.at_level(logging.WARNING):
        dataset = WindowDataset(store, fields=("pose",), normalize=False, mirror=1.0)
        mirror = store.fields["pose"].mirror
        assert mirror is not None
        wanted = mirror.apply(store.read(dataset.windows[5], "pose"))
        np.testing.assert_array_equal(dataset[5]["pose"].numpy(), wanted)
    assert "No such device" in dataset.unmapped["pose"]
    assert "No such device" in caplog.text


def test_not_mapped_because_nobody_wants_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    dataset = WindowDataset(store_of(tmp_path, "track"), fields=("pose",), normalize=False, mapped=False)
    dataset[0]
    assert dataset.unmapped == {"pose": "mapped=False"}
    assert not caplog.records


def test_a_shard_cut_short_after_it_was_opened(tmp_path: Path) -> None:
    store = store_of(tmp_path, "track", clips={"train": 1})
    windows = store.windows("train")
    (shard,) = tmp_path.glob("train*.h5")
    layout = store.locate(windows[0], "tune").shard.layout("tune")
    assert layout.offset is not None
    with shard.open("r+b") as file:
        file.truncate(layout.offset + layout.n_rows * layout.row_bytes - 10)
    with pytest.raises(StoreError, match=r"ends too early.*10 bytes missing"):
        store.window_rows(windows, "tune")


def test_closing_leaves_what_was_mapped_readable(tmp_path: Path) -> None:
    store = store_of(tmp_path, "track")
    rows = store.window_rows(store.windows("train"), "pose")
    store.close()
    rows.read_ahead([0, 1])
    out = np.empty(rows.shape, dtype=rows.dtype)
    rows.read_into(0, out)
    np.testing.assert_array_equal(out, store.read(store.windows("train")[0], "pose"))
