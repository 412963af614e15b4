"""ClipDataset: whole clips and crops, padded and packed; balanced and bucketed orders; streams of batches by step."""

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from dancedata.core.errors import UsageError
from dancedata.store.dataset import Store, open_store
from dancedata.testing.stores import RandomStore, random_fields, write_random_store
from dancedata.torch import (
    BalancedSampler,
    BatchStream,
    BucketSampler,
    ClipDataset,
    EpochSampler,
    Primitives,
    Relative,
    WindowDataset,
    Windows,
    pad_clips,
)
from tests.groups_store import write_groups
from tests.messages import raises_message
from tests.readers.batches import bits

MOTION, AUDIO = "edge151", "librosa35"
PAIR = (MOTION, AUDIO)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RandomStore:
    """Clips of 40 to 140 frames; librosa35 as many rows, "fast" two rows per frame."""
    fields = random_fields({MOTION: 151}, {AUDIO: 35, "fast": 4}, fast=60)
    folder = tmp_path_factory.mktemp("clips") / "store"
    return write_random_store(folder, clips={"train": 9, "val": 2}, fields=fields, clips_per_song=3)


@pytest.fixture(scope="module")
def store(made: RandomStore) -> Store:
    return open_store(made.path)


def test_a_sample_is_a_whole_clip(made: RandomStore, store: Store) -> None:
    clips = ClipDataset(store, fields=(MOTION, AUDIO, "fast"), scale=None)
    assert len(clips) == 9
    for k, sample in enumerate(clips):
        clip = made.clip(sample["clip"])
        assert (sample["start"], sample["length"], sample["index"]) == (0, clip.n_frames, k)
        assert clips.lengths[k] == clip.n_frames
        assert (sample["genre"], sample["music"]) == (clip.genre, clip.music)
        for field in clips.fields:
            np.testing.assert_array_equal(sample[field], made.rows(clip.id, field, 0, clip.n_frames))
    assert bits(clips[-1]) == bits(clips[8])
    with pytest.raises(IndexError, match="sample 9"):
        clips[9]


def test_crops_are_windows(made: RandomStore, store: Store) -> None:
    """Equal bit for bit to the window at the same place, mirrored and normalised."""
    for mirror in (0.0, 1.0):
        crops = ClipDataset(store, fields=PAIR, windows=Windows(length=30), augment={"mirror": mirror}, crops=3)
        windows = WindowDataset(store, fields=PAIR, windows=Windows(length=30, stride=1), augment={"mirror": mirror})
        places = {(w.clip, w.start): k for k, w in enumerate(windows.windows)}
        starts = []
        for epoch in (0, 1):
            crops.set_epoch(epoch)
            for sample in crops:
                window = windows[places[sample["clip"], sample["start"]]]
                assert all(torch.equal(sample[name], window[name]) for name in PAIR)
                assert sample["mirrored"] == (mirror == 1.0)
            starts.append([sample["start"] for sample in crops])
        assert starts[0] != starts[1]
        assert len(set(starts[0][:3])) > 1
        # A random place may be the first one, and the last one.
        shortest = int(crops.windows.length.min())
        ends = ClipDataset(store, fields=PAIR, windows=Windows(length=shortest - 1))
        index = int(ends.windows.length.argmin())
        assert {ends.samples([index], epoch)[0]["start"] for epoch in range(20)} == {0, 1}
        assert Counter(sample["clip"] for sample in crops) == {
            clip.id: 3 for clip in made.clips if clip.split == "train"
        }


def test_clips_shorter_than_a_crop_are_rejects(store: Store) -> None:
    longest = int(ClipDataset(store, fields=PAIR).lengths.max())
    crops = ClipDataset(store, fields=PAIR, windows=Windows(length=longest))
    assert len(crops) + len(crops.rejects) == 9
    assert {reject.reason for reject in crops.rejects} == {"too_short"}
    with raises_message(UsageError, "filters", where="store"):
        ClipDataset(store, fields=PAIR, windows=Windows(length=longest + 1))


def test_crops_begin_at_whole_rows_of_slow_fields(tmp_path: Path) -> None:
    fields = random_fields({MOTION: 8}, {"slow": 3}, slow="7.5")
    made = write_random_store(tmp_path / "s", clips={"train": 4}, fields=fields, length=40, stride=20)
    whole = ClipDataset(made.path, fields=(MOTION, "slow"), scale=None)
    assert all(sample[MOTION].shape[0] == 4 * sample["slow"].shape[0] for sample in whole)
    crops = ClipDataset(made.path, fields=(MOTION, "slow"), windows=Windows(length=32), scale=None)
    for epoch in range(5):
        crops.set_epoch(epoch)
        for sample in crops:
            assert sample["start"] % 4 == 0
            np.testing.assert_array_equal(sample["slow"], made.rows(sample["clip"], "slow", sample["start"], 32))
    options: dict[str, Any] = {"fields": (MOTION, "slow"), "windows": Windows(length=32), "scale": None}
    moved = WindowDataset(made.path, augment=["crop"], **options)
    assert {int(sample["start"]) % 4 for sample in moved} == {0}
    with raises_message(UsageError, "fields"):
        ClipDataset(made.path, fields=(MOTION, "slow"), windows=Windows(length=30))


