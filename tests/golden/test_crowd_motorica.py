"""Mirrored takes, training rows and lists of LDA's code, and ramps of STREAM's, on made-up recordings and labels."""

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.motion import Motion
from dancedata.core.segments import Segment
from dancedata.datasets.motorica.labels import read_chunk, read_labels
from dancedata.datasets.motorica.motion import load_motion
from dancedata.datasets.motorica.names import GENRES, IN_BOTH, TEST, TRAIN_COUNT, parse_name
from dancedata.testing.examples import mirrored_motion
from tests.golden.conftest import load

#: Columns of joints other than the hips, and the hips' height; the root's turns and steps are columns of their own.
JOINTS, HEIGHT = 54, 57


@pytest.fixture(scope="module")
def facts(crowd: Path) -> Any:
    return json.loads((crowd / "motorica" / "facts.json").read_text())


@pytest.fixture(scope="module")
def motions(crowd: Path) -> dict[str, Motion]:
    files = sorted((crowd / "inputs" / "motorica" / "bvh").glob("*.bvh"))
    return {path.stem: load_motion(path, fingers=False) for path in files}


def rows_of(motion: Motion, take: int, facts: Any) -> np.ndarray:
    """LDA's columns of a take that motion alone decides, (T, 55): joints, and the hips' height in cm."""
    index = [motion.skeleton.index(column.split("_")[0]) for column in facts["columns"][:JOINTS:3]]
    rotations = motion.rotations[2 * take :: 4, index].reshape(-1, JOINTS)
    return np.concatenate([rotations, 100 * motion.joints()[2 * take :: 4, :1, 1]], axis=1)


def assert_rows(found: np.ndarray, wanted: np.ndarray) -> None:
    np.testing.assert_allclose(found[:, :JOINTS], wanted[:, :JOINTS], rtol=0, atol=1e-5)
    np.testing.assert_allclose(found[:, JOINTS], wanted[:, HEIGHT], rtol=0, atol=1e-4)


def test_takes_and_their_mirror_images(crowd: Path, facts: Any, motions: dict[str, Motion]) -> None:
    golden = load(crowd / "motorica" / "expmap61.npz")
    for name, motion in motions.items():
        about = facts["files"][name]
        assert about["frames"] == motion.n_frames
        assert about["rows_60"] == (motion.n_frames + 1) // 2
        for take in (0, 1):
            rows = rows_of(motion, take, facts)
            assert len(rows) == about["rows_30"][take]
            assert_rows(rows, golden[f"{name}_0{take}"])
            mirrored = rows_of(mirrored_motion(motion), take, facts)
            assert_rows(mirrored, golden[f"{name}_0{take}_mirrored"])


def test_training_rows_and_their_scaler(crowd: Path, facts: Any, motions: dict[str, Motion]) -> None:
    """Takes end with motion or audio, are trimmed, and put one after the other; mean and deviation (n) over them."""
    golden, about = load(crowd / "motorica" / "expmap61.npz"), facts["dataset"]
    kept, starts = [], []
    for name in about["list"]:
        rows = rows_of(motions[name[:-3]], int(name[-1]), facts)
        n = len(rows) + min(0, about["audio_rows_minus_motion_rows"][name])
        rows = rows[about["trim_edges"] : n - about["trim_edges"]]
        begin = sum(map(len, kept))
        starts += range(begin, begin + len(rows) - about["head_room_length"] + 1)
        kept.append(rows)
    rows = np.concatenate(kept)
    assert (len(rows), len(starts), starts) == (about["frames_kept"], about["windows"], about["sorted_starts"])
    columns = [*range(JOINTS), HEIGHT]
    mean, scale = rows.mean(axis=0), rows.std(axis=0)
    limit = np.where(np.arange(JOINTS + 1) == JOINTS, 1e-4, 1e-5)
    assert (np.abs(mean - golden["dataset.out_mean"][columns]) < limit).all()
    assert (np.abs(scale - golden["dataset.out_scale"][columns]) < limit).all()
    assert_rows(rows[: about["segment_length"]], golden["dataset.window_start0_out"])


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
    ((_, segments),) = read_labels(crowd / "inputs" / "motorica_pp").segments.items()
    held = [frames(segment) for segment in segments]
    gaps = [(before[1], after[0]) for before, after in pairwise(held) if before[1] < after[0]]
    assert gaps
    whole = ramps([*held, *gaps], held[-1][1])
    for k in range(5):
        found = whole[30 * k : 30 * k + 150]
        np.testing.assert_allclose(found, golden[f"window{k}.clip_ramp"], rtol=0, atol=5.1e-3)
