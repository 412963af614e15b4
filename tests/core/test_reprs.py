"""The repr in a notebook is short: one to three lines, no arrays, for any content."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.building.build import BuildResult
from dancedata.building.plan import make_plan
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.bodies import SKELETONS
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import CONTACTS, DATASETS, FEATURES, KEYMOTIONS, REPRESENTATIONS
from dancedata.core.skeleton import SMPL24
from dancedata.keymotion import KeyMotion, primitives
from dancedata.recipes.parse import load_recipe, recipe_names
from dancedata.store import Store
from dancedata.testing.stores import write_random_store


def motion(n: int = 960) -> Motion:
    return Motion(np.zeros((n, 3)), np.zeros((n, 24, 3)), FrameGrid.of(60), SMPL24, trim_start=3)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return dancedata.open(write_random_store(tmp_path / "store", clips={"train": 40, "val": 3}).path)


def printed(store: Store, tmp_path: Path) -> Iterator[Any]:
    """Everything that the documented interface gives to a user."""
    name = next(iter(store.fields))
    window = store.windows("train")[0]
    yield from (
        store,
        store.clips(),
        store.clips()[:2],
        store.clips()[0],
        store[window.clip],
        store.clips()[0].record,
    )
    yield from (store.field(name), store.fields[name], store.windows("train"), window, store.skeleton)
    yield from (motion(), motion().part(0, 9), FrameGrid.of(30), FrameGrid.of("30000/1001"), *SKELETONS.values())
    yield AudioSignal(np.zeros(10**6, np.float32), 48_000)
    yield store.scaler(name)
    for registry in (CONTACTS, DATASETS, FEATURES, KEYMOTIONS, REPRESENTATIONS):
        for plugin in registry.names():
            if plugin not in ("jukebox", "hf", "file"):
                made: Any = registry.get(plugin)()
                yield made
                columns = getattr(made, "columns", None)
                if columns is not None:
                    yield from (columns, columns.mirror, *columns.groups)
    refs = tuple(ClipRef(f"clip {k}", Path("x"), None, "train") for k in range(50))
    yield from (refs[0], Reject("nan", "clip"), Scan("names", refs))
    yield from (
        primitives(np.zeros((1024, 9)), minima=[300], prominence=[1]),
        KeyMotion(np.zeros(959), np.arange(9), np.zeros(9)),
    )
    counts = {"train": {"clips": 9, "windows": 99}}
    yield BuildResult(tmp_path, True, counts, {"nan": 3}, ("a note",) * 20, compared="line\n" * 20)
    yield from map(load_recipe, recipe_names())
    source = tmp_path / "source"
    DATASETS.get("aist++")().make_example(source)  # type: ignore[attr-defined]
    yield make_plan(load_recipe("aist++", ["windows.length_s=2"]), source, cache=tmp_path / "cache")


def test_nothing_prints_more_than_three_lines(store: Store, tmp_path: Path) -> None:
    seen = set()
    for thing in printed(store, tmp_path):
        text = repr(thing)
        assert text.count("\n") < 3 and len(text) <= 400, text[:2000]  # noqa: PT018
        assert "array(" not in text
        assert " object at 0x" not in text
        assert str(thing).count("\n") < 3
        seen.add(type(thing).__name__)
    assert {
        "Motion", "FrameGrid", "Skeleton", "Scaler", "AudioSignal", "Store", "Clip", "Columns", "Plan",
    } <= seen  # fmt: skip
