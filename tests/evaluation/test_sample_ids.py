"""Samples named by their ids have the same numbers everywhere: in a folder, an evaluator, and in numpy."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata import Evaluator
from dancedata.core.errors import DataError, UsageError
from dancedata.core.sample_id import SampleId, safe_name
from dancedata.metrics.beats import beat_alignment, motion_beat_times
from dancedata.store import Store
from dancedata.store.samples import Samples
from tests.messages import raises_message

OPTIONS: Mapping[str, Any] = {"normalized": False, "bootstrap": 0}
RECIPE = {
    "recipe": 1, "name": "late", "dataset": {"synthetic": {"songs": 3, "clips_per_song": 2, "clip_s": 9}}, "fps": 30,
    "windows": {"length_s": 5, "stride_s": 0.5}, "motion": {"edge151": {}}, "audio": {"librosa35": {}},
    "augment": {"mirror": True, "tempo": {"speeds": [1.1]}},
}  # fmt: skip


@pytest.fixture(scope="module")
def copies(folder: Path) -> Store:
    """A dataset with mirrored and faster copies."""
    dancedata.build(RECIPE, out=folder / "copies", jobs=1, cache=folder / "cache", progress=False)
    return dancedata.open(folder / "copies")


def ids_of(store: Store) -> list[str]:
    """Windows of clips and of copies, a whole clip, a mirrored window, and a second take."""
    ids = [f"{safe_name(clip.id)}@{7 * k + 3}+150" for k, clip in enumerate(store.clips)]
    return [*ids, f"{ids[0]}~s1", f"{ids[1]}~mirror~draw0.0.4", safe_name(store.clips[0].id)]


def rows_of(store: Store, name: str) -> np.ndarray:
    """Return the dances of the dataset that an id names."""
    sample = Samples(store).require(name)
    rows = store.read(sample.windows[0], "edge151")
    mirror = store.fields["edge151"].mirror
    return np.asarray(mirror.apply(rows) if sample.id.mirrored and mirror else rows)


def by_hand(store: Store, name: str) -> float:
    """Return the alignment of one window's beats by numpy alone."""
    sample, step = Samples(store).require(name), 1 / 6
    joints = dancedata.decode(rows_of(store, name), "edge151", fps=30).joints()[:, :22]
    beats = store[sample.clip.id].beats() - sample.start / 30
    beats = beats[(beats >= step) & (beats <= (sample.length - 1) / 30 - step)]
    return beat_alignment(beats, motion_beat_times(joints, 30), sigma=0.05)


def test_a_folder_an_evaluator_and_numpy_agree(copies: Store, tmp_path: Path) -> None:
    ids = ids_of(copies)[:-1]
    for name in ids:
        np.save(tmp_path / f"{name}.npy", rows_of(copies, name))
    folder = dancedata.evaluate(tmp_path, like=copies, **OPTIONS)
    evaluator = Evaluator(copies, "edge151", normalized=False)
    evaluator.update(np.stack([rows_of(copies, name) for name in ids]), ids)
    batches = evaluator.compute()
    assert [s.value for s in batches.scores] == pytest.approx([s.value for s in folder.scores], rel=1e-6)
    assert folder["bas"].value == pytest.approx(np.mean([by_hand(copies, name) for name in ids]), rel=1e-6)
    assert folder.clips == batches.clips
    assert "windows of" in folder.matched
    originals = {Samples(copies).require(name).recording for name in ids}
    assert originals == {clip.id for clip in copies.clips if not clip.source}


def test_samples_resolve(copies: Store) -> None:
    clip = copies.clips[0]
    sample = Samples(copies).require(f"{clip.id}@30+150")
    assert sample.music_start_s == 1
    assert sample.to_json() | {"recording": clip.id, "music_start_s": "1", "fps": "30"} == sample.to_json()
    copy = next(c for c in copies.clips if c.source)
    assert Samples(copies).require(copy.id).recording == copy.source
    assert Samples(copies).find("nobody") is None


@pytest.mark.parametrize(
    ("name", "reason"), [("{}@200+150", "outside"), ("{}@0+0", "outside"), ("nobody@0+150", "no_clip")]
)
def test_windows_that_the_dataset_does_not_have(store: Store, tmp_path: Path, name: str, reason: str) -> None:
    rows = store.clips[0].read("edge151")[:150]
    np.save(tmp_path / f"{name.format(store.clips[0].id)}.npy", rows)
    with raises_message(DataError, "clip", reason=reason, where=name.format(store.clips[0].id)):
        dancedata.evaluate(tmp_path, like=store, **OPTIONS)


def test_a_file_states_its_id(store: Store, tmp_path: Path) -> None:
    clip = store.clips[0]
    rows, name = clip.read("edge151")[20:170], f"{clip.id}@20+150"
    np.savez(tmp_path / "x.npz", samples=rows, id=name)
    stated = dancedata.evaluate(tmp_path, like=store, **OPTIONS)
    assert stated["bas"].value == pytest.approx(by_hand(store, name), rel=1e-6)
    np.savez(tmp_path / "y.npz", samples=rows, id=name)
    with raises_message(DataError, "number", reason="two_samples"):
        dancedata.evaluate(tmp_path, like=store, **OPTIONS)
    (tmp_path / "y.npz").unlink()
    (tmp_path / "x.npz").rename(tmp_path / f"{clip.id}@0+150.npz")
    with raises_message(DataError, "rename", reason="two_ids"):
        dancedata.evaluate(tmp_path, like=store, **OPTIONS)


def test_the_length_is_that_of_the_id(store: Store, tmp_path: Path) -> None:
    clip = store.clips[0]
    np.save(tmp_path / f"{clip.id}@0+150.npy", clip.read("edge151")[:120])
    with raises_message(DataError, "150 rows", reason="nothing_left"):
        dancedata.evaluate(tmp_path, like=store, **OPTIONS)
    np.save(tmp_path / f"{clip.id}@3+150.npy", clip.read("edge151")[3:153])
    report = dancedata.evaluate(tmp_path, like=store, **OPTIONS)
    assert report.left_out[0][0] == f"{clip.id}@0+150"


def test_a_list_of_songs_needs_the_second_of_a_window(store: Store, tmp_path: Path) -> None:
    clip = store.clips[0]
    name = str(replace(SampleId(clip.id), start=105, length=60))
    np.save(tmp_path / f"{name}.npy", clip.read("edge151")[105:165])
    with raises_message(UsageError, r"3\.5", where=name):
        dancedata.evaluate(tmp_path, like=store, music_of={name: clip.music}, **OPTIONS)
