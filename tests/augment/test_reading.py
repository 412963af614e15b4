"""Augmentations of samples: the same bytes on any number of workers and ranks, and what a sample then holds."""

import hashlib
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import dancedata
from dancedata.augment.crop import Crop
from dancedata.augment.drop import Drop
from dancedata.augment.mirror import MirrorImage
from dancedata.augment.yaw import Yaw
from dancedata.core.clip import Window
from dancedata.core.errors import UsageError
from dancedata.core.sample_steps import RandomAugmentation, steps_of
from dancedata.testing.stores import write_random_store
from dancedata.torch import BatchLoader, EpochSampler, Relative, Scale, WindowDataset
from dancedata.torch.augmenting import Augmenter
from tests.messages import raises_message

FIELDS = ("edge151", "lodge139", "librosa35")
ALL = {"mirror": 0.5, "yaw": {}, "root_offset": {"p": 0.7}, "noise": {"p": 0.5}, "crop": {"p": 0.8}, "drop": {}}


def dataset(path: Path, augment: Any = (), **options: Any) -> WindowDataset:
    """Samples as of epoch 0, until a sampler sets another."""
    options = {"fields": FIELDS, "split": "train", **options}
    made = WindowDataset(path, augment=augment, seed=3, **options)
    made.set_epoch(0)
    return made


def digest(sample: dict[str, Any]) -> str:
    """Hash a sample, or a batch of one."""
    values = [value.numpy().tobytes() if hasattr(value, "numpy") else repr(value) for value in sample.values()]
    return hashlib.sha256(repr(values).encode()).hexdigest()


@pytest.mark.parametrize("workers", [0, 2, pytest.param(4, marks=pytest.mark.nightly)])
def test_samples_are_the_same_bytes_with_any_number_of_workers(store_path: Path, workers: int) -> None:
    data = dataset(store_path, ALL)
    sampler = EpochSampler(data, seed=1)
    wanted = {}
    for epoch in (0, 1):
        data.set_epoch(epoch)
        alone = dataset(store_path, ALL)
        alone.set_epoch(epoch)
        wanted[epoch] = [digest(next(iter(DataLoader([alone[int(k)]])))) for k in sampler.order(epoch)]
    assert set(wanted[0]).isdisjoint(wanted[1])
    loader = DataLoader(data, batch_size=1, sampler=sampler, num_workers=workers)
    for epoch in (0, 1):
        assert [digest(batch) for batch in loader] == wanted[epoch]


def test_batches_of_threads_and_shares_of_ranks_are_the_same(store_path: Path) -> None:
    data = dataset(store_path, ALL)
    data.set_epoch(2)
    wanted = {k: {name: np.asarray(value) for name, value in data[k].items()} for k in range(len(data))}
    for rank in (0, 1):
        sampler = EpochSampler(data, seed=1, rank=rank, world_size=2)
        sampler.load_state_dict({"epoch": 2, "position": 0})
        for batch in BatchLoader(pickle.loads(pickle.dumps(data)), 4, sampler=sampler, threads=2):
            for nth, index in enumerate(batch["index"].tolist()):
                for name in (*FIELDS, "start", "mirrored", "librosa35_dropped"):
                    np.testing.assert_array_equal(np.asarray(batch[name][nth]), wanted[index][name])


def test_an_augmenter_that_does_nothing_changes_no_byte(store_path: Path) -> None:
    plain = dataset(store_path)
    for augment in ([], {}, {"yaw": 0, "mirror": False}, [RandomAugmentation(Yaw(), 0.0)]):
        changed = dataset(store_path, augment)
        for k in (0, len(plain) - 1):
            assert digest(plain[k]) == digest(changed[k])


def test_mirror_among_augmentations_is_mirroring(store_path: Path) -> None:
    one, other = dataset(store_path, {"mirror": 1.0}), dataset(store_path, [{"yaw": 0}, MirrorImage()])
    for k in range(len(one)):
        assert digest(one[k]) == digest(other[k])
    with raises_message(UsageError, "twice"):
        dataset(store_path, [{"mirror": 0.5}, "mirror"])
    half = dataset(store_path, {"mirror": 0.5})
    flags = {half[k]["mirrored"] for k in range(len(half))}
    assert flags == {True, False}


