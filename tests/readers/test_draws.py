"""Draws of samples in three epochs, by each way of reading: variation, reproducibility, resuming.

docs/guides/batches.md has what that means.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import ConcatDataset, DataLoader, Subset, random_split

from dancedata.core.errors import UsageError
from dancedata.store.dataset import Store, open_store
from dancedata.torch import (
    BatchLoader,
    BatchStream,
    BucketSampler,
    ClipDataset,
    EpochSampler,
    WindowDataset,
    Windows,
)
from dancedata.torch.draws import mirrored_samples
from tests.messages import raises_message

FIELDS = ("lodge139", "librosa35")
EPOCHS = 3


@pytest.fixture
def train(mixed_store: Store) -> WindowDataset:
    return WindowDataset(mixed_store, fields=FIELDS, augment={"mirror": 0.5}, seed=3)


def loader_of(data: Any, **options: Any) -> Any:
    return DataLoader(data, batch_size=8, **options)


def accelerated(data: Any, **options: Any) -> Any:
    accelerate = pytest.importorskip("accelerate")
    return accelerate.Accelerator(cpu=True).prepare(loader_of(data, **options))


class InLightning:
    """The batches that Lightning's default Trainer hands out, epoch after epoch."""

    def __init__(self, data: Any, **options: Any) -> None:
        lightning = pytest.importorskip("lightning")
        self.batches: list[list[dict[str, Any]]] = []
        epochs = self.batches

        class Model(lightning.LightningModule):  # type: ignore[misc, name-defined]
            def on_train_epoch_start(self) -> None:
                epochs.append([])

            def training_step(self, batch: dict[str, Any], number: int) -> None:
                epochs[-1].append(batch)

            def configure_optimizers(self) -> None:
                return None

        trainer = lightning.Trainer(
            max_epochs=EPOCHS, accelerator="cpu", logger=False, enable_progress_bar=False,
            enable_model_summary=False, enable_checkpointing=False,
        )  # fmt: skip
        trainer.fit(Model(), loader_of(data, **options))
        self.left = iter(self.batches)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(next(self.left))


def workers(data: Any, method: str, **options: Any) -> Any:
    return loader_of(data, num_workers=2, multiprocessing_context=method, **options)


def halves(data: Any) -> Any:
    return random_split(data, [0.5, 0.5], generator=torch.Generator().manual_seed(0))[0]


def concat(data: WindowDataset) -> Any:
    other = WindowDataset(data.store, fields=FIELDS, augment=data.augment, split="val", seed=4)
    return ConcatDataset([Subset(data, range(0, len(data), 2)), ConcatDataset([other])])


#: By the row of the page: a loader of a dataset; iterated over once for each epoch.
FRESH: dict[str, Callable[[WindowDataset], Any]] = {
    "`DataLoader(train)`": loader_of,
    "`DataLoader(train, shuffle=True)`": lambda d: loader_of(d, shuffle=True),
    "the same, `num_workers=2`": lambda d: workers(d, "fork", shuffle=True),
    "the same, `persistent_workers=True`": lambda d: workers(d, "fork", shuffle=True, persistent_workers=True),
    "the same, `spawn`": lambda d: workers(d, "spawn", persistent_workers=True),
    "the same, `forkserver`": lambda d: workers(d, "forkserver"),
    "`ConcatDataset`, `Subset`, `random_split`, without a sampler": lambda d: loader_of(concat(d)),
    "Lightning, `DataLoader(train, shuffle=True)`": lambda d: InLightning(d, shuffle=True),
    "Accelerate, `DataLoader(train, shuffle=True)`": lambda d: accelerated(d, shuffle=True),
    "`BatchLoader(train)`": lambda d: BatchLoader(d, 8),
}
EXACT: dict[str, Callable[[Any, Any], Any]] = {
    "`EpochSampler`": lambda d, s: loader_of(d, sampler=s),
    "the same, 2 workers": lambda d, s: workers(d, "fork", sampler=s),
    "the same, 2 persistent workers": lambda d, s: workers(d, "spawn", sampler=s, persistent_workers=True),
    "`BatchLoader` with an `EpochSampler`": lambda d, s: BatchLoader(d, 8, sampler=s),
    "Accelerate with an `EpochSampler`": lambda d, s: accelerated(d, sampler=s),
    "Lightning with an `EpochSampler`": lambda d, s: InLightning(d, sampler=s),
}
SLOW = pytest.mark.nightly


