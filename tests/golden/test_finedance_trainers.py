"""One FineDance store, three trainers: reader presets alone give what each original's loader gives."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

import dancedata
from dancedata.building.build import build
from dancedata.core.clip import Window
from dancedata.recipes.parse import load_recipe
from dancedata.store import Store, verify_store
from dancedata.torch import PRESETS, Primitives, Scale, WindowDataset
from tests.features import LIBROSA35, assert_within

# Gates of the reference outputs' README.
MOTION = 1e-5


@pytest.fixture(scope="module")
def store(peers: Any, tmp_path_factory: pytest.TempPathFactory) -> Store:
    folder = tmp_path_factory.mktemp("finedance")
    build(load_recipe("finedance"), peers / "inputs" / "finedance", folder / "out", cache=folder / "cache")
    return dancedata.open(folder / "out")


@pytest.fixture(scope="module")
def lodge(peers: Any) -> Any:
    return peers.load("lodge_mofea319.npz")


def test_the_store_is_sound_and_lists_its_rejects(store: Store) -> None:
    assert [p for p in verify_store(store.path) if p.severity == "error"] == []
    assert {c.id: (c.split, c.genre, c.trim_start) for c in store} == {
        "001": ("train", "Popping", 0),
        "004": ("train", "Urban", 240),
        "063": ("test", "Hiphop", 0),
    }
    assert {"cross_genre.train", "cross_dancer.test"} <= set(store["001"].record.lists)


@pytest.mark.parametrize(("preset", "length", "parts"), [("lodge-local", 256, 8), ("lodge-global", 1024, 10)])
@pytest.mark.parametrize("split", ["train", "test"])
def test_lodge_sees_its_own_windows(store, peers, lodge, split, preset, length, parts):
    windows = peers.load("lodge_dataset_index.npz")
    index, tracks, genres = (windows[f"L{length}_w{parts}_{split}.{k}"] for k in ("index", "tracks", "genre"))
    dataset = WindowDataset(store, split, **PRESETS[preset] | {"scale": None})
    # Lodge joins the tracks, each cut to the shorter of motion and music, and counts frames through.
    music = {c.id: len(store[c.id].read("librosa35")) - c.trim_start for c in store}
    before = np.cumsum([0, *(min(lodge.shape(t)[0], music[t]) for t in tracks)])
    found = []
    for k in range(len(dataset)):
        item = dataset[k]
        record = store[item["clip"]].record
        start = item["start"] - record.trim_start
        found.append(before[list(tracks).index(item["clip"])] + start)
        rows, expected = lodge.rows(item["clip"], start, start + length)
        assert len(rows) >= length // 15
        np.testing.assert_allclose(item["lodge139"].numpy()[rows], expected[:, :139], rtol=0, atol=MOTION)
        np.testing.assert_array_equal(item["lodge139"].numpy()[rows, :4], expected[:, :4])
        assert item["librosa35"].shape == (length, 35)
        assert item["genre_id"] == genres[k]
    assert found == list(index)


def test_lodges_scaler_by_name(store: Store, peers: Any, lodge: Any) -> None:
    dataset = WindowDataset(store, **PRESETS["lodge-local"] | {"scale": Scale(over="all")})
    known = peers.load("lodge_normalizer.npz")
    scaler = dataset.scaler("lodge139")
    np.testing.assert_allclose(scaler.data_min, known["data_min"], rtol=0, atol=MOTION)
    np.testing.assert_allclose(scaler.data_max, known["data_max"], rtol=0, atol=MOTION)
    rows = store["001"].read("lodge139")[:300]
    # A value's error is that of the columns, and what an error of the range makes of it.
    allowed = 1e-5 + 4e-5 / np.where(scaler.data_range > 1e-5, scaler.data_range, 1)
    found, wanted = known.pair("normalized_first300", scaler.normalize(rows, clamp=True))
    assert (np.abs(found - wanted) <= allowed).all()
    # By default the scaler knows train alone.
    assert not np.allclose(
        WindowDataset(store, **PRESETS["lodge-local"]).scaler("lodge139").data_max, scaler.data_max
    )


@pytest.mark.parametrize("split", ["train", "test"])
def test_finenet_sees_its_own_windows(store: Store, peers: Any, split: str) -> None:
    # FineDance's rule by hand, from the files: contacts, raw columns, windows of 120 every 12, the filter on train,
    # the root relative to a copy of the window.
    dataset = WindowDataset(store, split, **PRESETS["finenet"])
    contacts = {name.split(".")[0]: rows for name, rows in peers.load("finedance_contacts.npz").items()}
    expected = []
    for clip in ("001", "004") if split == "train" else ("063",):
        raw = np.load(peers / "inputs" / "finedance" / "motion" / f"{clip}.npy")
        rows = np.concatenate([contacts[clip], raw], axis=1).astype(np.float32)
        rows = rows[: min(len(rows), len(store[clip].read("librosa35")))]
        for start in range(0, len(rows) - 120 + 1, 12):
            window = rows[start : start + 120].copy()
            if split == "test" or window.std(axis=0).mean() > 0.07:
                window[:, 4:7] -= window[:1, 4:7].copy()
                expected.append((clip, start, window))
    assert [(w.clip, w.start) for w in dataset.windows] == [(clip, start) for clip, start, _ in expected]
    for item, (_, _, window) in zip((dataset[k] for k in range(len(dataset))), expected, strict=True):
        np.testing.assert_allclose(item["finedance319"].numpy(), window, rtol=0, atol=MOTION)
        np.testing.assert_array_equal(item["finedance319"][:, :4].numpy(), window[:, :4])


def test_overlapping_windows_do_not_spoil_each_other(store: Store) -> None:
    # FineDance's loader subtracts the root in a view of the corpus; here a window reads the same twice.
    dataset = WindowDataset(store, **PRESETS["finenet"])
    first = dataset[1]["finedance319"].clone()
    dataset[0], dataset[2]
    assert (dataset[1]["finedance319"] == first).all()
    np.testing.assert_array_equal(dataset[1]["finedance319"][0, 4:7].numpy(), np.zeros(3))


def test_the_music_is_lodges(store: Store, peers: Any) -> None:
    for clip, rows in peers.load("lodge_music35.npz").items():
        found = store.read(Window(clip, 0, store[clip].n_frames), "librosa35")
        assert_within(LIBROSA35, store.fields["librosa35"], found, rows[: len(found)])


def test_lodges_released_key_motion_through_the_reader(store: Store, peers: Any) -> None:
    dataset = WindowDataset(
        store, **PRESETS["lodge-global"] | {"fields": ("lodge139", Primitives(variant="code")), "scale": None}
    )
    known = peers.load("lodge_key_motion.npz")
    clip = known["clip_source"].tolist().index("001+0")
    window = next(k for k, w in enumerate(dataset.windows) if (w.clip, w.start) == ("001", 0))
    # The reference was run without its random shift, so an epoch without one is compared.
    dataset.set_epoch(next(epoch for epoch in range(100) if dataset._bias(window, epoch) == 0))
    item = dataset[window]
    assert item["primitives"].shape == (13, 8, 139)
    columns = known.index("L1024_fi256.key_motion", axis=2)
    found, wanted = item["primitives"].reshape(104, 139)[:, columns], known["L1024_fi256.key_motion"][clip]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=MOTION)
    # Another epoch shifts cues at beats by up to two frames, the same ones whenever it is asked.
    dataset.set_epoch(next(epoch for epoch in range(100) if dataset._bias(window, epoch) == 2))
    shifted, again = dataset[window], dataset[window]
    assert (shifted["primitives"] == again["primitives"]).all()
    moved = shifted["primitive_start"] - item["primitive_start"]
    assert set(moved.tolist()) == {0, 2}
