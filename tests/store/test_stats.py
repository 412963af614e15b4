"""stats.json and the quantiles of a report against plain numpy."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.errors import StoreError
from dancedata.pages.numbers import column_ranges
from dancedata.store import open_store, write_store
from dancedata.testing.stores import RandomStore
from tests.messages import raises_message
from tests.store.test_verify import seal


def covered(made: RandomStore, field: str) -> np.ndarray:
    """All rows that count, (n, D) float64."""
    f = next(f for f in made.header.fields if f.name == field)
    ratio = f.rate / made.header.fps
    train = [c for c in made.clips if c.split == "train"]
    timelines: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for c in train:
        key, array, offset = c.id, c.motion.get(field), 0
        if f.kind == "audio":
            [block] = c.audio[field]
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


@pytest.mark.parametrize("value", ["x", None, [1], 1e300])
@pytest.mark.parametrize("name", ["mean", "std"])
def test_what_is_no_number_is_no_scaler(out: Path, make_store: Any, name: str, value: Any) -> None:
    made = make_store()
    write_store(out, made.header, made.clips)
    stats = json.loads((out / "stats.json").read_text())
    stats["fields"]["pose"][name][0] = value
    (out / "stats.json").write_text(json.dumps(stats))
    seal(out)
    with raises_message(StoreError, "pose", where="stats.json"):
        open_store(out).scaler("pose", "zscore_grouped")
