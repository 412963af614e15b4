"""Rows are read as they were written, for any corpus; stats.json and the quantiles of a report against numpy."""

import json
import pickle
import tempfile
import tracemalloc
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.core.errors import StoreError
from dancedata.pages.numbers import column_ranges
from dancedata.store import AudioBlock, StoredClip, open_store, verify_store, write_store
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.schema import Field
from dancedata.testing.stores import RandomStore, random_columns, write_random_store
from tests.messages import raises_message
from tests.store.test_verify import seal


def read_everything(made: RandomStore) -> int:
    """Compare all windows of all splits with the source; return how many there were."""
    store = open_store(made.path)
    count = 0
    for split in store.splits:
        for window in store.windows(split):
            for name in store.fields:
                found = store.read(window, name)
                np.testing.assert_array_equal(found, made.rows(window.clip, name, window.start, window.length))
                assert found.dtype == np.dtype(store.field(name).dtype)
            count += 1
    return count


@settings(max_examples=12, deadline=None)
@given(
    slices=st.booleans(),
    fps=st.sampled_from([Fraction(30), Fraction(30000, 1001)]),
    length=st.sampled_from([4, 8, 20]),
    stride=st.sampled_from([4, 8]),
    clips=st.dictionaries(st.sampled_from(["train", "val", "test", "all"]), st.integers(1, 4), min_size=1),
    shard_bytes=st.sampled_from([1, 3000, 10**9]),
    clips_per_song=st.integers(1, 3),
    seed=st.integers(0, 99),
)
def test_every_window_is_the_source_slice(**options: Any) -> None:
    fps = options["fps"]
    fields = (
        Field("pose", "motion", random_columns(3), fps),
        Field("fast", "motion", random_columns(2), fps * 2),
        Field("music", "audio", random_columns(2, mirror=False), fps, "float16"),
        Field("slow", "audio", random_columns(3, mirror=False), fps / 4),
    )
    with tempfile.TemporaryDirectory() as folder:
        made = write_random_store(Path(folder), fields=fields, n_frames=(20, 60), **options)
        assert read_everything(made) == sum(len(c.starts) for c in made.clips)
        assert verify_store(made.path) == []


def test_one_kind_of_clip(make_store: Any) -> None:
    made = make_store(clips={"train": 3, "val": 2})
    store = open_store(made.path)
    assert len(store) == 5
    for number, clip in enumerate(store.clips()):
        written = made.clip(clip.id)
        for name in ("split", "genre", "music", "dancer", "tempo_bpm", "source", "n_flags", "lists", "n_frames"):
            assert getattr(clip, name) == getattr(written, name), name
        assert clip == store[clip.id] == store.clips()[number] == store.clips()[number - 5]
        for column in fields(ClipRecord):
            assert getattr(clip, column.name) == getattr(clip.record, column.name), column.name
        for name in store.fields:
            np.testing.assert_array_equal(clip.read(name), made.rows(clip.id, name, 0, clip.n_frames))
        again = pickle.loads(pickle.dumps(clip))
        np.testing.assert_array_equal(again.read("pose"), clip.read("pose"))
    assert [clip.id for clip in store.clips()[1:3]] == [clip.id for clip in store][1:3]
    assert store.clips()[3] in store.clips()
    assert store.clips()[3].id in store
    assert "nobody" not in store
    with pytest.raises(IndexError):
        store.clips()[5]


def test_unicode_ids_and_texts(make_store: Any, tmp_path: Path) -> None:
    made = make_store(clips={"train": 4})
    texts: dict[str, Any] = {"genre": "Street Jazz é", "music": "π", "lists": ("liste é", "b, c"), "trim_start": 3}
    ids = ["ダンス 01", "breaking ñ", "🕺", "a b"]
    clips = [replace(clip, id=name, **texts) for name, clip in zip(ids, made.clips, strict=True)]
    out = tmp_path / "ünï cödé"
    out.mkdir()
    write_store(out, made.header, clips)
    store = open_store(out)
    assert sorted(clip.id for clip in store) == sorted(ids)
    for name, clip in zip(ids, made.clips, strict=True):
        np.testing.assert_array_equal(store[name].read("pose"), clip.motion["pose"])
        assert {key: getattr(store[name], key) for key in texts} == texts
    assert verify_store(out) == []


def test_shared_timeline_is_stored_once_a_shard(make_store: Any) -> None:
    one = make_store(clips={"train": 6}, clips_per_song=6)
    many = make_store(clips={"train": 6}, clips_per_song=6, shard_bytes=1)
    [shard] = open_store(one.path)._shards("train")
    timeline = one.clips[0].audio["music"].array
    assert shard.layout("music").n_rows == timeline.shape[0]
    shards = open_store(many.path)._shards("train")
    assert len(shards) == 6
    assert all(s.layout("music").n_rows == timeline.shape[0] for s in shards)


def test_clips_without_windows_are_kept(make_store: Any) -> None:
    made = make_store(clips={"train": 4}, n_frames=(10, 60), length=30)
    short = [c.id for c in made.clips if not c.starts]
    assert short, "the seed should give a short clip"
    store = open_store(made.path)
    assert {w.clip for w in store.windows("train")}.isdisjoint(short)
    assert store[short[0]].n_frames == made.clip(short[0]).n_frames
    assert len(store[short[0]].read("pose")) == made.clip(short[0]).n_frames
    assert verify_store(made.path) == []


