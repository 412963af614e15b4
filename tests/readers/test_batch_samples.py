"""Batches as `WindowDataset.__getitems__` reads them, torch's collate puts them together, and memory goes round."""

import copy
import importlib.util
import os
import pickle
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, default_collate

from dancedata.store.dataset import Store
from dancedata.torch import BatchLoader, ClipDataset, Scale, WindowDataset
from dancedata.torch.batch_reader import MemoryPool, shared_tensor
from dancedata.torch.collate import collate
from tests.readers.batches import FIELDS, MODES, assert_equal, bits, dataset_of


def plain(dataset: WindowDataset, place: int, mirrored: bool, name: str) -> np.ndarray[Any, Any]:
    """Read one field of one window a step at a time, independently of the dataset."""
    rows = dataset.store.read(dataset.windows[place], name)
    columns = dataset.store.fields[name]
    if mirrored and dataset.store.field(name).kind == "motion":
        assert columns.mirror is not None
        rows = columns.mirror.apply(rows)
    if name in dataset._roots:
        root = columns.slice("translation")
        rows[:, root] = rows[:, root] - rows[:1, root]
    if name in dataset._normalizers:
        rows = dataset.scaler(name).normalize(rows).astype(np.float32)
    return np.asarray(rows)


@pytest.mark.parametrize("mode", MODES)
def test_batches_equal_reading_step_by_step_bit_for_bit(mixed_store: Store, mode: str) -> None:
    dataset = dataset_of(mixed_store, mode)
    dataset.set_epoch(3)
    places = np.random.default_rng(0).permutation(len(dataset)).tolist()
    batch = dataset.__getitems__(places)
    flags = {item["mirrored"] for item in batch}
    assert flags == ({True, False} if dataset.mirror else {False})
    for place, item in zip(places, batch, strict=True):
        assert_equal(item, dataset[place])
        for name in dataset.fields:
            assert bits(item[name]) == bits(torch.from_numpy(plain(dataset, place, item["mirrored"], name)))


def is_copied(batch: Mapping[str, Any], items: Any) -> list[str]:
    """Name the fields whose batch does not begin where the first sample does."""
    return [f for f in FIELDS if batch[f].data_ptr() != items[0][f].data_ptr()]


def test_a_batch_is_not_copied(mixed_store: Store) -> None:
    items = dataset_of(mixed_store, "normalised").__getitems__([5, 1, 3])
    assert is_copied(default_collate(items), items) == []
    assert is_copied(WindowDataset.collate(items), items) == []


def test_a_partial_batch_is_copied_correctly(mixed_store: Store) -> None:
    dataset = dataset_of(mixed_store, "normalised")
    items, others = dataset.__getitems__([5, 1, 3]), dataset.__getitems__([5, 1, 3])
    odd = [
        items[:2], items[1:], items[::-1], [items[0], items[1], items[1]], items + others,
        [items[0], others[1], items[2]], [items[0], dict(items[1]), items[2]], [copy.copy(item) for item in items],
        [dataset[5], dataset[1], dataset[3]],
    ]  # fmt: skip
    for given in odd:
        found = WindowDataset.collate(given)
        assert is_copied(found, given) == list(FIELDS)
        assert_equal(found, default_collate([dict(item) for item in given]))


def test_keys_added_to_samples_are_in_the_batch(mixed_store: Store) -> None:
    items = dataset_of(mixed_store, "normalised").__getitems__([5, 1, 3])
    for again in (pickle.loads(pickle.dumps(items[0])), copy.copy(items[0]), copy.deepcopy(items[0])):
        assert type(again) is dict
        assert_equal(again, items[0])
    items[1]["fast"] = items[1]["fast"] * 2
    items[2]["half"] += 1
    for item in items:
        item["more"] = torch.ones(2)
        del item["genre"]
    found = default_collate(items)
    assert is_copied(found, items) == ["fast"]
    assert_equal(found, default_collate([dict(item) for item in items]))
    assert "genre" not in found
    assert found["more"].shape == (3, 2)
    del items[1]["half"]
    with pytest.raises(KeyError, match="half"):
        default_collate(items)


LARGE = (1 << 19, 3)


def test_kept_memory_is_limited_for_all_sizes() -> None:
    pool = MemoryPool()
    for more in range(30):
        tensor = pool.tensor((LARGE[0] + more, 3), np.dtype(np.float32))
        assert tensor.shape == (LARGE[0] + more, 3)
        del tensor
    assert 2 <= len(pool._idle) < 10