def draws(loader: Any, epochs: int = EPOCHS) -> list[dict[str, bool]]:
    """Return the draws, epoch by epoch: mirrored or not, by clip and start."""
    return [
        {
            f"{clip}@{int(start)}": bool(flag)
            for batch in loader
            for clip, start, flag in zip(batch["clip"], batch["start"], batch["mirrored"], strict=True)
        }
        for _ in range(epochs)
    ]


def is_slow(way: str) -> bool:
    return any(word in way for word in ("spawn", "forkserver", "persistent", "Lightning"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("way", [pytest.param(way, marks=[SLOW] if is_slow(way) else []) for way in FRESH])
def test_without_a_sampler_that_sets_epochs_draws_are_fresh_and_follow_torchs_seed(train, way):
    if "Accelerate" in way:
        pytest.importorskip("accelerate")
    if "Lightning" in way:
        pytest.importorskip("lightning")
    found = []
    for seed in (1, 1, 2):
        torch.manual_seed(seed)
        if train.epoch is not None:  # Accelerate sets it
            train.set_epoch(None)
        found.append(draws(FRESH[way](train)))
    one, again, other = found
    assert one == again
    assert one[0] != one[1] != one[2] != one[0]
    assert ("Accelerate" in way) == (one[0] == other[0])
    # Over three epochs three samples of four are both mirrored and not, as (1 - 2 / 8) is 3 / 4.
    both = np.mean([len({epoch[key] for epoch in one}) == 2 for key in one[0]])
    assert 0.5 < both < 0.95


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("way", "part"),
    [
        pytest.param(way, part, marks=[SLOW] if is_slow(way) or ("workers" in way and part != "concat") else [])
        for way in EXACT for part in ("whole", "halves", "concat")
    ],
)  # fmt: skip
def test_with_an_epoch_sampler_draws_are_a_function_of_seed_epoch_and_index(train, way, part):
    if "BatchLoader" in way and part != "whole":
        pytest.skip("a BatchLoader reads a WindowDataset itself")
    data = {"whole": train, "halves": halves(train), "concat": concat(train)}[part]
    torch.manual_seed(5)
    found = draws(EXACT[way](data, EpochSampler(data, seed=1, rank=0, world_size=1)))
    assert found[0] != found[1] != found[2] != found[0]
    if part != "concat":
        for epoch, flags in enumerate(found):
            wanted = mirrored_samples(3, epoch, range(len(train)), 0.5)
            named = {f"{w.clip}@{w.start}": bool(flag) for w, flag in zip(train.windows, wanted, strict=True)}
            assert flags == {key: named[key] for key in flags}
    torch.manual_seed(6)  # another state of torch's generator changes nothing
    reference = draws(loader_of(data, sampler=EpochSampler(data, seed=1)))
    assert found == reference


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("method", ["fork", "forkserver", pytest.param("spawn", marks=SLOW)])
def test_every_window_once_with_the_values_of_the_store_and_the_draws_of_the_epoch(store_path, method):
    dataset = WindowDataset(store_path, windows=Windows(stride=20), scale=None, augment={"mirror": 0.5}, seed=9)
    # Read here as well before the workers start: a file handle opened here must not reach them.
    dataset[0]
    loader = DataLoader(
        dataset, 64, num_workers=2, shuffle=True, persistent_workers=True, multiprocessing_context=method
    )
    store, windows = open_store(store_path), dataset.windows
    flags = {epoch: mirrored_samples(9, epoch, range(len(dataset)), 0.5) for epoch in (0, 5)}
    assert (flags[0] != flags[5]).any()
    for epoch in (0, 5, 0):
        dataset.set_epoch(epoch)
        found = []
        for batch in loader:
            found += list(zip(batch["clip"], batch["start"].tolist(), batch["length"].tolist(), strict=True))
            assert batch["mirrored"].tolist() == flags[epoch][batch["index"]].tolist()
            for nth, index in enumerate(batch["index"].tolist() if epoch else ()):
                for field in ("librosa35",) if flags[epoch][index] else ("edge151", "librosa35"):
                    np.testing.assert_array_equal(batch[field][nth].numpy(), store.read(windows[index], field))
        assert sorted(found) == sorted((window.clip, window.start, window.length) for window in windows)
        assert len(set(found)) == len(windows)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("part", "n_workers"),
    [
        ("whole", 0), ("halves", 0), ("concat", 0), ("concat", 2), pytest.param("whole", 2, marks=SLOW),
        pytest.param("halves", 2, marks=SLOW), ("whole", "accelerate"),
    ],
)  # fmt: skip
def test_resumes_in_the_middle_of_an_epoch_to_the_bit(mixed_store: Store, part: str, n_workers: Any) -> None:
    def opened() -> tuple[EpochSampler, Any]:
        own = WindowDataset(mixed_store, fields=FIELDS, augment={"mirror": 0.5, "drop": 0.5}, seed=3)
        data = {"whole": own, "halves": halves(own), "concat": concat(own)}[part]
        sampler = EpochSampler(data, seed=1, rank=0, world_size=1)
        if n_workers == "accelerate":
            return sampler, accelerated(data, sampler=sampler)
        return sampler, loader_of(data, sampler=sampler, num_workers=n_workers)

    sampler, loader = opened()
    whole = [batch for _ in range(2) for batch in loader]
    resumed, again = opened()
    steps = sampler.steps(8)
    resumed.load_state_dict(resumed.at(1, 2 * 8))
    if n_workers == "accelerate":
        again.set_epoch(resumed.epoch)
    rest = list(again)
    assert len(rest) == steps - 2
    for one, other in zip(rest, whole[steps + 2 :], strict=True):
        assert one["id"] == other["id"]
        assert all(torch.equal(one[name], other[name]) for name in FIELDS)


