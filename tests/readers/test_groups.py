"""Groups of dancers: samples of all dancers of a window, in one world."""

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from dancedata.core.errors import StoreError, UsageError
from dancedata.store import Store, verify_store, write_store
from dancedata.store.stored_clip import StoredClip
from dancedata.torch import BatchLoader, Dancers, GroupDataset
from dancedata.torch.kinematics import decode
from dancedata.torch.options import Choose
from tests.groups_store import HEADER, LENGTH, SIZES, stored
from tests.messages import raises_message


@pytest.fixture(scope="module")
def store(groups_store: Store) -> Store:
    return groups_store


def distances(joints: torch.Tensor, mask: torch.Tensor) -> list[float]:
    """Distances of all pairs of roots in all frames, sorted."""
    roots = joints[mask][:, :, :3].double()
    pairs = itertools.combinations(range(len(roots)), 2)
    return sorted(x for a, b in pairs for x in (roots[a] - roots[b]).norm(dim=-1).tolist())


def raw(store: Store, **options: Any) -> GroupDataset:
    return GroupDataset(store, fields=("joints", "tune"), scale=None, **options)


def test_a_sample_holds_the_rows_of_all_dancers(store: Store) -> None:
    dataset = raw(store)
    assert dataset.persons == 5
    assert verify_store(store.path) == []
    assert len(dataset) == sum(len(store[f"train{k}_p0"].windows()) for k in range(4))
    for index in range(len(dataset)):
        sample = dataset[index]
        n = int(sample["person_mask"].sum())
        assert sample["members"].tolist() == [*range(n), *[-1] * (5 - n)]
        assert sample["roles"][:n] == [f"dancer {k}" for k in range(n)]
        assert sample["clips"] == [f"{sample['group']}_p{k}" for k in range(n)] + [""] * (5 - n)
        for person in range(n):
            rows = store[sample["clips"][person]].read("joints")[sample["start"] :][:LENGTH]
            np.testing.assert_array_equal(sample["joints"][person], rows)
        assert not sample["joints"][n:].any()
        music = store[sample["clips"][0]].read("tune")[sample["start"] :][:LENGTH]
        np.testing.assert_array_equal(sample["tune"], music)
        assert sample["id"] == f"{sample['group']}@{sample['start']}+{LENGTH}"
        assert not {"clip", "dancer"} & sample.keys()


@pytest.mark.parametrize(
    ("dancers", "n"), [(Dancers(persons=2), 2), (Dancers(persons=7), 7), (Dancers(exactly=3), 3)]
)
def test_more_and_fewer_dancers_than_places(store: Store, dancers: Dancers, n: int) -> None:
    dataset = raw(store, dancers=dancers)
    samples = [dataset[k] for k in range(len(dataset))]
    assert {tuple(s["joints"].shape) for s in samples} == {(n, LENGTH, 72)}
    sizes = {s["group"]: int(s["person_mask"].sum()) for s in samples}
    if dancers.exactly:
        assert sizes == {"train1": 3, "train3": 3}
        assert {r.reason for r in dataset.rejects} == {"single", "group_size"}
    else:
        assert sizes == {f"train{k}": min(n, size) for k, size in enumerate(SIZES["train"])}


def test_absent_dancers_are_the_middle_of_the_scaler(store: Store) -> None:
    dataset = GroupDataset(store, fields=("edge151",))
    sample = dataset[0]
    assert not sample["edge151"][~sample["person_mask"]].any()
    scaled = dataset.scaler("edge151").normalize(store["train0_p1"].read("edge151")[:LENGTH])
    np.testing.assert_array_equal(sample["edge151"][1], scaled)


@pytest.mark.parametrize(
    "options",
    [
        {"augment": {"mirror": 1.0}}, {"augment": ["yaw"]}, {"augment": [{"root_offset": {"max_m": 2}}]},
        {"augment": ["yaw", "root_offset", "mirror"]},
        {"augment": ["yaw"], "dancers": Dancers(choose="left_to_right")},
        {"augment": ["yaw"], "dancers": Dancers(choose="seed")},
    ],
    ids=str,
)  # fmt: skip
def test_the_world_changes_as_one(store: Store, options: dict[str, Any]) -> None:
    plain, changed = raw(store), raw(store, **options)
    changed.set_epoch(3)
    moved = 0
    for index in range(0, len(plain), 3):
        one, two = plain[index], changed[index]
        before, after = (distances(s["joints"], s["person_mask"]) for s in (one, two))
        np.testing.assert_allclose(after, before, atol=1e-6)
        moved += not torch.equal(one["joints"], two["joints"])
    assert moved


def test_noise_is_drawn_for_each_body(store: Store) -> None:
    dataset = GroupDataset(store, fields=("edge151",), scale=None, augment=[{"noise": {"std_degrees": 2}}])
    dataset.set_epoch(0)
    plain = GroupDataset(store, fields=("edge151",), scale=None)
    made, clean = (decode(d[0]["edge151"][:2], "edge151").matrices for d in (dataset, plain))
    noise = clean.mT @ made
    assert not torch.allclose(noise[0], noise[1], atol=1e-3)


