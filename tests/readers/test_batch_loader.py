"""BatchLoader against a DataLoader, batch by batch and bit by bit; its memory, its threads, and its end."""

import gc
import itertools
import os
import pickle
import random
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from dancedata.core.errors import StoreError, UsageError
from dancedata.store.dataset import Store
from dancedata.torch import BatchLoader, EpochSampler
from dancedata.torch import batch_reader as memory
from tests.messages import raises_message
from tests.readers.batches import FIELDS, MODES, assert_equal, bits, dataset_of


def assert_same(found: Any, wanted: Any) -> int:
    """Go through two loaders at once; return how many batches there were."""
    n = 0
    for one, other in itertools.zip_longest(found, wanted):
        assert one is not None, f"{n} batches and no more"
        assert other is not None, f"more than {n} batches"
        assert_equal(one, other)
        n += 1
    return n


def n_threads() -> int:
    return sum(thread.name.startswith("BatchLoader") for thread in threading.enumerate())


@pytest.fixture(autouse=True)
def no_thread_stays() -> Iterator[None]:
    yield
    if n_threads():
        gc.collect()
    assert n_threads() == 0


@pytest.fixture(autouse=True)
def small_batches_go_round(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the small arrays here use memory again as large ones do, at once."""
    monkeypatch.setattr(memory, "_LARGE", 1)


@pytest.mark.parametrize("mode", MODES)
def test_equals_a_data_loader_epoch_after_epoch(mixed_store: Store, mode: str) -> None:
    ours, theirs = dataset_of(mixed_store, mode), dataset_of(mixed_store, mode)
    loader = BatchLoader(ours, 8, sampler=EpochSampler(ours, seed=1))
    reference: DataLoader[Any] = DataLoader(theirs, 8, sampler=EpochSampler(theirs, seed=1))
    for _ in range(3):
        assert assert_same(loader, reference) == len(loader) == len(reference) > 3


@pytest.mark.parametrize("drop_last", [False, True])
@pytest.mark.parametrize(("threads", "prefetch"), [(1, 1), (3, 1), (2, 5), (1, 40)])
def test_equals_it_with_any_threads_and_prefetch(mixed_store, drop_last, threads, prefetch):
    ours, theirs = dataset_of(mixed_store), dataset_of(mixed_store)
    sampler = EpochSampler(ours, seed=1, rank=1, world_size=2)
    loader = BatchLoader(ours, 7, sampler=sampler, drop_last=drop_last, threads=threads, prefetch=prefetch)
    reference: DataLoader[Any] = DataLoader(
        theirs, 7, sampler=EpochSampler(theirs, seed=1, rank=1, world_size=2), drop_last=drop_last
    )
    for _ in range(2):
        assert assert_same(loader, reference) == len(loader) == len(reference)


def test_without_a_sampler(mixed_store: Store) -> None:
    dataset = dataset_of(mixed_store)
    assert_same(BatchLoader(dataset, 8), DataLoader(dataset, 8))
    shuffled = BatchLoader(dataset, 8, shuffle=True)
    assert isinstance(shuffled.sampler, EpochSampler)
    assert_same(shuffled, DataLoader(dataset, 8, sampler=EpochSampler(dataset, seed=3)))
    next(iter(shuffled))
    sampler = EpochSampler(dataset, seed=3)
    sampler.set_epoch(2)
    assert_same(shuffled, DataLoader(dataset, 8, sampler=sampler))  # nothing of epoch 2 is missing
    plain = [3, 1, 4, 1, 5]
    assert_same(BatchLoader(dataset, 2, sampler=plain), DataLoader(dataset, 2, sampler=plain))
    assert list(BatchLoader(dataset, 2, sampler=[])) == []


def parts_of(batch: dict[str, Any]) -> list[Any]:
    """Objects that share a batch's memory: rows, an array, a view as another type, a tensor made of one."""
    array = batch["lodge139"][:, ::2].numpy()
    return [
        batch["fast"][3], batch["half"][2:].numpy(), batch["librosa35"].view(torch.int32), torch.from_numpy(array),
    ]  # fmt: skip


@pytest.mark.parametrize("prefetch", [1, 3])
def test_kept_batches_are_not_written_to(mixed_store: Store, prefetch: int) -> None:
    dataset = dataset_of(mixed_store, "plain")
    wanted = [parts_of(batch) for batch in DataLoader(dataset, 8)]
    loader = BatchLoader(dataset, 8, prefetch=prefetch)
    kept: list[tuple[Any, Any]] = []
    dice = random.Random(0)
    for _ in range(3):
        for nth, batch in enumerate(loader):
            parts = parts_of(batch)
            kept += [(parts[k], wanted[nth][k]) for k in range(4) if dice.random() < 0.3]
            del batch, parts
    assert len(kept) > 12
    for part, same in kept:
        np.testing.assert_array_equal(np.asarray(part), np.asarray(same))


def test_tensors_kept_by_autograd_are_not_written_to(mixed_store: Store) -> None:
    loader = BatchLoader(dataset_of(mixed_store, "plain"), 8)
    factor = torch.ones((), requires_grad=True)
    total = torch.zeros(())
    for batch in loader:
        total = total + (batch["lodge139"] * factor).sum()
    total.backward()  # type: ignore[no-untyped-call]
    wanted = sum(float(batch["lodge139"].sum()) for batch in DataLoader(loader.dataset, 8))
    assert factor.grad is not None
    assert float(factor.grad) == pytest.approx(wanted, rel=1e-4, abs=1e-2)


@pytest.mark.parametrize("prefetch", [1, 2, 4])
def test_memory_goes_round(mixed_store: Store, prefetch: int) -> None:
    loader = BatchLoader(dataset_of(mixed_store), 8, prefetch=prefetch, shuffle=True)
    places = {name: set[int]() for name in FIELDS}
    for stop in (None, 3, None, None):  # one epoch is abandoned
        for batch in itertools.islice(loader, stop):
            for name in FIELDS:
                places[name].add(batch[name].data_ptr())
    for name in FIELDS:
        assert len(places[name]) <= prefetch + 2
    assert len(loader) > prefetch + 2


def test_an_error_before_the_first_batch(mixed_store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = dataset_of(mixed_store)
    loader = BatchLoader(dataset, 8)

    def broken() -> None:
        raise StoreError("a shard is gone")

    with monkeypatch.context() as patch:
        patch.setattr(dataset, "_batch_reader", broken)
        with pytest.raises(StoreError, match="gone"):
            iter(loader)
    gc.collect()  # an error in __del__ would be one of the test
    assert n_threads() == 0
    assert_same(loader, DataLoader(dataset, 8))


def test_the_garbage_collector_may_end_it_in_a_thread(mixed_store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = dataset_of(mixed_store)
    wanted = [bits(batch) for batch in DataLoader(dataset, 8)]
    fill, gone, ended = dataset._batch_reader(), threading.Event(), threading.Event()

    def collecting(request: Any, out: Any) -> None:
        if 17 in request.places and not ended.is_set():
            assert gone.wait(60)
            gc.collect()
            ended.set()
        fill(request, out)

    collecting.layout = fill.layout  # type: ignore[attr-defined]
    monkeypatch.setattr(dataset, "_batch_reader", lambda: collecting)
    loader = BatchLoader(dataset, 8, threads=1)
    gc.disable()
    try:
        batches: Any = iter(loader)
        next(batches)
        batches.itself = batches
        del batches
        gone.set()
        assert ended.wait(60)
    finally:
        gc.enable()
    for _ in range(2):
        assert [bits(batch) for batch in loader] == wanted


def test_an_error_in_a_thread_is_raised_in_the_loop(mixed_store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = dataset_of(mixed_store)
    fill, wanted = dataset._batch_reader(), list(BatchLoader(dataset, 8))

    def broken(request: Any, out: Any) -> None:
        if 17 in request.places:
            raise StoreError("a shard cannot be read", where="here")
        fill(request, out)

    broken.layout = fill.layout  # type: ignore[attr-defined]
    monkeypatch.setattr(dataset, "_batch_reader", lambda: broken)
    batches = iter(BatchLoader(dataset, 8))
    assert_same(itertools.islice(batches, 2), wanted[:2])
    with pytest.raises(StoreError, match="here"):
        next(batches)
    assert list(batches) == []
    assert n_threads() == 0
    batches = iter(BatchLoader(dataset_of(mixed_store), 2, sampler=[0, 1, 2, 3, 4, 5, 6, 10_000]))
    next(batches)
    with pytest.raises(IndexError, match="10000"):
        next(batches)
    assert n_threads() == 0


def test_leaving_the_loop_ends_the_threads(mixed_store: Store) -> None:
    loader = BatchLoader(dataset_of(mixed_store), 4)
    for _ in loader:
        assert n_threads() > 0
        break
    assert n_threads() == 0
    assert_same(loader, DataLoader(loader.dataset, 4))
    batches = iter(BatchLoader(dataset_of(mixed_store), 4))  # nothing refers to the loader
    next(batches)
    del batches
    assert n_threads() == 0


def test_one_iteration_at_a_time(mixed_store: Store) -> None:
    loader = BatchLoader(dataset_of(mixed_store), 8)
    first = iter(loader)
    next(first)
    second = iter(loader)
    with raises_message(UsageError, "iteration"):
        next(first)
    assert_same(second, DataLoader(loader.dataset, 8))
    assert next(second, None) is None
    third = iter(loader)
    assert next(second, None) is None
    assert next(third) is not None


def in_child(work: Callable[[], int]) -> int:
    """Run in a forked child; return what it returned."""
    child = os.fork()
    if child == 0:
        code = 99
        try:
            code = work()
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_a_forked_child_starts_its_own_iteration(mixed_store: Store) -> None:
    loader = BatchLoader(dataset_of(mixed_store), 8)
    wanted = [batch["index"].tolist() for batch in loader]
    batches = iter(loader)
    next(batches)

    def work() -> int:
        try:
            next(batches)
        except UsageError as error:
            if "another process" not in str(error):
                return 1
        else:
            return 2
        return 0 if [batch["index"].tolist() for batch in loader] == wanted else 3

    assert in_child(work) == 0
    assert [batch["index"].tolist() for batch in batches] == wanted[1:]


def test_pickled_without_threads_and_memory(mixed_store: Store) -> None:
    loader = BatchLoader(dataset_of(mixed_store), 8, sampler=EpochSampler(len(dataset_of(mixed_store)), seed=4))
    batches = iter(loader)
    next(batches)
    text = pickle.dumps(loader)
    assert len(text) < 100_000
    again = pickle.loads(text)
    again.sampler.load_state_dict({"epoch": 0, "position": 0})
    reference = DataLoader(dataset_of(mixed_store), 8, sampler=EpochSampler(len(loader.dataset), seed=4))
    assert_same(again, reference)


@pytest.mark.parametrize(
    "wrong", [{"batch_size": 0}, {"threads": 0}, {"prefetch": 0}, {"threads": 1.5}, {"sampler": [1], "shuffle": True}]
)
def test_wrong_arguments(mixed_store: Store, wrong: dict[str, Any]) -> None:
    with raises_message(UsageError, "sampler|small|threads"):
        BatchLoader(dataset_of(mixed_store), **wrong)


def test_pinned_memory_with_a_device(mixed_store: Store) -> None:
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device here")
    dataset = dataset_of(mixed_store)
    loader = BatchLoader(dataset, 8, pin_memory=True)
    assert loader.pinned
    reference: DataLoader[Any] = DataLoader(dataset, 8)
    on_device = []
    for batch in loader:
        assert batch["half"].is_pinned()
        on_device.append(batch["half"].to("cuda", non_blocking=True))
    torch.cuda.synchronize()
    for found, wanted in zip(on_device, reference, strict=True):
        assert torch.equal(found.cpu(), wanted["half"])


def test_pinned_memory_without_a_device(mixed_store, monkeypatch, caplog):
    """It is not pinned, which is said; with one, arrays are torch's, and the batches are the same."""
    if torch.cuda.is_available():
        pytest.skip("test_pinned_memory_with_a_device does this")
    dataset = dataset_of(mixed_store)
    assert not BatchLoader(dataset, 8, pin_memory=True).pinned
    assert "not pinned" in caplog.text
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    loader, pinned = BatchLoader(dataset, 8, pin_memory=True), []
    assert loader.pinned
    monkeypatch.undo()
    monkeypatch.setattr(
        torch,
        "empty",
        lambda shape, *, dtype, pin_memory: pinned.append(pin_memory) or torch.zeros(shape, dtype=dtype),
    )
    batches = list(loader)
    monkeypatch.undo()
    assert_same(batches, DataLoader(dataset, 8))
    assert pinned
    assert all(pinned)
