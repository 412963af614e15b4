"""WindowDataset without workers: items, normalising, mirroring, errors."""

import copy
import math
import pickle
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import default_collate

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.store.dataset import Store, open_store
from dancedata.store.schema import Field
from dancedata.testing.stores import random_fields, write_random_store
from dancedata.torch import PRESETS, BatchLoader, ClipDataset, Scale, WindowDataset, Windows
from tests.messages import raises_message

MOTION, AUDIO = "edge151", "librosa35"


@pytest.fixture(scope="module")
def store(store_path: Path) -> Store:
    return open_store(store_path)


def test_item_is_the_window_and_its_metadata(store: Store) -> None:
    dataset = WindowDataset(str(store.path), scale=None)
    window = store.windows("train")[3]
    record = next(record for record in store if record.id == window.clip)
    item = dataset[3]
    for field, width in ((MOTION, 151), (AUDIO, 35)):
        assert item[field].dtype == torch.float32
        assert item[field].shape == (window.length, width)
        np.testing.assert_array_equal(item[field].numpy(), store.read(window, field))
    assert (item["clip"], item["start"], item["length"]) == (window.clip, window.start, window.length)
    assert (item["genre"], item["music"], item["dancer"]) == (record.genre, record.music, record.dancer)
    assert (item["split"], item["mirrored"], item["index"]) == ("train", False, 3)


def test_unknown_tempo_is_nan_so_that_collate_works(store: Store) -> None:
    dataset = WindowDataset(store)
    wanted = {record.id: record.tempo_bpm for record in store}
    for item in dataset.__getitems__(range(0, len(dataset), 100)):
        known = wanted[item["clip"]]
        assert math.isnan(item["tempo_bpm"]) if known is None else item["tempo_bpm"] == known
    batch = default_collate(dataset.__getitems__([0, 5]))
    assert batch["tempo_bpm"].shape == (2,)
    assert batch["mirrored"].dtype == torch.bool
    assert batch[MOTION].shape == (2, 150, 151)


def test_negative_and_foreign_indices(store: Store) -> None:
    dataset = WindowDataset(store)
    last = dataset[len(dataset) - 1]
    assert torch.equal(dataset[-1][MOTION], last[MOTION])
    assert dataset[-1]["index"] == len(dataset) - 1
    assert dataset[np.int64(2)]["index"] == dataset[torch.tensor(2)]["index"] == 2  # type: ignore[index]
    for outside in (len(dataset), -len(dataset) - 1):
        with pytest.raises(IndexError, match=str(len(dataset))):
            dataset[outside]
        with pytest.raises(IndexError):
            dataset.__getitems__([0, outside])


@pytest.mark.parametrize(
    "wrong",
    [
        {"split": "trian"}, {"fields": ("edge15",)}, {"fields": ()}, {"fields": (AUDIO, AUDIO)},
        {"fields": (AUDIO,), "scale": Scale(fields=(MOTION,))}, {"augment": {"mirror": 1.5}},
        {"augment": {"mirror": -0.1}}, {"augment": {"mirror": math.nan}}, {"augment": {"mirror": "yes"}},
        {"seed": -1}, PRESETS["lodge-global"], PRESETS["finenet"],
        {"fields": ("lodge139",)}, {"fields": ("lodge319",)}, {"fields": ("joints",)},
    ],
)  # fmt: skip
def test_wrong_arguments_say_what_is_allowed(store: Store, wrong: dict[str, object]) -> None:
    with raises_message(DanceDataError, "field|negative|protocol|probability|trian"):
        WindowDataset(store, **wrong)  # type: ignore[arg-type]


def test_fields_that_are_read_and_normalised(store: Store, tmp_path: Path) -> None:
    only = WindowDataset(store, fields=AUDIO)
    assert only.fields == (AUDIO,)
    assert MOTION not in only[0]
    with raises_message(UsageError, "librosa35"):
        only.scaler(MOTION)
    raw, usual, audio = (WindowDataset(store, "val", scale=s)[7] for s in (None, Scale(), Scale(fields=(AUDIO,))))
    for found, normal, plain in ((usual, MOTION, AUDIO), (audio, AUDIO, MOTION)):
        assert torch.equal(raw[plain], found[plain])
        np.testing.assert_allclose(found[normal], store.scaler(normal).normalize(raw[normal].numpy()), atol=1e-6)
    fields = random_fields({MOTION: 151}, {}, **{MOTION: 60})
    write_random_store(tmp_path, fields=fields, fps=Fraction(60))
    with raises_message(UsageError, "30 frames per second"):
        WindowDataset(tmp_path, **PRESETS["edge"] | {"fields": (MOTION,)})