def test_an_augmentation_says_what_it_acts_on(store: Store) -> None:
    from dancedata.augment.yaw import Yaw

    class Old(Yaw):
        acts_on = None  # type: ignore[assignment]

    with raises_message(UsageError, "acts_on"):
        GroupDataset(store, fields=("edge151",), augment=[Old()])


def test_left_to_right_is_by_x_as_given_out(store: Store) -> None:
    dataset = raw(store, dancers=Dancers(persons=3, choose="left_to_right"), augment={"mirror": 0.5})
    dataset.set_epoch(1)
    mirrored = 0
    for index in range(len(dataset)):
        sample = dataset[index]
        n = int(sample["person_mask"].sum())
        across = sample["joints"][:n, 0, 0].tolist()
        assert across == sorted(across)
        mirrored += sample["mirrored"]
        if sample["group"] == "train2":
            roles = [f"dancer {k}" for k in ((4, 3, 2) if sample["mirrored"] else (0, 1, 2))]
            assert sample["roles"] == roles
    assert 0 < mirrored < len(dataset)


def test_dancers_are_drawn_by_seed_epoch_and_index(store: Store) -> None:
    drawn = {}
    for epoch in range(30):
        dataset = raw(store, dancers=Dancers(persons=3, choose="seed"), seed=5)
        dataset.set_epoch(epoch)
        again = raw(store, dancers=Dancers(persons=3, choose="seed"), seed=5)
        again.set_epoch(epoch)
        index = next(k for k in range(len(dataset)) if dataset[k]["group"] == "train2")
        members = dataset[index]["members"].tolist()
        assert again[index]["members"].tolist() == members
        assert len(set(members)) == 3
        drawn[tuple(members)] = epoch
        whole = next(k for k in range(len(dataset)) if dataset[k]["group"] == "train1")
        assert sorted(dataset[whole]["members"].tolist()) == [0, 1, 2]
    assert len(drawn) > 20
    assert {m for members in drawn for m in members} == set(range(5))


@pytest.mark.parametrize("choose", ["stored", "seed", "left_to_right"])
def test_loaders_give_the_samples(store: Store, choose: Choose) -> None:
    dancers, augment = Dancers(persons=3, choose=choose), [{"mirror": 0.5}, "yaw"]
    dataset = GroupDataset(store, fields=("edge151", "tune"), dancers=dancers, augment=augment, seed=2)
    dataset.set_epoch(4)
    wanted = [dataset[k] for k in range(len(dataset))]
    loaders: list[Any] = [
        BatchLoader(dataset, 4),
        DataLoader(dataset, 4, collate_fn=dataset.collate),
        DataLoader(dataset, 4, collate_fn=dataset.collate, num_workers=1),
    ]
    for loader in loaders:
        seen = 0
        for batch in loader:
            assert batch["edge151"].shape[1:] == (3, LENGTH, 151)
            for nth, index in enumerate(batch["index"].tolist()):
                for name in ("edge151", "tune", "person_mask", "members"):
                    assert torch.equal(batch[name][nth], wanted[index][name]), name
                assert batch["clips"][nth] == wanted[index]["clips"]
                seen += 1
        assert seen == len(dataset)


BAD: dict[str, Callable[[StoredClip], dict[str, Any]]] = {
    "frames": lambda c: {"n_frames": c.n_frames - 1, "motion": {n: r[:-1] for n, r in c.motion.items()}},
    "music": lambda c: {"music": "another"},
    "windows": lambda c: {"starts": c.starts[1:]},
    "number": lambda c: {"member": 0},
    "no number": lambda c: {"member": -1},
    "split": lambda c: {"split": "test"},
    "offset": lambda c: {"audio": {"tune": dataclasses.replace(c.audio["tune"], offset=1)}},
    "trim": lambda c: {"trim_start": 3},
}


@pytest.mark.parametrize("change", BAD.values(), ids=BAD)
def test_dancers_of_a_group_share_their_time(tmp_path: Path, change: Callable[[StoredClip], dict[str, Any]]) -> None:
    clips = stored({"train": (3,)})
    clips[1] = dataclasses.replace(clips[1], **change(clips[1]))
    with raises_message(StoreError, "dancers|ends|splits"):
        write_store(tmp_path, HEADER, clips)


def test_no_groups_and_unknown_choices(tmp_path: Path, store: Store) -> None:
    write_store(tmp_path, HEADER, stored({"train": ()}))
    with raises_message(UsageError, "singles"):
        GroupDataset(tmp_path, fields=("joints",), scale=None)
    assert len(GroupDataset(tmp_path, fields=("joints",), dancers=Dancers(singles=True), scale=None)) == 2
    with raises_message(UsageError, "singles"):
        raw(store, dancers=Dancers(exactly=4))
