"""Mix: exact shares, every sample in turn, one scaler, and the guarantees of one dataset."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from dancedata.core.errors import UsageError
from dancedata.store import Store, open_store, write_store
from dancedata.testing.stores import random_fields, write_random_store
from dancedata.torch import (
    BatchLoader,
    BatchStream,
    BucketSampler,
    ClipDataset,
    Dancers,
    EpochSampler,
    GroupDataset,
    Mix,
    WindowDataset,
    pad_clips,
)
from tests.groups_store import HEADER, stored
from tests.messages import raises_message
from tests.readers.batches import bits


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Store]:
    """Stores of 33, 9 and 6 train windows."""
    folder = tmp_path_factory.mktemp("mix")
    for k, (name, clips) in enumerate({"large": 11, "middle": 3, "small": 2}.items()):
        options = {"n_frames": (60, 60), "length": 40, "stride": 10, "seed": k}
        write_random_store(folder / name, clips={"train": clips, "val": 1}, **options)
    return {name: open_store(folder / name) for name in ("large", "middle", "small")}


def windows(stores: dict[str, Store], **options: Any) -> dict[str, WindowDataset]:
    return {name: WindowDataset(store, **options) for name, store in stores.items()}


def ids(samples: list[dict[str, Any]]) -> list[tuple[str, str]]:
    return [(s["source"], s["id"]) for s in samples]


def test_without_weights_every_sample_comes_once(stores: dict[str, Store]) -> None:
    parts = windows(stores)
    mix = Mix(parts)
    assert (len(mix), mix.counts, mix.sources) == (48, (33, 9, 6), ("large", "middle", "small"))
    samples = [mix[k] for k in range(len(mix))]
    assert [s["source_id"] for s in samples] == [0] * 33 + [1] * 9 + [2] * 6
    plain = [dataset[k] for dataset in parts.values() for k in range(len(dataset))]
    for sample, one in zip(samples, plain, strict=True):
        assert sample["id"] == f"{sample['source']}={one['id']}"
        assert sample["clip"] == one["clip"]
    assert mix[-1]["id"] == samples[-1]["id"]
    orders = [ids(Mix(parts, weights=(1, 1, 1), seed=seed).samples(range(48), 5)) for seed in (0, 0, 1)]
    assert orders[0] == orders[1] != orders[2]
    with pytest.raises(IndexError):
        mix[48]


@pytest.mark.parametrize("world_size", range(1, 9))
def test_shares_are_exact_for_all_ranks_and_samples_take_turns(stores: dict[str, Store], world_size: int) -> None:
    mix = Mix(windows(stores), weights=(1, 2, 5), n_samples=8 * 21, seed=world_size)
    assert mix.counts == (21, 42, 105)
    assert Mix(windows(stores), weights=(1, 2, 7), n_samples=7).counts == (1, 1, 5), "by largest remainders"
    seen: Counter[tuple[str, str]] = Counter()
    for epoch in range(3):
        of_epoch: list[int] = []
        for rank in range(world_size):
            of_epoch += EpochSampler(mix, seed=1, rank=rank, world_size=world_size).order(epoch).tolist()
        assert sorted(set(of_epoch)) == [*range(len(mix))]
        assert len(of_epoch) - len(mix) < world_size
        samples = mix.samples(sorted(set(of_epoch)), epoch)
        assert Counter(s["source"] for s in samples) == {"large": 21, "middle": 42, "small": 105}
        seen.update(ids(samples))
        for name, dataset in windows(stores).items():
            counts = [seen[name, f"{name}/{dataset[k]['id']}"] for k in range(len(dataset))]
            assert max(counts) - min(counts) <= 1


@pytest.mark.parametrize("workers", [0, 2])
def test_all_loaders_give_the_same_bits_and_resume_anywhere(stores: dict[str, Store], workers: int) -> None:
    def made() -> Mix:
        return Mix(windows(stores, augment={"mirror": 0.5}), weights=(3, 1, 1), seed=2)

    mix = made()
    whole = [*BatchLoader(mix, 5, sampler=EpochSampler(mix, seed=3))]
    loader = DataLoader(mix, 5, sampler=EpochSampler(mix, seed=3), num_workers=workers)
    for a, b in zip(whole, loader, strict=True):
        assert bits(a) == bits(b)
    stream = BatchStream(made(), 5, seed=3, steps=12)
    for step, a in enumerate(whole):
        assert bits(a) == bits(stream.batch(step))
    for consumed in (0, 7, 46):
        resumed = made()
        sampler = EpochSampler(resumed, seed=3)
        sampler.load_state_dict(sampler.at(0, consumed))
        rest = [sample_id for batch in DataLoader(resumed, 5, sampler=sampler) for sample_id in batch["id"]]
        assert rest == [sample_id for batch in whole for sample_id in batch["id"]][consumed:]


def test_a_repeated_sample_is_changed_anew(stores: dict[str, Store]) -> None:
    mix = Mix(windows(stores, augment={"mirror": 0.5}), weights=(1, 1, 60), n_samples=62 * 6, seed=0)
    mirrored: dict[str, set[bool]] = {}
    for sample in mix.samples(range(len(mix)), 0):
        if sample["source"] == "small":
            mirrored.setdefault(f"{sample['clip']} {sample['start']}", set()).add(sample["mirrored"])
    assert len(mirrored) == 6
    assert all(of_window == {False, True} for of_window in mirrored.values())


def test_one_scaler_covers_all_sources(stores: dict[str, Store]) -> None:
    parts = windows(stores)
    mix = Mix(parts)
    [name] = mix.normalized
    rows = [np.concatenate([clip.read(name) for clip in store if clip.split == "train"]) for store in stores.values()]
    low, high = np.concatenate(rows).min(axis=0), np.concatenate(rows).max(axis=0)
    scaler = mix.scaler(name)
    np.testing.assert_array_equal(scaler.data_min, low.astype(np.float64))
    np.testing.assert_array_equal(scaler.data_max, high.astype(np.float64))
    for k in (0, 35, 45):
        sample = mix[k]
        plain = stores[sample["source"]][sample["clip"]].read(name)[sample["start"] :][:40]
        np.testing.assert_array_equal(sample[name].numpy(), scaler.normalize(plain).astype(np.float32))
    alone = WindowDataset(stores["small"], scale=mix)
    torch.testing.assert_close(alone[0][name], mix[42][name], rtol=0, atol=0)
    assert alone.state_dict() == mix.state_dict()
    mix.load_state_dict(alone.state_dict())
    with raises_message(UsageError, "scalers"):
        mix.load_state_dict(parts["small"].state_dict())
    with raises_message(UsageError, "scalers"):
        mix.load_state_dict(None)  # type: ignore[arg-type]
    torch.testing.assert_close(parts["small"][0][name], WindowDataset(stores["small"])[0][name], rtol=0, atol=0)


def test_without_an_epoch_shares_are_exact_too(stores: dict[str, Store]) -> None:
    torch.manual_seed(0)
    mix = Mix(windows(stores), weights=(1, 1, 2))
    runs = [[key for batch in DataLoader(mix, 8, shuffle=True) for key in batch["id"]] for _ in range(2)]
    for run in runs:
        assert Counter(key.split("=")[0] for key in run) == {"large": 12, "middle": 12, "small": 24}
    assert set(runs[0]) != set(runs[1])


def test_groups_and_clips_mix(tmp_path: Path, stores: dict[str, Store]) -> None:
    for name, sizes in {"a": (2, 3), "b": (3,)}.items():
        (tmp_path / name).mkdir()
        write_store(tmp_path / name, HEADER, stored({"train": sizes}), shard_bytes=300_000)
    groups = Mix(
        {name: GroupDataset(tmp_path / name, dancers=Dancers(persons=3)) for name in "ab"},
        weights=(1, 1),
        n_samples=6,
    )
    [batch] = BatchLoader(groups, 6)
    assert batch["edge151"].shape == (6, 3, 20, 151)
    assert batch["source"] == ["a"] * 3 + ["b"] * 3
    with raises_message(UsageError, "int64"):
        Mix(
            {name: GroupDataset(tmp_path / name) for name in "ab"}
            | {"c": GroupDataset(tmp_path / "a", dancers=Dancers(persons=2))}
        )
    clips = Mix({name: ClipDataset(store) for name, store in stores.items()})
    batches = [*DataLoader(clips, 4, collate_fn=pad_clips, sampler=EpochSampler(clips))]
    assert sum(len(batch["id"]) for batch in batches) == 16
    with raises_message(UsageError, "BatchLoader"):
        BatchLoader(clips, 4).__iter__()


def test_genres_are_numbered_over_all_sources(stores: dict[str, Store]) -> None:
    parts = windows(stores)
    genres = sorted({genre for dataset in parts.values() for genre in dataset.genre_ids})
    for own in ({name: 9 - k for k, name in enumerate(genres)}, {"other": 0}):
        parts["small"].__dict__["genre_ids"] = own
        mix = Mix(parts)
        assert mix.genre_ids == {genre: k for k, genre in enumerate(sorted({*genres, *own}))}
        samples = [*mix.samples([0, 35, 45]), mix[45]]
        [batch] = BatchLoader(mix, 3, sampler=[0, 35, 45])
        assert [s["genre_id"] for s in samples[:3]] == batch["genre_id"].tolist()
        assert all(s["genre_id"] == mix.genre_ids[s["genre"]] for s in samples)
    parts["small"].__dict__["genre_ids"] = {"other": 40}
    assert Mix(parts).genre_ids == parts["large"].genre_ids | {"other": 40}


def test_datasets_that_do_not_agree(tmp_path: Path, stores: dict[str, Store]) -> None:
    large = WindowDataset(stores["large"])
    [name] = large.normalized
    fields = random_fields({name: large.store.field(name).columns.width - 1}, {}, fast=60)[:1]
    options = {"n_frames": (60, 60), "length": 20, "stride": 10, "fields": fields}
    write_random_store(tmp_path / "x", clips={"train": 2}, **options)
    with raises_message(UsageError, "same arguments"):
        Mix({"large": large, "other": WindowDataset(tmp_path / "x")})
    with raises_message(UsageError, "agree"):
        Mix({"large": large, "clips": ClipDataset(stores["large"])})
    for readers in ({}, [large]):
        with raises_message(UsageError, "made of readers"):
            Mix(readers)  # type: ignore[arg-type]
    with raises_message(UsageError, "names"):
        Mix({3: large})  # type: ignore[dict-item]


@pytest.mark.parametrize(
    "options",
    [
        {"weights": (1, 2)}, {"weights": (1, 0, 1)}, {"weights": (1, float("nan"), 1)},
        {"weights": {"large": 1, "tiny": 1, "small": 1}}, {"weights": (1, 1, 1000), "n_samples": 10},
        {"seed": -1}, {"n_samples": 10**30}, {"weights": (10**400, 1, 1)},
    ],
)  # fmt: skip
def test_invalid_arguments(stores: dict[str, Store], options: dict[str, Any]) -> None:
    with raises_message(UsageError, "n_samples|negative|shares|sources"):
        Mix(windows(stores), **options)


def test_an_id_is_read_from_its_source_alone(stores: dict[str, Store]) -> None:
    """A clip of another source may have the same name."""
    parts = windows(stores)
    mix = Mix(parts)
    sample = mix[0]
    assert sample["id"].startswith("large=")
    for dataset in (mix, mix.datasets[0]):
        torch.testing.assert_close(dataset[sample["id"]][mix.fields[0]], sample[mix.fields[0]], rtol=0, atol=0)
    for other in (parts["large"], mix.datasets[1]):
        with raises_message(UsageError, "another source", where=sample["id"]):
            other[sample["id"]]


def test_a_mix_as_scaler_and_as_what_columns_are_like(stores: dict[str, Store]) -> None:
    from dancedata.scene.like import opened, scaling_of, store_of
    from dancedata.torch import BalancedSampler

    mix = Mix(windows(stores))
    field = mix.normalized[0]
    columns = stores["large"].fields[field].labels
    for like in (stores["large"], None):
        scaling = scaling_of(like, field, columns, scaler=mix)
        assert scaling.normalized
        assert scaling.scaler is not None
        assert scaling.scaler.sha256 == mix.scaler(field).sha256
    # Of several datasets it is like none; of one, it is like that one, with its own scaler.
    with raises_message(UsageError, "scaler=mix"):
        store_of(opened(mix))
    one = Mix({split: WindowDataset(stores["large"], split) for split in ("train", "val")})
    assert store_of(opened(one)).path == stores["large"].path
    own = scaling_of(one, field, columns).scaler
    assert own is not None
    assert own.sha256 == one.scaler(field).sha256
    with raises_message(UsageError, "does not read"):
        scaling_of(stores["large"], "other", columns, scaler=mix)
    with raises_message(UsageError, "not a scaler"):
        scaling_of(stores["large"], field, columns, scaler=stores["large"])  # type: ignore[arg-type]
    with raises_message(UsageError, "weights"):
        BalancedSampler(one, by="clip")
    with raises_message(UsageError, "lengths"):
        BucketSampler(one, batch_size=2)
