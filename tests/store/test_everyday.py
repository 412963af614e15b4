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
    assert len(store) == len(ids) == len(store.clips)
    assert ids == [clip.id for clip in store.clips]
    assert ids[0] in store
    assert "nobody" not in store
    np.testing.assert_array_equal(store[ids[0]]["edge151"], store.clip(ids[0]).read("edge151"))
    with pytest.raises(UsageError, match="no clip named"):
        store["nobody"]


def test_motion_joints_and_beats(store: Store) -> None:
    clip = store.clips[0]
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
    clip = dancedata.open(made.path).clips[0]
    with pytest.raises(UsageError, match="no beats are stored"):
        clip.beats()
    with pytest.raises(UsageError, match="no field of motion that can be decoded"):
        clip.motion()


def test_tables_of_pandas(store: Store) -> None:
    pandas = pytest.importorskip("pandas")
    clips = store.to_pandas()
    assert clips["id"].tolist() == [clip.id for clip in store.clips]
    assert clips["n_frames"].tolist() == [clip.n_frames for clip in store.clips]
    np.testing.assert_allclose(clips["seconds"], clips["n_frames"] / 30)
    assert set(clips["licence"]) == {store.meta["licence"]}
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
