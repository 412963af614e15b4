"""Opening, looking things up, clips, tables of pandas, re-windowing, and use from other processes and threads."""

import os
import pickle
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import dancedata
from dancedata.core.clip import Window
from dancedata.core.errors import StoreError, UsageError
from dancedata.store import Store, open_store
from dancedata.store.schema import Field
from dancedata.testing.stores import random_columns, write_random_store
from tests.messages import raises_message


def checksum(store: Store, position: int) -> float:
    """Read one window of train, in the current process."""
    window = store.windows("train")[position]
    return float(sum(np.abs(store.read(window, f).astype(np.float64)).sum() for f in store.fields))


def test_repr_of_a_store(make_store: Any) -> None:
    made = make_store(clips={"zz": 1, "test": 1, "train": 2, "all": 1})
    store = open_store(str(made.path))
    assert store.splits == ("train", "test", "all", "zz")
    assert store.fps == 30
    assert isinstance(store.fps, int)
    assert store.path == made.path
    assert list(store.fields) == ["pose", "fast", "music", "layer"]
    assert store.fields["pose"] == made.header.fields[0].columns
    assert store.field("fast") == made.header.fields[1]
    assert store.skeleton.to_json() == made.header.skeleton.to_json()
    assert store.info["recipe"] == {"name": "random"}
    assert store.rejects == []
    assert store.quality == []


def test_a_file_that_h5py_holds_with_locks_is_named_as_one(make_store: Any) -> None:
    store = open_store(make_store().path)
    with (
        h5py.File(store.path / "tables.h5", "r", locking=True),
        pytest.raises(StoreError, match="process has the file open with locks"),
    ):
        store.windows("train")
    assert store.windows("train")


def test_read_into_converts_and_takes_strided_arrays(make_store: Any) -> None:
    made = make_store()
    store = open_store(made.path)
    window = store.windows("train")[1]
    wanted = made.rows(window.clip, "layer", window.start, 30)
    mine = store.read(window, "layer")
    mine[...] = 0
    np.testing.assert_array_equal(store.read(window, "layer"), wanted)
    batch = np.zeros((4, 30, 3), np.float32)
    store.read(window, "layer", batch[2])
    np.testing.assert_array_equal(batch[2], wanted.astype(np.float32))
    strided = np.zeros((30, 6), np.float16)
    store.read(window, "layer", strided[:, ::2])
    np.testing.assert_array_equal(strided[:, ::2], wanted)
    assert not strided[:, 1::2].any()
    assert not batch[[0, 1, 3]].any()
    with raises_message(UsageError, "array"):
        store.read(window, "layer", np.zeros((29, 3)))


def test_fields_with_groups_of_columns(make_store: Any) -> None:
    rate = Fraction(30)
    fields = [Field("pose", "motion", random_columns(7), rate)]
    fields += [Field(name, "audio", random_columns(n, mirror=False), rate) for name, n in (("one", 1), ("two", 2))]
    store = open_store(make_store(fields=fields).path)
    names = [[field.name for field in store.fields_with(*groups)] for groups in ("", "a", "b", "ab", "ac")]
    assert names == [["one", "two"], ["one", "two"], ["two"], ["two"], []]


def test_window_list_is_a_sequence(make_store: Any) -> None:
    windows = open_store(make_store().path).windows("train")
    everything = list(windows)
    assert windows[-1] == everything[-1]
    assert list(windows[1:5:2]) == everything[1:5:2]
    assert windows[0] in windows
    assert windows.index(everything[4]) == 4
    assert windows.count(everything[4]) == 1
    mask = np.arange(len(windows)) % 2 == 0
    assert list(windows.take(mask)) == everything[::2]
    assert list(windows.take([3, 0])) == [everything[3], everything[0]]
    assert pickle.loads(pickle.dumps(windows)) == windows
    with pytest.raises(IndexError):
        windows[len(windows)]