def test_preset_edge(store: Store) -> None:
    dataset = WindowDataset(store, **PRESETS["edge"])
    assert dataset.fields == (MOTION, AUDIO)
    assert list(dataset.windows) == list(store.windows("train", length_s=5, stride_s=0.5))
    assert float(dataset[0][MOTION].abs().max()) <= 1.0
    shorter = WindowDataset(store, **PRESETS["edge"] | {"fields": (MOTION,), "windows": Windows(length=60)})
    assert shorter[0][MOTION].shape == (60, 151)


def test_genres_that_the_dataset_does_not_number_are_numbered_by_name(store: Store) -> None:
    genres = sorted({clip.genre for clip in store})
    assert genres == ["break", "house"]
    for split in ("train", "val"):  # val has one clip of each, and the numbers of train
        dataset = WindowDataset(store, split)
        assert dict(dataset.genre_ids) == {"break": 0, "house": 1}
        for sample in dataset.__getitems__(range(0, len(dataset), 40)):
            assert sample["genre_id"] == genres.index(store[sample["clip"]].genre)


@pytest.mark.parametrize("names", [("lodge139", "librosa35"), ("edge151", "half"), ("lodge139",)])
def test_without_the_usual_fields_all_are_read(tmp_path: Path, names: tuple[str, ...]) -> None:
    audio = {name: 20 for name in names[1:]}
    write_random_store(tmp_path, fields=random_fields({names[0]: 139}, audio))
    windows, clips = WindowDataset(tmp_path), ClipDataset(tmp_path)
    assert windows.fields == clips.fields == names
    (batch,) = BatchLoader(windows, 2, sampler=[0, 1])
    for name in names:
        np.testing.assert_array_equal(batch[name][1], windows[1][name])
        assert clips[0][name].shape[1] == windows.store.fields[name].width


def test_mirrored_before_normalised_in_a_range_that_covers_both(store: Store) -> None:
    mirror = store.field(MOTION).columns.mirror
    assert mirror is not None
    raw = WindowDataset(store, scale=None)
    dataset = WindowDataset(store, scale=Scale(covers=["mirror"]), augment={"mirror": 1.0})
    scaler = dataset.scaler(MOTION)
    for place in range(0, len(raw), 97):
        plain = raw[place][MOTION].numpy()
        for rows in (plain, mirror.apply(plain)):
            assert np.abs(scaler.normalize(rows, clamp=False)).max() <= 1 + 1e-5
        np.testing.assert_allclose(dataset[place][MOTION].numpy(), scaler.normalize(mirror.apply(plain)), atol=1e-6)


def test_edges_clip_is_selected_by_name(store: Store) -> None:
    raw, edges = WindowDataset(store, scale=None), store.scaler(MOTION)
    mirror = store.field(MOTION).columns.mirror
    assert mirror is not None
    expected = edges.normalize(mirror.apply(raw[7][MOTION].numpy()))
    assert np.abs(expected).max() > 1.1
    whole, cut = (
        WindowDataset(store, augment={"mirror": 1.0}),
        WindowDataset(store, scale=Scale(clamp=True), augment={"mirror": 1.0}),
    )
    np.testing.assert_allclose(whole[7][MOTION].numpy(), expected, atol=1e-6)
    np.testing.assert_allclose(cut[7][MOTION].numpy(), expected.clip(-1, 1), atol=1e-6)
    assert WindowDataset(store, **PRESETS["edge"], augment={"mirror": 0.5}).clamp  # as EDGE does, mirrored or not


def mirrored(dataset: WindowDataset) -> list[bool]:
    return [item["mirrored"] for item in dataset.__getitems__(range(len(dataset)))]


def test_motion_without_a_mirror_is_named(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    real = store.field

    def field(name: str) -> Field:
        known = real(name)
        return replace(known, columns=replace(known.columns, mirror=None))

    monkeypatch.setattr(store, "field", field)
    with raises_message(UsageError, "mirror", where="store"):
        WindowDataset(store, augment={"mirror": 0.5})
    with raises_message(UsageError, "mirror", where="store"):
        WindowDataset(store, scale=Scale(covers=["mirror"]))
    assert WindowDataset(store, fields=(AUDIO,), augment={"mirror": 0.5})[0][AUDIO].shape == (150, 35)
    assert len(WindowDataset(store)) > 0


@pytest.mark.parametrize("how", ["pickle", "deepcopy"])
def test_copies_read_the_same_and_have_their_own_epoch(store: Store, how: str) -> None:
    dataset = WindowDataset(store, windows=Windows(stride=150), augment={"mirror": 0.5}, seed=4)
    dataset.set_epoch(3)
    dataset[0]
    twin = pickle.loads(pickle.dumps(dataset)) if how == "pickle" else copy.deepcopy(dataset)
    assert twin.epoch == 3
    assert mirrored(twin) == mirrored(dataset)
    assert torch.equal(twin[5][MOTION], dataset[5][MOTION])
    twin.set_epoch(4)
    assert dataset.epoch == 3
    assert twin._epoch.is_shared()