def test_fields_of_a_sample_are_changed_alike(store_path: Path) -> None:
    """Translations are those of one dancer in every field: +Z up in edge151, +Y up in the others."""
    fields = ("edge151", "lodge139", "joints", "fact219", "lodge")
    augment = {"yaw": {}, "root_offset": {"max_m": 2}, "mirror": 0.5}
    data = dataset(store_path, augment, fields=fields, scale=None)
    plain = dataset(store_path, fields=fields, scale=None)
    for k in range(len(data)):
        sample = {name: data[k][name].numpy() for name in fields}
        edge, lodge, fact = sample["edge151"][:, 4:7], sample["lodge139"][:, 4:7], sample["fact219"][::2, :3]
        np.testing.assert_allclose(edge[:, [0, 2, 1]] * (1, 1, -1), fact, atol=2e-6)
        np.testing.assert_allclose(lodge[:, [0, 2]], fact[:, [0, 2]], atol=2e-6)
        # The pelvis stays where it is on its bones: 2.9 cm off the translation, turned or not.
        pelvis = sample["joints"][:, :3] - fact
        rest = np.array([-0.00217368, -0.24078918, 0.02858379]) * (-1 if data[k]["mirrored"] else 1, 1, 1)
        np.testing.assert_allclose(pelvis, np.broadcast_to(rest, pelvis.shape), atol=2e-6)
        np.testing.assert_array_equal(data[k]["lodge"], plain[k]["lodge"])  # key motions


def test_scaled_values_lie_within_the_range_and_other_splits_share_it(store_path: Path) -> None:
    augment = ["yaw", {"root_offset": {"max_m": 1}}, "mirror"]
    data, raw = (dataset(store_path, augment, scale=scale) for scale in (Scale(covers=augment), None))
    for name in ("edge151", "lodge139"):
        scaler = data.scaler(name)
        for k in range(len(data)):
            exact = scaler.normalize(raw[k][name].double(), clamp=False)
            assert float(exact.abs().max()) <= 1 + 1e-5
            np.testing.assert_array_equal(data[k][name], scaler.normalize(raw[k][name]))
    val = dataset(store_path, split="val", scale=Scale(covers=augment))
    np.testing.assert_array_equal(val.scaler("edge151").data_min, data.scaler("edge151").data_min)
    motion = dataset(store_path, split="val", fields="edge151", scale=Scale(covers=[*augment, "drop"]))
    np.testing.assert_array_equal(motion.scaler("edge151").data_max, data.scaler("edge151").data_max)
    narrow = dataset(store_path, augment)
    stored = dancedata.open(store_path).scaler("edge151")
    np.testing.assert_array_equal(narrow.scaler("edge151").data_min, stored.data_min)


def test_a_scaler_covers_noise_and_without_one_a_warning_says_how_far_it_goes(store_path, caplog):
    store, fields = dancedata.open(store_path), ("edge151", "lodge139")
    for scale, far in ((Scale(), 2), (Scale(clamp=True), 0), (Scale(covers=["noise"]), 0), (None, 0)):
        caplog.clear()
        dataset(store_path, ["noise"], fields=fields, scale=scale)
        assert sum("far beyond [-1, 1]" in message for message in caplog.messages) == far, scale
    wide = dataset(store_path, ["noise"], fields=fields, scale=Scale(covers=["noise"]))
    for name in fields:
        rows = torch.cat([wide[k][name] for k in range(len(wide))])
        turned = [k for k, label in enumerate(store.fields[name].labels) if "translation" not in label]
        assert float(rows[:, turned].abs().max()) <= 1 + 1e-4  # float32
        assert (wide.scaler(name).data_range >= store.scaler(name).data_range).all()
        np.testing.assert_array_equal(wide.scaler(name).data_min[4:13], store.scaler(name).data_min[4:13])