def test_other_windows_at_read_time(make_store: Any) -> None:
    made = make_store(n_frames=(70, 130), shard_bytes=20_000)
    store = open_store(made.path)
    windows = store.windows("train", length_s=2, stride=7)
    wanted = [Window(c.id, s, 60) for c in made.clips if c.split == "train" for s in range(0, c.n_frames - 60 + 1, 7)]
    assert list(windows) == wanted
    for window in windows:
        for name in store.fields:
            np.testing.assert_array_equal(
                store.read(window, name), made.rows(window.clip, name, window.start, window.length)
            )
    assert store.windows("train", length_s="1", stride_s=0.5) == store.windows("train")
    assert len(store.windows("train", stride=1)) > len(store.windows("train"))


def test_other_windows_end_with_the_music(out: Path, make_store: Any) -> None:
    made = make_store()
    from dancedata.store import AudioBlock, StoredClip, write_store

    clip = StoredClip(
        id="c", split="train", n_frames=100, starts=(0,),
        motion={"pose": np.zeros((100, 7)), "fast": np.zeros((199, 4))},
        audio={
            "music": AudioBlock("m", np.arange(320.0).reshape(64, 5), 4),
            "layer": AudioBlock("l", np.zeros((200, 3))),
        },
    )  # fmt: skip
    write_store(out, made.header, [clip])
    store = open_store(out)
    assert [w.start for w in store.windows("train", stride=10)] == [0, 10, 20, 30]
    # Left to the motion alone, the windows go on; frame 99 has only one of its two rows at 60 a second.
    assert [w.start for w in store.windows("train", stride=10, fields=("pose",))][-1] == 70
    assert [w.start for w in store.windows("train", stride=10, fields=("pose", "fast"))][-1] == 60
    assert store["c"].read("music").shape == (60, 5)
    np.testing.assert_array_equal(store["c"].read_song("music"), np.arange(20, 320).reshape(60, 5))
    with raises_message(UsageError, "clip.read", where="out"):
        store["c"].read_song("pose")
    assert store["c"].read("layer").shape == (100, 3)
    with raises_message(UsageError, "ends", where="clip c"):
        store.read(Window("c", 40, 30), "music")


def test_fractional_rows_are_refused(make_store: Any) -> None:
    slow = Field("slow", "audio", random_columns(2, mirror=False), Fraction(15, 2))
    made = make_store(fields=[*make_store().header.fields, slow], length=32, stride=16)
    store = open_store(made.path)
    with raises_message(UsageError, "stride"):
        store.windows("train", stride=7)
    window = store.windows("train", stride=7, fields=("pose", "music"))[1]
    assert store.read(window, "pose").shape == (32, 7)
    with raises_message(UsageError, "slow", where="clip train_c00"):
        store.read(window, "slow")


def test_wrong_names_get_the_closest_one(make_store: Any) -> None:
    store = open_store(make_store().path)
    window = store.windows("train")[0]
    for attempt in (
        lambda: store.windows("trian"),
        lambda: store.read(window, "poze"),
        lambda: store.field("musik"),
        lambda: store.scaler("fas"),
        lambda: store["train_c0"],
        lambda: store.read(Window("train_x00", 0, 30), "pose"),
        lambda: store.windows("train", stride=1, fields=("posse",)),
    ):
        with raises_message(UsageError, "layer|trian|val_c01", where="store1"):
            attempt()
    for window in ("train_c00", 0, Window("train_c00", None, 30), Window("train_c00", 0, 30.5)):  # type: ignore[arg-type]
        with raises_message(UsageError, r"ds\.windows", where="store1"):
            store.read(window, "pose")  # type: ignore[arg-type]
    for start, length in ((-1, 30), (0, 0), (0, 10**6), (10**6, 30)):
        with raises_message(UsageError, "extends", where="clip train_c00"):
            store.read(Window("train_c00", start, length), "pose")
    with raises_message(UsageError, "counted"):
        store.clips()["train_c00"]  # type: ignore[call-overload]


