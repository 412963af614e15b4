"""Stores as one works with them: clips by id, motion, joints and beats of a clip, tables of pandas."""

from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import UsageError
from dancedata.store import Store
from dancedata.testing.stores import write_random_store


@pytest.fixture(scope="module")
def store(built: Path) -> Store:
    return dancedata.open(built)


def test_a_store_is_a_collection_of_clips(store: Store) -> None:
    ids = [clip.id for clip in store]
    assert len(store) == len(ids) == len(store.clips())
    assert ids == store.clips().ids
    assert ids[0] in store
    assert "nobody" not in store
    np.testing.assert_array_equal(store[ids[0]]["edge151"], store[ids[0]].read("edge151"))
    with pytest.raises(UsageError, match="no clip named"):
        store["nobody"]


def test_clips_of_a_split_and_of_values(store: Store) -> None:
    train = store.clips("train")
    assert train.ids == [clip.id for clip in store if clip.split == "train"]
    genre = train[0].genre
    chosen = store.clips("train", genre=(genre, "none"))
    assert chosen.ids == [clip.id for clip in train if clip.genre == genre]
    assert (len(chosen), chosen[:1].ids, chosen[-1].id) == (len(chosen.ids), chosen.ids[:1], chosen.ids[-1])
    assert chosen.ids[0] in chosen
    assert chosen[0] in train
    assert store.clips("test")[0] not in train
    assert "nobody" not in train
    assert store.clips(clip=chosen.ids).ids == chosen.ids
    with pytest.raises(UsageError, match="no split named"):
        store.clips("trian")
    with pytest.raises(UsageError, match="genre"):
        store.clips(gnere="x")
    pytest.importorskip("pandas")
    assert train.to_pandas()["id"].tolist() == train.ids


def test_a_clip_has_fields_and_windows(store: Store) -> None:
    clip = store.clips("train")[0]
    assert "edge151" in clip
    assert list(clip.windows()) == [w for w in store.windows("train") if w.clip == clip.id]
    out = np.zeros((150, 151))
    assert store.read(clip.windows()[0], "edge151", out) is out
    np.testing.assert_array_equal(out, clip["edge151"][:150])
    with pytest.raises(UsageError, match="no field named"):
        assert "edge" in clip


def test_motion_joints_and_beats(store: Store) -> None:
    clip = store.clips()[0]
    expected = dancedata.decode(clip["edge151"], "edge151", like=store, normalized=False)
    np.testing.assert_allclose(clip.motion().joints(), expected.joints(), atol=1e-12)
    np.testing.assert_allclose(clip.joints("edge151"), expected.joints(), atol=1e-12)
    rows = clip["librosa35"]
    late = np.flatnonzero(rows[:, store.fields["librosa35"].slice("beat")].ravel() > 0.5) - 1  # a row late
    np.testing.assert_allclose(clip.beats(), np.maximum(late, 0) / 30, atol=0.5 / 30)  # instants between rows
    with pytest.raises(UsageError, match="'edge151' has no beats"):
        clip.beats("edge151")


def test_stores_without_motion_or_beats(tmp_path: Path) -> None:
    made = write_random_store(tmp_path / "store", clips={"train": 1}, n_frames=(60, 60), length=30, stride=30)
    clip = dancedata.open(made.path).clips()[0]
    with pytest.raises(UsageError, match="no beats are stored"):
        clip.beats()
    with pytest.raises(UsageError, match="no field of motion that can be decoded"):
        clip.motion()


def test_tables_of_pandas(store: Store) -> None:
    pandas = pytest.importorskip("pandas")
    clips = store.to_pandas()
    assert clips["id"].tolist() == [clip.id for clip in store]
    assert clips["n_frames"].tolist() == [clip.n_frames for clip in store]
    np.testing.assert_allclose(clips["seconds"], clips["n_frames"] / 30)
    assert set(clips["licence"]) == {store.info["licence"]}
    windows = store.to_pandas("windows")
    assert isinstance(windows, pandas.DataFrame)
    assert windows.groupby("split").size().to_dict() == {split: len(store.windows(split)) for split in store.splits}
    assert [tuple(row) for row in windows[["clip", "start"]].head(3).values.tolist()] == [
        (w.clip, w.start) for w in store.windows(store.splits[0])[:3]
    ]
    assert store.to_pandas("rejects").to_dict("records") == store.rejects
    assert len(store.to_pandas("quality")) == len(store.quality)
    quality = store.to_pandas("quality")
    assert quality[quality["kind"] == "none of these"].empty  # also where there are no flags
    with pytest.raises(UsageError, match="no table named 'clip'"):
        store.to_pandas("clip")
