"""Styles and lists of LDA's code, and ramps of STREAM's, on made-up recordings and labels."""

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.segments import Segment
from dancedata.datasets.motorica.labels import read_chunk, read_labels
from dancedata.datasets.motorica.reader import GENRES, IN_BOTH, TEST, TRAIN_COUNT, parse_name
from tests.golden.conftest import load


@pytest.fixture(scope="module")
def facts(crowd: Path) -> Any:
    return json.loads((crowd / "motorica" / "facts.json").read_text())


def test_styles_and_lists(crowd: Path, facts: Any) -> None:
    golden, about, lists = load(crowd / "motorica" / "expmap61.npz"), facts["dataset"], facts["released_lists"]
    styles = sorted(f"g{code}" for code in GENRES)
    assert styles == about["styles"] == sorted(lists["train"]["styles"]) == sorted(lists["test"]["styles"])
    first = [GENRES[style[1:]] for style in styles].index(parse_name(about["list"][0][:-3]).genre)
    np.testing.assert_array_equal(golden["dataset.window_start0_style"], np.tile(np.eye(8)[first], (12, 1)))
    assert list(IN_BOTH) == lists["in_both"]
    assert (lists["train"]["recordings"], lists["train"]["lines"]) == (TRAIN_COUNT, 4 * TRAIN_COUNT)
    assert (lists["test"]["recordings"], lists["test"]["lines"]) == (len(TEST), 2 * len(TEST))
    assert lists["test"]["first"] == f"{TEST[0]}_00"
    for code, genre in GENRES.items():
        assert 2 * sum(parse_name(name).genre == genre for name in TEST) == lists["test"]["styles"][f"g{code}"]


# ---- STREAM's ramps, which are rounded to 3 decimals, of whole clips to 2


def ramps(segments: Sequence[tuple[int, int]], length: int) -> np.ndarray:
    """0 to 1 from the first to the last frame of each segment, of a single frame 0; the later segment wins."""
    out = np.zeros(length)
    for start, end in segments:
        out[start:end] = np.linspace(0, 1, end - start)
    return out


def frames(segment: Segment) -> tuple[int, int]:
    return int(segment.start * 30), int(segment.end * 30)


def test_ramps_of_chunks(crowd: Path) -> None:
    """Gaps are 0."""
    golden = load(crowd / "stream" / "labels.npz")
    folder = crowd / "inputs" / "motorica_pp" / "motorica" / "sliced_labels"
    chunks = [key.removesuffix(".label_index") for key in golden if key.endswith(".label_index")]
    assert len(chunks) == 5
    for chunk in chunks:
        found = ramps([frames(segment) for segment in read_chunk(folder / f"{chunk}_label.json")], 150)
        np.testing.assert_allclose(found, golden[f"{chunk}.label_index"], rtol=0, atol=5.1e-4)


def test_ramps_of_whole_clips(crowd: Path) -> None:
    """Gaps are segments with a ramp of their own."""
    golden = load(crowd / "stream" / "labels.npz")
    ((_, segments),) = read_labels(crowd / "inputs" / "motorica_pp").of.items()
    held = [frames(segment) for segment in segments]
    gaps = [(before[1], after[0]) for before, after in pairwise(held) if before[1] < after[0]]
    assert gaps
    whole = ramps([*held, *gaps], held[-1][1])
    for k in range(5):
        found = whole[30 * k : 30 * k + 150]
        np.testing.assert_allclose(found, golden[f"window{k}.clip_ramp"], rtol=0, atol=5.1e-3)
