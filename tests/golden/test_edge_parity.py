"""End to end against EDGE's own output on the reference corpus."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import dancedata
from dancedata.building.build import build
from dancedata.recipes.parse import load_recipe
from dancedata.store import Store, verify_store
from tests.features import LIBROSA35, assert_within

# Gates of the reference outputs' README, which gives what its makers' reruns and independent versions reached.
POSE = 1e-5  # float32 of metres and of rotation entries
SPLITS = ("train", "test")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def _build(peers: Any, cache: Path, out: Path, recipe: str) -> Store:
    build(load_recipe(recipe), peers / "inputs" / "edge_aistpp", out, jobs=1, cache=cache)
    return dancedata.open(out)


@pytest.fixture(scope="module")
def exact(peers: Any, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Store:
    return _build(peers, cache, tmp_path_factory.mktemp("exact"), "aist++-edge-exact")


@pytest.fixture(scope="module")
def track(peers: Any, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Store:
    return _build(peers, cache, tmp_path_factory.mktemp("track"), "aist++")


def _read(store: Store, split: str, field: str) -> npt.NDArray[Any]:
    return np.stack([store.read(w, field) for w in store.windows(split)])


@pytest.mark.parametrize("split", SPLITS)
def test_slices_are_edges_in_edges_order(exact: Store, peers: Any, split: str) -> None:
    names = json.loads((peers / f"edge_windows_{split}.json").read_text())
    assert [w.clip for w in exact.windows(split)] == names


@pytest.mark.parametrize("split", SPLITS)
def test_151_columns(exact: Store, peers: Any, split: str) -> None:
    golden = peers.load(f"edge_{split}.npz")
    pose = _read(exact, split, "edge151")
    found, wanted = golden.pair("pose_raw", pose)
    assert np.abs(found - wanted).max() <= POSE
    # No displacement of this corpus lies within 1e-5 m of the threshold on the other side: all labels are equal.
    np.testing.assert_array_equal(pose[..., :4], golden["contacts"])


@pytest.mark.parametrize("split", SPLITS)
def test_35_columns(exact: Store, peers: Any, split: str) -> None:
    golden = peers.load(f"edge_{split}.npz")
    found, wanted = golden.pair("baseline35", _read(exact, split, "librosa35"))
    assert_within(LIBROSA35, exact.fields["librosa35"], found, wanted)


def test_scaler(exact: Store, peers: Any) -> None:
    golden = peers.load("edge_normalizer.npz")
    scaler = exact.scaler("edge151")
    assert np.abs(scaler.data_min - golden["data_min"]).max() <= POSE
    assert np.abs(scaler.data_max - golden["data_max"]).max() <= POSE
    constant = golden["data_range"] < 10 * np.finfo(np.float32).eps
    assert constant[139:].all()  # hands, always at identity
    np.testing.assert_array_equal(scaler.data_range < 10 * np.finfo(np.float32).eps, constant)
    assert exact.stats["fields"]["edge151"]["n"] == golden["n_samples_seen"]


@pytest.mark.parametrize(("split", "name"), [("train", "pose_normalized_first16"), ("test", "pose_normalized")])
def test_normalised_columns(exact: Store, peers: Any, split: str, name: str) -> None:
    golden = peers.load(f"edge_{split}.npz")
    normalised = exact.scaler("edge151").normalize(_read(exact, split, "edge151"), clamp=True)
    found, wanted = golden.pair(name, normalised[: golden.shape(name)[0]])
    width = peers.load("edge_normalizer.npz")["data_range"].astype(np.float64)
    # An error of 1e-5 in the columns and in either end of the range is stretched by 2 / range.
    gate = 1e-5 + 4e-5 / np.where(width < 1e-6, 1, width)
    assert (np.abs(found - wanted).max(axis=(0, 1)) <= gate).all()


def test_stores_are_whole(exact: Store, track: Store) -> None:
    for store in (exact, track):
        assert [p for p in verify_store(store.path) if p.severity == "error"] == []


def _pairs(track: Store, exact: Store, field: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the windows that are slices too, (W, 150, D) each."""
    there = {(w.clip, w.start): w for split in SPLITS for w in track.windows(split)}
    slices = [exact[w.clip] for split in SPLITS for w in exact.windows(split)]
    pairs = [(track.read(there[c.slice_of, c.slice_start], field), c.read(field)) for c in slices]
    return np.stack([a for a, _ in pairs]), np.stack([b for _, b in pairs])


def test_whole_clips_differ_in_motion_only_where_documented(track: Store, exact: Store) -> None:
    a, b = _pairs(track, exact, "edge151")
    np.testing.assert_array_equal(a[..., 4:], b[..., 4:])
    np.testing.assert_array_equal(a[:, :-1, :4], b[:, :-1, :4])
    assert (b[:, -1, :4] == 1).all()
    assert 0 < (a[:, -1, :4] != b[:, -1, :4]).sum() < b[:, -1, :4].size


def test_whole_clips_have_one_window_more_where_n_mod_30_is_29(track: Store, exact: Store) -> None:
    mine = {(w.clip, w.start) for split in SPLITS for w in track.windows(split)}
    edges = {(clip.slice_of, clip.slice_start) for clip in exact.clips() if clip.split in SPLITS}
    # Of the six sequences only this one has 509 = 29 (mod 30) frames.
    assert mine - edges == {("gJS_sBM_cAll_d26_mJS3_ch01", 105)}
    assert edges <= mine


def test_whole_clips_differ_in_features_only_at_window_edges(track: Store, exact: Store, peers: Any) -> None:
    a, b = _pairs(track, exact, "librosa35")
    # Of the compact set's music some is silence. Windows come split by split, in EDGE's order.
    counts = [peers.load(f"edge_{split}.npz").shape("baseline35")[0] for split in SPLITS]
    heard = [peers.load(f"edge_{split}.npz").index("baseline35") for split in SPLITS]
    places = np.concatenate([heard[0], counts[0] + heard[1]])
    assert len(places) >= 7
    a, b = a[places], b[places]
    inside = np.abs(a - b)[:, 30:120]
    # The sizes of docs/archive/decisions.md, a little above what was measured there.
    assert inside[..., 0].max() < 0.03
    assert inside[..., 1:21].max() < 0.3
    assert inside[..., 21:33].max() < 0.04
    assert (a[..., 33] != b[..., 33]).mean() < 0.02
    assert (a[..., 34] != b[..., 34]).mean() < 0.04