def test_memory_of_a_write_is_that_of_a_clip(out: Path, make_store: Any) -> None:
    class Lazy:
        """An array that is made when it is asked for."""

        def __init__(self, *shape: int) -> None:
            self.shape = shape

        def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
            return np.ones(self.shape, np.float32)

    header = make_store(fields=[Field("pose", "motion", random_columns(400), Fraction(30))]).header
    lazy: dict[str, Any] = {"motion": {"pose": Lazy(2000, 400)}}
    clips = [StoredClip(id=f"c{k:02d}", split="train", n_frames=2000, starts=(0,), **lazy) for k in range(15)]
    tracemalloc.start()
    try:
        write_store(out, header, clips)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 24e6, "of 48 MB"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["pose", "music"])
def test_values_that_are_not_finite_are_refused(out: Path, make_store: Any, value: float, name: str) -> None:
    made = make_store(clips={"train": 2}, clips_per_song=1)
    clip = made.clips[1]
    array = np.asarray(clip.motion["pose"] if name == "pose" else clip.audio["music"].array)
    array[17, 1] = value
    with raises_message(StoreError, "repair"):
        write_store(out, made.header, made.clips)
    assert not any(out.iterdir())


def test_values_beyond_float16_are_refused(out: Path, make_store: Any) -> None:
    made = make_store(clips={"train": 2}, clips_per_song=1)
    audio = dict(made.clips[0].audio)
    too_large = np.zeros(audio["layer"].array.shape, np.float32)
    too_large[3, 2] = -70000
    audio["layer"] = AudioBlock("large", too_large)
    clip = StoredClip(**{**vars(made.clips[0]), "audio": audio})
    with raises_message(StoreError, "float16"):
        write_store(out, made.header, [clip])


def covered(made: RandomStore, field: str) -> np.ndarray:
    """All rows that count, (n, D) float64."""
    f = next(f for f in made.header.fields if f.name == field)
    ratio = f.rate / made.header.fps
    train = [c for c in made.clips if c.split == "train"]
    timelines: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for c in train:
        key, array, offset = c.id, c.motion.get(field), 0
        if f.kind == "audio":
            block = c.audio[field]
            key, array, offset = block.key, block.array, block.offset
        _, used = timelines.setdefault(key, (np.asarray(array), np.zeros(len(array), bool)))
        for s in c.starts:
            used[offset + int(s * ratio) : offset + int((s + 30) * ratio)] = True
    return np.concatenate([rows[used] for rows, used in timelines.values()]).astype(np.float64)


@pytest.mark.parametrize("stride", [15, 45])
def test_stats_are_those_of_the_covered_rows(make_store: Any, stride: int) -> None:
    made = make_store(stride=stride, shard_bytes=9000, clips_per_song=3)
    store = open_store(made.path)
    stats = store.stats
    assert stats["windows"] == sum(len(c.starts) for c in made.clips if c.split == "train")
    for f in made.header.fields:
        found, rows = stats["fields"][f.name], covered(made, f.name)
        assert found["n"] == len(rows)
        np.testing.assert_allclose(found["mean"], rows.mean(axis=0), rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(found["std"], rows.std(axis=0), rtol=1e-12)
        np.testing.assert_array_equal(found["min"], rows.min(axis=0))
        np.testing.assert_array_equal(found["max"], rows.max(axis=0))
        quantiles = [[c.p5, c.p25, c.p50, c.p75, c.p95] for c in column_ranges(store, f.name)]
        expected = np.quantile(rows, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
        np.testing.assert_allclose(np.transpose(quantiles), expected, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(found["scaler"]["data_min"], rows.min(axis=0))
        np.testing.assert_array_equal(found["scaler"]["data_max"], rows.max(axis=0))


def test_stats_do_not_depend_on_shards(make_store: Any) -> None:
    texts = {(make_store(shard_bytes=size).path / "stats.json").read_text() for size in (1, 9000, 10**9)}
    assert len(texts) == 1


def test_small_deviations_far_from_0_are_exact(out: Path, make_store: Any) -> None:
    made = make_store(clips={"train": 9})
    for number, clip in enumerate(made.clips):
        pose = np.asarray(clip.motion["pose"])
        pose[:] = 30_000 + number + np.random.default_rng(number).standard_normal(pose.shape) / 64
    write_store(out, made.header, made.clips)
    found, rows = open_store(out).stats["fields"]["pose"], covered(made, "pose")
    np.testing.assert_allclose(found["mean"], rows.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found["std"], rows.std(axis=0), rtol=1e-12)


def test_column_without_range_is_scaled_as_edge_does(out: Path, make_store: Any) -> None:
    made = make_store()
    for clip in made.clips:
        np.asarray(clip.motion["pose"])[:, 2] = np.float32(0.1)
        np.asarray(clip.motion["pose"])[::2, 3] = -0.0
        np.asarray(clip.motion["pose"])[1::2, 3] = 0.0
        np.asarray(clip.motion["pose"])[:, 4] = -0.0
    write_store(out, made.header, made.clips)
    stats = json.loads((out / "stats.json").read_text())["fields"]["pose"]
    assert stats["scaler"]["scale"][2] == 2.0
    assert stats["std"][2] == 0.0
    assert stats["mean"][2] == np.float32(0.1)
    assert stats["scaler"]["offset"][2] == -1 - float(np.float32(0.1)) * 2
    assert "-0.0" not in json.dumps([stats[what][3:5] for what in ("min", "max", "mean")])


@pytest.mark.parametrize(("name", "value"), [("mean", "x"), ("mean", 1e300), ("std", None), ("std", [1])])
def test_what_is_no_number_is_no_scaler(out: Path, make_store: Any, name: str, value: Any) -> None:
    made = make_store()
    write_store(out, made.header, made.clips)
    stats = json.loads((out / "stats.json").read_text())
    stats["fields"]["pose"][name][0] = value
    (out / "stats.json").write_text(json.dumps(stats))
    seal(out)
    with raises_message(StoreError, "pose", where="stats.json"):
        open_store(out).scaler("pose", "zscore_grouped")