@pytest.mark.parametrize(
    "array",
    [
        np.arange(24, dtype=np.float16).reshape(4, 6)[:, ::2], np.array([True, False, True]),
        np.zeros((3, 0, 4), dtype=np.float32),
    ],
)  # fmt: skip
@pytest.mark.parametrize("without", ["", "torch", "system", "refused", "changed"])
def test_shared_copies(array: Any, without: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(38, "Function not implemented")

    def changed(descriptor: int) -> None:
        raise AssertionError(descriptor)

    if without == "torch":
        monkeypatch.setattr(torch.UntypedStorage, "_new_shared_fd_cpu", None)
    elif without == "system":
        monkeypatch.delattr(os, "memfd_create", raising=False)
    elif without == "refused":
        monkeypatch.setattr(os, "memfd_create", refuse, raising=False)
    elif without == "changed":
        monkeypatch.setattr(torch.UntypedStorage, "_new_shared_fd_cpu", changed)
    shared_tensor(array)  # what torch and Python open once and for all
    before = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
    found = shared_tensor(array)
    assert found.is_shared()  # type: ignore[no-untyped-call]
    assert bits(found) == bits(torch.from_numpy(np.ascontiguousarray(array)))
    found.fill_(1)
    del found
    # Not "==": what other tests left behind may be closed at any time.
    assert before >= (len(os.listdir("/proc/self/fd")) if before else 0)


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
@pytest.mark.parametrize("without", ["", "torch", "system"])
@pytest.mark.parametrize("strategy", ["file_descriptor", "file_system"])
def test_workers_send_batches_however_memory_is_shared(mixed_store, without, strategy, monkeypatch):
    sharing: Any = torch.multiprocessing
    if strategy not in sharing.get_all_sharing_strategies():
        pytest.skip(f"torch has no {strategy} here")
    if without == "torch":
        monkeypatch.setattr(torch.UntypedStorage, "_new_shared_fd_cpu", None)
        if strategy == "file_descriptor":
            pytest.skip("torch itself needs it to receive batches so")
    elif without == "system":
        monkeypatch.delattr(os, "memfd_create", raising=False)
    dataset = dataset_of(mixed_store, "mirrored and normalised")
    usual = sharing.get_sharing_strategy()
    sharing.set_sharing_strategy(strategy)
    try:
        found = list(DataLoader(dataset, 16, num_workers=1))
    finally:
        sharing.set_sharing_strategy(usual)
    for one, other in zip(found, DataLoader(dataset, 16), strict=True):
        assert_equal(one, other)


def test_a_torch_that_takes_no_collate_functions(mixed_store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """The module without torch's table: its samples are stacked, and right."""
    monkeypatch.setitem(sys.modules, "torch.utils.data._utils.collate", None)
    spec = importlib.util.spec_from_file_location("collate_alone", collate.__code__.co_filename)
    assert spec is not None
    assert spec.loader is not None
    alone = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "collate_alone", alone)
    spec.loader.exec_module(alone)
    items = dataset_of(mixed_store, "normalised").__getitems__([5, 1, 3])
    tensors = {name: torch.stack([item[name] for item in items]) for name in FIELDS}
    batch = alone.Batch.of(3, tensors)
    samples = [alone.Sample({**item, **{f: batch.rows[f][k] for f in FIELDS}}, batch) for k, item in enumerate(items)]
    wanted = default_collate([dict(item) for item in items])
    found = default_collate(samples)
    assert type(found) is dict
    assert is_copied(found, samples) == list(FIELDS)
    assert_equal(found, wanted)
    assert is_copied(alone.collate(samples), samples) == []


def test_fields_of_half_precision_are_normalised_in_float32(mixed_store: Store) -> None:
    """All three ways of reading, against numpy in float64: float16 would be off by 1e-3."""
    names = ("half", "fast")
    options: dict[str, Any] = {"fields": ("half", "fast", "lodge139"), "scale": Scale(fields=names), "seed": 3}
    windows = WindowDataset(mixed_store, **options)
    batch = next(iter(BatchLoader(windows, 4)))
    clips = ClipDataset(mixed_store, **options)
    for name in names:
        scaler = mixed_store.scaler(name)
        low, high = scaler.data_min, scaler.data_max
        for found, rows in (
            (batch[name][2], mixed_store.read(windows.windows[2], name)),
            (windows[5][name], mixed_store.read(windows.windows[5], name)),
            (clips[1][name], mixed_store.read(clips.windows[1], name)),
        ):
            assert rows.dtype == np.float16
            assert found.dtype == torch.float32
            wanted = 2 * (rows.astype(np.float64) - low) / (high - low) - 1
            np.testing.assert_allclose(found.numpy(), wanted, rtol=0, atol=1e-5)
            half = scaler.unnormalize(found.to(torch.bfloat16))
            assert half.dtype == torch.float32