@pytest.mark.parametrize(
    "options",
    [{"length_s": 1, "length": 30}, {"stride_s": 1, "stride": 30}, {"length": 0}, {"stride": -3}, {"length_s": 0.51},
     {"length": 2.5}],
)  # fmt: skip
def test_wrong_windows_are_refused(make_store: Any, options: dict[str, Any]) -> None:
    store = open_store(make_store().path)
    with raises_message(UsageError, "length|stride"):
        store.windows("train", **options)


def test_fork_after_reading(make_store: Any) -> None:
    store = open_store(make_store().path)
    wanted = [checksum(store, i) for i in range(8)]
    children = []
    for i in range(8):
        child = os.fork()
        if child == 0:
            # Always end by _exit: this is a copy of the test runner.
            try:
                same = all(checksum(store, k) == wanted[k] for k in (i, 0, 7 - i))
            finally:
                os._exit(0 if same else 1)
        children.append(child)
    assert [checksum(store, i) for i in range(8)] == wanted
    assert [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children] == [0] * 8


def test_threads_read_at_once(make_store: Any) -> None:
    store = open_store(make_store(shard_bytes=20_000).path)
    n = len(store.windows("train"))
    wanted = [checksum(store, i) for i in range(n)]
    store.close()
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(lambda i: checksum(store, i), list(range(n)) * 4)) == wanted * 4


def test_without_train_windows_there_is_no_scaler(make_store: Any) -> None:
    store = open_store(make_store(clips={"test": 2}).path)
    assert store.stats["fields"] == {}
    assert "no train windows" in store.stats["note"]
    with raises_message(StoreError, "scale", where="store1"):
        store.scaler("pose")


def test_folders_that_are_not_a_dataset(tmp_path: Path, make_store: Any) -> None:
    for folder, found in ((tmp_path / "nowhere", "no such folder"), (tmp_path / "empty", "an empty folder")):
        if found == "an empty folder":
            folder.mkdir()
        with raises_message(StoreError, "finished"):
            open_store(folder)
    made = make_store()
    (made.path / "dataset.json").unlink()
    with raises_message(StoreError, "finished", where="store1"):
        open_store(made.path)


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "not valid JSON"), ("[1]", "does not describe a dancedata"), ('{"a": 1}', "does not describe a dancedata"),
     ('{"format": 2}', "another format version"), ('{"format": 3}', "is incomplete")],
)  # fmt: skip
def test_wrong_dataset_json(make_store: Any, text: str, message: str) -> None:
    made = make_store()
    (made.path / "dataset.json").write_text(text)
    with pytest.raises(StoreError, match=message):
        open_store(made.path)


def test_shard_missing_or_of_another_size(make_store: Any) -> None:
    made = make_store()
    shard = made.path / "val-00000-of-00001.h5"
    data = shard.read_bytes()
    shard.write_bytes(data[:-1])
    with raises_message(StoreError, "shard", where="store1/val-00000-of-00001.h5"):
        open_store(made.path)
    shard.unlink()
    with raises_message(StoreError, "shard", where="store1/val-00000-of-00001.h5"):
        open_store(made.path)


def test_shard_cut_or_overwritten_while_open(make_store: Any) -> None:
    made = make_store()
    store = open_store(made.path)
    window = store.windows("train")[-1]
    store.read(window, "fast")
    shard = made.path / "train-00000-of-00001.h5"
    size = shard.stat().st_size
    os.truncate(shard, 2000)
    with pytest.raises(StoreError, match="ends too early"):
        store.read(window, "fast")
    other = open_store(make_store().path)
    (other.path / shard.name).write_bytes(b"x" * size)
    with pytest.raises(StoreError, match="not those that the build wrote"):
        checksum(other, 0)


@pytest.fixture(scope="module")
def store(built: Path) -> Store:
    return dancedata.open(built)


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
    for split in store.splits:
        for stored in store.clips(split):
            in_order = sorted((w for w in store.windows(split) if w.clip == stored.id), key=lambda w: w.start)
            assert stored.windows() == tuple(in_order)
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
