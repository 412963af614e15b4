"""A thirteenth capability is one file beside the recipe, with copies at another speed, groups and two workers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import dancedata
from dancedata.core.registry import DATASETS
from dancedata.store import Store, verify_store

LEAPS = Path(__file__).with_name("leaps.py")
RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "leaps", "dataset": "aioz-gdance", "windows": {"length_s": 1, "stride_s": 0.5},
    "motion": "joints", "augment": {"mirror": True, "tempo": {"speeds": [1.25]}},
}  # fmt: skip
CAPABILITY = {
    "plugins": [str(LEAPS)], "transforms": ["moving-average"], "annotators": {"leaps": True},
    "rules": {"long-leaps": {"most_s": 0.2}},
}  # fmt: skip


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> tuple[Store, Store]:
    """Built with the capability and without, by two workers."""
    folder = tmp_path_factory.mktemp("leaps")
    DATASETS.get("aioz-gdance")().make_example(folder / "source")
    stores = []
    for name, keys in (("with", CAPABILITY), ("without", {})):
        recipe = folder / f"{name}.yaml"
        recipe.write_text(yaml.safe_dump({**RECIPE, **keys}), encoding="utf-8")
        places = {"source": folder / "source", "out": folder / name, "cache": folder / "cache"}
        stores.append(dancedata.build(recipe, jobs=2, progress=False, **places).open())
    return stores[0], stores[1]


def test_motion_of_all_clips_and_copies_goes_through_the_transform(stores: tuple[Store, Store]) -> None:
    smoothed, plain = stores
    assert verify_store(smoothed.path) == []
    assert any(clip.group for clip in smoothed.clips)
    for clip in smoothed.clips:
        pelvis, before = (store[clip.id].read("joints")[:, :3] for store in stores)
        assert 0 < np.abs(np.diff(pelvis, n=2, axis=0)).sum() < np.abs(np.diff(before, n=2, axis=0)).sum()
    assert plain.info["recipe"]["transforms"] == []


def test_segments_of_copies_are_at_their_speed(stores: tuple[Store, Store]) -> None:
    store, _ = stores
    copied = [clip for clip in store.clips if clip.id.endswith("__tempo")]
    marked = [clip for clip in copied if store.segments(clip.id, "leaps")]
    assert marked
    for clip in marked:
        of_copy, of_source = (store.segments(name, "leaps") for name in (clip.id, clip.source))
        assert len(of_copy) == len(of_source)
        assert [s.start for s in of_copy] == [s.start * 4 / 5 for s in of_source]


def test_windows_that_the_rule_names_are_left_out(stores: tuple[Store, Store]) -> None:
    store, plain = stores
    assert {r["reason"] for r in store.rejects} == {"filtered"} | {r["reason"] for r in plain.rejects}
    for clip in store.clips:
        group = [c.id for c in store.clips if c.group == clip.group and c.group] or [clip.id]
        long = [s for name in group for s in store.segments(name, "leaps") if s.value > 0.2]
        for window in plain[clip.id].windows():
            first, end = (store.grid.seconds(frame) for frame in (window.start, window.start + 30))
            touched = any(s.start < end and s.end > first for s in long)
            assert touched == (window.start not in [w.start for w in store[clip.id].windows()])