def test_crops_are_windows_of_their_clips(store_path: Path) -> None:
    store = dancedata.open(store_path)
    plain = dataset(store_path, scale=None)
    for crop in (Crop(), Crop("stride")):
        data = dataset(store_path, [crop], scale=None)
        starts = set()
        for epoch in range(3):
            data.set_epoch(epoch)
            for k in range(len(data)):
                sample, window = data[k], plain.windows[k]
                starts.add(sample["start"])
                near = range(window.start, window.start + 15) if crop.within == "stride" else range(151)
                assert sample["clip"] == window.clip
                assert sample["start"] in near
                for name in FIELDS:
                    rows = store.read(Window(window.clip, sample["start"], window.length), name)
                    np.testing.assert_array_equal(sample[name], rows)
        assert any(start % 15 for start in starts)


def test_dropped_fields_are_zero_and_say_so(store_path: Path) -> None:
    plain = dataset(store_path)
    data = dataset(store_path, {"drop": {"p": 0.5, "fields": ["librosa35", "edge151"], "together": False}})
    seen = set()
    for epoch in range(4):
        data.set_epoch(epoch)
        for k in range(len(data)):
            sample = data[k]
            flags = sample["librosa35_dropped"], sample["edge151_dropped"]
            seen.add(flags)
            for name, flag in zip(("librosa35", "edge151"), flags, strict=True):
                wanted = np.zeros_like(sample[name]) if flag else plain[k][name]
                np.testing.assert_array_equal(sample[name], wanted)
            np.testing.assert_array_equal(sample["lodge139"], plain[k]["lodge139"])
    assert seen == {(a, b) for a in (True, False) for b in (True, False)}
    music = dataset(store_path, {"drop": {"p": 1.0}})
    assert music[0]["librosa35_dropped"]
    assert "edge151_dropped" not in music[0]


def test_relative_roots_are_relative_after_augmenting(store_path: Path) -> None:
    data = dataset(store_path, ["root_offset"], scale=None, fields=Relative("edge151"))
    assert (data[0]["edge151"][0, 4:7] == 0).all()


@pytest.mark.parametrize(
    ("augment", "fields"),
    [
        (["yow"], FIELDS), ("yaw", FIELDS), ([3], FIELDS), ([{"yaw": {"max_degree": 3}}], FIELDS),
        ([{"yaw": {"p": 2}}], FIELDS), ([{"yaw": [1]}], FIELDS), (["tempo"], FIELDS), (["noise"], ("joints",)),
        (["noise"], ("edge151", "lodge")), (["drop"], ("edge151",)), ([Drop(fields=("jukebox",))], FIELDS),
    ],
)  # fmt: skip
def test_refused_combinations_say_why(store_path: Path, augment: Any, fields: Any) -> None:
    with raises_message(UsageError, "augment|augmentation|drop"):
        dataset(store_path, augment, fields=fields)


def test_columns_of_an_unknown_representation_are_refused(tmp_path: Path) -> None:
    write_random_store(tmp_path / "out")  # a field of the name edge151, with columns of another kind
    with raises_message(UsageError, "installation", where="out"):
        WindowDataset(tmp_path / "out", augment=["yaw"])
    mirrored = WindowDataset(tmp_path / "out", augment=["mirror"])
    assert mirrored[0]["mirrored"]


def test_two_of_one_augmentation_draw_different_numbers(store_path: Path) -> None:
    store = dancedata.open(store_path)
    two = Augmenter.of(store, ("edge151",), steps_of([Yaw(), Yaw()]), seed=0)
    assert len({step.stream for step in two.steps}) == 2
    named = Augmenter.of(store, ("edge151",), steps_of({"yaw.a": {"max_degrees": 1}, "yaw.b": {}}), seed=0)
    assert [step.name for step in named.steps] == ["yaw.a", "yaw.b"]
    assert replace(named, seed=1) != named
    with raises_message(UsageError, "chooses"):
        Augmenter.of(store, ("edge151",), steps_of(["crop"]), seed=0, allow_crop=False)