@pytest.mark.parametrize("n_workers", [0, 2])
@pytest.mark.filterwarnings("ignore")
def test_streams_are_functions_of_the_step(train: WindowDataset, n_workers: int) -> None:
    steps = BatchStream(train, 8, seed=1).steps_per_epoch
    loader = BatchStream(train, 8, seed=1).by_epoch(num_workers=n_workers)
    assert len(loader) == steps
    found = draws(loader)
    assert found == draws(loader_of(train, sampler=EpochSampler(train, seed=1)))
    later = BatchStream(train, 8, seed=1, start_step=steps + 1).by_epoch(num_workers=n_workers)
    rest, last = draws(later, 2)
    assert rest.items() <= found[1].items()
    assert (len(rest), last) == (len(train) - 8, found[2])
    assert later.step == 3 * steps
    with raises_message(UsageError, "steps"):
        BatchStream(train, 8, steps=3).by_epoch()
    with raises_message(UsageError, "stream"):
        BatchStream(halves(train), 8)


@pytest.mark.parametrize(("epoch", "p"), [(0, 0.5), (3, 0.3), (2**62 + 1, 0.5)])
def test_draws_of_few_samples_are_those_of_numpys_stream(epoch: int, p: float) -> None:
    stream = np.random.Philox(np.random.SeedSequence(5, spawn_key=(2, epoch)))
    wanted = (stream.random_raw(4000) >> np.uint64(11)) * 2.0**-53 < p
    for places in (range(4000), [3999], [7, 2, 3000], range(0, 4000, 399)):
        assert mirrored_samples(5, epoch, places, p).tolist() == wanted[list(places)].tolist()
    stream = np.random.Philox(np.random.SeedSequence(5, spawn_key=(2, epoch))).advance(2**60)
    assert mirrored_samples(5, epoch, [2**62 + 2], 0.5) == [stream.random_raw(3)[2] < 2**63]