def test_padded(store: Store) -> None:
    clips = ClipDataset(store, fields=(MOTION, "fast"))
    samples = clips.samples(range(4))
    padded = partial(pad_clips, multiple=16, value=7.0)(samples)
    assert padded[MOTION].shape == (4, -(-int(clips.lengths[:4].max()) // 16) * 16, 151)
    for k, sample in enumerate(samples):
        for field in clips.fields:
            rows, mask = sample[field], padded["mask"][field][k]
            assert padded["lengths"][field][k] == len(rows) == mask.sum()
            assert torch.equal(padded[field][k][mask], rows)
            assert (padded[field][k][~mask] == 7.0).all()
    assert padded["clip"] == [sample["clip"] for sample in samples]
    assert pad_clips(samples, length=300)["fast"].shape[1] == 300
    with raises_message(UsageError, "length", where="clip train_c00, field edge151"):
        pad_clips(samples, length=20)
    with raises_message(UsageError, "batches"):
        pad_clips([])
    for multiple in (0, -3):
        with raises_message(UsageError, "pad_clips"):
            pad_clips(samples, multiple=multiple)


def test_wrong_arguments_are_named(store: Store, tmp_path: Path) -> None:
    crops: list[dict[str, Any]] = [{"crops": 2}, {"crops": 0, "windows": Windows(length=30)}]
    crops += [{"windows": store.windows("train")}, {"windows": Windows(fps=60)}]
    items = [{"fields": ("edge151", Primitives())}, {"fields": (Relative("edge151"),)}]
    for wrong in (*crops, *items, {"split": "tain"}):
        with raises_message(UsageError, "crops|length|Windows|frames per second|ClipDataset|tain"):
            ClipDataset(store, **{"fields": PAIR, **wrong})


def test_balanced_by_genre(made: RandomStore) -> None:
    train = WindowDataset(made.path, fields=PAIR)
    sampler = BalancedSampler(train, by="genre", seed=3)
    assert sampler.groups == ("break", "house")
    genres = [sample["genre"] for sample in train]
    epochs = [sampler.order(epoch) for epoch in range(4)]
    assert not np.array_equal(epochs[0], epochs[1])
    for order in epochs:
        drawn = Counter(genres[k] for k in order.tolist())
        assert abs(drawn["break"] - drawn["house"]) == len(train) % 2
        for genre in sampler.groups:
            times = [order.tolist().count(k) for k, name in enumerate(genres) if name == genre]
            assert max(times) - min(times) <= 1, genre
    assert list(sampler) == epochs[0].tolist()
    assert (sampler.epoch, sampler.position) == (1, 0)


def test_balanced_by_own_labels_and_on_ranks(store: Store, tmp_path: Path) -> None:
    train = WindowDataset(store, fields=PAIR)
    labels = [k % 7 == 0 for k in range(len(train))]
    whole = BalancedSampler(train, by=labels, seed=1).order(2)
    assert abs(2 * sum(labels[k] for k in whole.tolist()) - len(whole)) <= 1
    ranks = [BalancedSampler(train, by=labels, seed=1, rank=r, world_size=2, drop_last=True).order(2) for r in (0, 1)]
    np.testing.assert_array_equal(np.stack(ranks, axis=1).ravel(), whole[: 2 * len(ranks[0])])
    with raises_message(UsageError, "label"):
        BalancedSampler(train, by=labels[1:])
    with raises_message(UsageError, "gerne"):
        BalancedSampler(train, by="gerne")
    write_groups(tmp_path / "groups", 60)
    with raises_message(UsageError, "without a genre", where="clip train0_p0"):
        BalancedSampler(WindowDataset(tmp_path / "groups", fields=("joints",)), by="genre")


def test_buckets_have_similar_lengths(store: Store) -> None:
    crops = ClipDataset(store, fields=PAIR)
    sampler = BucketSampler(crops, batch_size=2, n_buckets=4, seed=0)
    batches = list(sampler)
    assert sorted(k for batch in batches for k in batch) == list(range(9))
    assert len(batches) == len(sampler) == 5  # buckets of 3, 2, 2 and 2 clips
    order = np.sort(crops.lengths)
    for batch in batches:
        low, high = (
            np.searchsorted(order, crops.lengths[batch].min()),
            np.searchsorted(order, crops.lengths[batch].max()),
        )
        assert high - low <= 2
    assert batches != list(sampler)
    resumed = BucketSampler(crops, batch_size=2, n_buckets=4, seed=0)
    resumed.load_state_dict(sampler.at(0, 3))
    assert list(resumed) == batches[3:]


def test_buckets_by_frames(store: Store) -> None:
    clips = ClipDataset(store, fields=PAIR)
    limit = 2 * int(clips.lengths.max())
    for batch in BucketSampler(clips, max_frames=limit, n_buckets=3):
        assert len(batch) * clips.lengths[batch].max() <= limit
    with raises_message(UsageError, "max_frames"):
        BucketSampler(clips, max_frames=50)
    with raises_message(UsageError, "batch"):
        BucketSampler(clips)


@pytest.mark.parametrize(
    ("kind", "options"),
    [(BucketSampler, {"n_buckets": 2}), (BucketSampler, {"batch_size": 3}), (BucketSampler, {"drop_last": True}),
     (BalancedSampler, {"by": "music"})],
)  # fmt: skip
def test_a_position_in_other_groups_is_refused(store: Store, kind: Any, options: dict[str, Any]) -> None:
    clips = ClipDataset(store, fields=PAIR)
    usual = {"batch_size": 2, "n_buckets": 3} if kind is BucketSampler else {"by": "clip"}
    state = kind(clips, **usual).at(0, 1)
    kind(clips, **usual).load_state_dict(state)
    with raises_message(UsageError, "order"):
        kind(clips, **usual | options).load_state_dict(state)


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_streams_of_windows_and_of_buckets(made: RandomStore) -> None:
    windows = WindowDataset(made.path, fields=PAIR, augment={"mirror": 0.5}, seed=2)
    by_map = DataLoader(windows, 16, sampler=EpochSampler(windows, seed=2))
    stream = BatchStream(windows, 16, seed=2)
    assert stream.steps_per_epoch == len(by_map)
    for step, batch in enumerate([*by_map, *by_map]):
        assert bits(stream.batch(step)) == bits(batch)
    windows.set_epoch(17)  # has no effect on a stream
    later = BatchStream(windows, 16, seed=2, start_step=1, steps=5)
    for step, batch in enumerate(DataLoader(later, batch_size=None, num_workers=2), start=1):
        assert bits(batch) == bits(stream.batch(step))
    clips = ClipDataset(made.path, fields=PAIR)
    buckets = BucketSampler(clips, batch_size=4, seed=2)
    stream = BatchStream(clips, sampler=buckets, collate=pad_clips, steps=2 * len(buckets))
    by_map = DataLoader(clips, batch_sampler=buckets, collate_fn=pad_clips)
    wanted = [*by_map, *by_map]
    assert [*map(bits, DataLoader(stream, batch_size=None, num_workers=2))] == [*map(bits, wanted)]
    with raises_message(UsageError, "BucketSampler"):
        BatchStream(clips, 4, sampler=buckets)
    for wrong in (
        {"batch_size": 10, "drop_last": True},
        {"sampler": BucketSampler(clips, batch_size=99, drop_last=True)},
    ):
        with raises_message(UsageError, "batch_size"):
            BatchStream(clips, **wrong)


@pytest.mark.parametrize("n_samples", [96, 101])
def test_other_ranks_take_the_same_samples_in_each_step(n_samples: int) -> None:
    """Exactness after a change of the number of ranks, where batch size times ranks stays the same."""
    for sizes in ((1, 12), (2, 6), (3, 4), (4, 3)):
        ranks, size = sizes
        samplers = [EpochSampler(n_samples, seed=4, rank=rank, world_size=ranks) for rank in range(ranks)]
        for step in range(2 * samplers[0].steps(size)):
            epoch, position = divmod(step * size, samplers[0].steps(size) * size)
            taken = [set(sampler.order(epoch)[position : position + size].tolist()) for sampler in samplers]
            everyone = EpochSampler(n_samples, seed=4).order(epoch)
            wanted = set(everyone[12 * (step % -(-n_samples // 12)) :][:12].tolist())
            found = set().union(*taken)
            assert found >= wanted
            extra = found - wanted  # only in an epoch's last step, so that ranks have equally many
            assert len(extra) < ranks
            assert not extra or len(wanted) < 12


def test_any_number_of_ranks_resumes_after_the_consumed_samples() -> None:
    """Another product of batch size and ranks: fewer samples than ranks are repeated, none is left out."""
    consumed, n_samples = 40, 101
    everyone = EpochSampler(n_samples, seed=4).order(0).tolist()
    for ranks in (1, 2, 3, 5, 8):
        rest: list[int] = []
        for rank in range(ranks):
            sampler = EpochSampler(n_samples, seed=4, rank=rank, world_size=ranks)
            sampler.load_state_dict(sampler.at_total(0, consumed))
            rest += list(sampler)
        assert set(rest) >= set(everyone[consumed:])
        assert len(set(rest) & set(everyone[:consumed]) - set(everyone[: ranks - 1])) <= consumed % ranks