def test_a_batch_loader_passes_on_the_epoch_of_a_sampler_that_has_no_dataset(train: WindowDataset) -> None:
    found = draws(BatchLoader(train, 8, sampler=EpochSampler(len(train), seed=1)))
    assert train.epoch is None
    shuffled = draws(BatchLoader(train, 8, shuffle=True))
    assert train.epoch is None  # so that a later loop without a sampler draws new numbers
    assert found == draws(loader_of(train, sampler=EpochSampler(train, seed=1)))
    assert shuffled == found


def test_crops_and_buckets_draw_new_numbers_too(mixed_store: Store) -> None:
    crops = ClipDataset(mixed_store, fields=FIELDS, windows=Windows(length=40), crops=3, seed=1)
    starts = [[sample["start"] for sample in crops.samples(range(len(crops)))] for _ in range(2)]
    assert starts[0] != starts[1]
    torch.manual_seed(3)
    again = [sample["start"] for sample in crops.samples(range(len(crops)))]
    torch.manual_seed(3)
    assert again == [sample["start"] for sample in crops.samples(range(len(crops)))]
    clips = ClipDataset(mixed_store, fields=FIELDS, augment={"mirror": 0.5})
    next(iter(BucketSampler(clips, batch_size=2)))
    assert clips.epoch == 0


def test_nothing_is_taken_from_torchs_generator_without_a_draw(mixed_store: Store) -> None:
    torch.manual_seed(3)
    state = torch.get_rng_state()
    for options in ({}, {"augment": {"mirror": 1.0}}):
        data = WindowDataset(mixed_store, fields=FIELDS, **options)  # type: ignore[arg-type]
        assert data.epoch is None
        _ = data[0], data.__getitems__([1, 2]), next(iter(BatchLoader(data, 2)))
    assert torch.equal(torch.get_rng_state(), state)
    random = WindowDataset(mixed_store, fields=FIELDS, augment={"mirror": 0.5})
    random.set_epoch(1)
    random[0]
    assert torch.equal(torch.get_rng_state(), state)


def test_ranks_that_share_torchs_seed_do_not_share_their_draws(train: WindowDataset) -> None:
    """As under DistributedSampler: draws belong to samples, not to places in a batch."""
    flags = []
    for rank in range(2):
        torch.manual_seed(0)
        flags.append([sample["mirrored"] for sample in train.samples(range(rank, len(train) - 1, 2))])
    assert 0.2 < np.mean(np.array(flags[0]) == np.array(flags[1])) < 0.8


def test_a_sample_is_restored_from_its_id(train: WindowDataset) -> None:
    for sample in train.samples(range(12)):
        drawn = re.fullmatch(r"(.+)@(\d+)\+(\d+)(?:~mirror~draw(\d+)\.(\d+)\.(\d+))?", sample["id"])
        assert drawn is not None
        clip, start, length, seed, epoch, index = drawn.groups()
        assert (clip, int(start), int(length)) == (sample["clip"], sample["start"], sample["length"])
        assert (seed is not None) == sample["mirrored"]
        if seed is not None:
            (again,) = train.samples([int(index)], int(epoch))
            assert again["id"] == sample["id"]
            assert torch.equal(again["lodge139"], sample["lodge139"])


class Held:
    """A wrapper of a user, not of torch's class: its attributes include its datasets and itself."""

    def __init__(self, inner: Any) -> None:
        self.inner, self.number, self.parts, self.names = {"a": inner}, 3, [[self]], "abc"

    def __len__(self) -> int:
        return len(self.inner["a"])

    def __getitem__(self, index: int) -> Any:
        return self.inner["a"][index]


def test_the_sampler_reaches_wrapped_datasets(train: WindowDataset) -> None:
    other = WindowDataset(train.store, fields=FIELDS, augment={"mirror": 0.5})
    sampler = EpochSampler(ConcatDataset([Held(train), Subset(other, [1, 2])]))
    sampler.set_epoch(4)
    next(iter(sampler))
    assert (train.epoch, other.epoch) == (4, 4)
    assert next(iter(EpochSampler([10, 20], shuffle=False))) == 0
    for epoch in (2**63, -1):
        with raises_message(UsageError, "large|epoch"):
            train.set_epoch(epoch)
