"""The kinetic curve, its minima and their rows; the plug-in: Lodge's joints, whole clips, other bodies."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import argrelextrema

from dancedata.building.build import build
from dancedata.core.bodies import SMPLX22, transfer
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.keymotion.characteristic_primitives import joints_of
from dancedata.keymotion.lodge import Lodge
from dancedata.metrics.key_motion import KeyMotion, key_motion, kinetic_curve, smoothed
from dancedata.recipes.parse import parse_recipe
from tests.messages import raises_message


def swinging(n: int, period: int = 40, joints: int = 3) -> np.ndarray:
    """Joints on circles at a speed that rises and falls: slowest at whole periods."""
    t = np.arange(n)
    way = np.cumsum(0.02 - 0.015 * np.cos(2 * np.pi * t / period)) - 0.005
    circle = np.stack([np.cos(way), 0 * way, np.sin(way)], axis=-1)
    return circle[:, None] * np.arange(1, joints + 1)[None, :, None]


@pytest.mark.parametrize(
    ("joints", "reason"),
    [
        (np.zeros((5, 3)), "bad_shape"), (np.zeros((5, 2, 2)), "bad_shape"), (np.zeros((0, 2, 3)), "empty"),
        (np.zeros((5, 0, 3)), "empty"), (np.full((5, 2, 3), np.nan), "nan"), (np.full((5, 2, 3), np.inf), "nan"),
    ],
)  # fmt: skip
def test_bad_joints(joints: np.ndarray, reason: str) -> None:
    with raises_message(DataError, "joints", reason=reason):
        kinetic_curve(joints)


def test_smoothing_reflects_at_the_ends() -> None:
    curve = np.random.default_rng(0).random(200)
    thrice = np.concatenate([curve[::-1], curve, curve[::-1]])
    np.testing.assert_allclose(smoothed(thrice, 5)[200:400], smoothed(curve, 5))


def test_minima_are_scipys() -> None:
    rng = np.random.default_rng(3)
    joints = np.cumsum(rng.normal(size=(400, 4, 3)), axis=0)
    found = key_motion(joints, 2)
    assert found.minima.tolist() == argrelextrema(found.curve, np.less)[0].tolist()
    np.testing.assert_array_equal(found.curve, smoothed(kinetic_curve(joints), 2))


def test_rows_of_a_clip() -> None:
    found = key_motion(swinging(150))
    rows = found.to_rows()
    assert rows.shape == (150, 3)
    assert rows.dtype == np.float32
    np.testing.assert_allclose(rows[:-1, 0], found.curve, rtol=1e-6)
    assert rows[-1, 0] == rows[-2, 0]
    # The way from m to m + 1 is shortest where cos(2 pi (m + 1) / 40) is 1.
    assert np.flatnonzero(rows[:, 1]).tolist() == found.minima.tolist() == [39, 79, 119]
    assert (found.prominence > 0).all()
    assert set(rows[:, 1].tolist()) == {0, 1}
    assert (rows[rows[:, 1] == 0, 2] == 0).all()
    assert rows[-1, 1:].tolist() == [0, 0]


@given(start=st.integers(0, 198), length=st.integers(1, 200))
def test_a_window_of_rows_has_the_clips_minima(start: int, length: int) -> None:
    found = key_motion(swinging(200))
    part = KeyMotion.from_rows(found.to_rows()[start : start + length])
    stop = min(start + length, 200)
    inside = (found.minima >= start) & (found.minima < stop)
    assert (part.minima + start).tolist() == found.minima[inside].tolist()
    np.testing.assert_allclose(part.prominence, found.prominence[inside], rtol=1e-6)
    np.testing.assert_allclose(part.curve, found.curve[start : stop - 1], rtol=1e-6)


@pytest.mark.parametrize("shape", [(0, 3), (5, 2), (3,), (2, 5, 3)])
def test_rows_of_another_shape(shape: tuple[int, ...]) -> None:
    with raises_message(UsageError, "rows"):
        KeyMotion.from_rows(np.zeros(shape))


def test_columns() -> None:
    columns = Lodge().columns
    assert columns.labels == ("speed", "minimum", "prominence")
    assert columns.mirror.permutation == (0, 1, 2)
    assert set(columns.mirror.signs) == {1}


@pytest.mark.parametrize("sigma", [0, -1, math.nan, math.inf])
def test_bad_sigma(sigma: float) -> None:
    with raises_message(UsageError, "sigma_frames"):
        Lodge(sigma_frames=sigma)


# Lodge's joints come from rest positions with more than the five decimals that are published.
REST_DECIMALS = 3e-5


@pytest.mark.parametrize("track", ["001", "004", "063"])
def test_joints_are_lodges(peers: Any, track: str) -> None:
    golden = peers.load("lodge_fk55.npz")
    tracks = peers.load("lodge_mofea319.npz")
    places, rows = tracks.rows(track, 0, 300)
    rows = rows[np.isin(places, golden.index(f"{track}.fk139"))]
    assert len(rows) >= 20
    for width in (139, 319):
        # Hands are ignored.
        window = np.pad(rows, ((0, 0), (0, 319 - rows.shape[1])))[:, :width]
        assert np.abs(joints_of(window) - golden[f"{track}.fk139"]).max() <= REST_DECIMALS


def test_minima_found_in_columns_are_the_clips(dance, columns) -> None:
    motion = dance(400)
    found = KeyMotion.from_rows(Lodge().analyse(motion))
    again = key_motion(joints_of(columns(motion)))
    assert again.minima.tolist() == found.minima.tolist()
    np.testing.assert_allclose(again.prominence, found.prominence, atol=1e-7)


def test_other_bodies_of_the_family(dance) -> None:
    motion = dance(200, skeleton=SMPL24)
    np.testing.assert_array_equal(Lodge().analyse(motion), Lodge().analyse(transfer(motion, SMPLX22)))


def test_frames_before_the_trim_are_looked_at(dance) -> None:
    motion = dance(200)
    trimmed = Motion(motion.translation, motion.rotations, motion.grid, motion.skeleton, trim_start=90)
    np.testing.assert_array_equal(Lodge().analyse(trimmed), Lodge().analyse(motion))


def test_another_family_is_refused() -> None:
    odd = Skeleton("odd", ("root", "tail"), (-1, 0), np.zeros((2, 3)), (), (0, 0, 1, 1))
    motion = Motion(np.zeros((5, 3)), np.zeros((5, 2, 3)), FrameGrid.of(30), odd)
    with raises_message(UsageError, "smplx22"):
        Lodge().analyse(motion)


def test_columns_that_are_not_rotations(dance, columns) -> None:
    window = columns(dance(60))
    scaled = window * 0.5
    with raises_message(DataError, "rotation", where="primitives, frame 0, pelvis", reason="bad_rotation"):
        joints_of(scaled)
    parallel = window.copy()
    parallel[7, 10:13] = parallel[7, 7:10]
    with raises_message(DataError, "rotation", where="primitives, frame 7, pelvis"):
        joints_of(parallel)
    window[5, 30] = np.nan
    with raises_message(DataError, "infinity", where="primitives", reason="nan"):
        joints_of(window)


@pytest.mark.parametrize("shape", [(60, 151), (60, 138), (139,)])
def test_columns_of_another_representation(shape: tuple[int, ...]) -> None:
    with raises_message(UsageError, "minima"):
        joints_of(np.zeros(shape))


# ---- the code of the page


PAGE = Path(__file__).parents[2] / "docs" / "reference" / "columns.md"


def test_code_of_the_page_runs(tmp_path: Path) -> None:
    recipe = {
        "recipe": 1, "name": "page", "windows": {"length_frames": 1024, "stride_frames": 102}, "fps": 30,
        "dataset": {"synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 36, "split": "all"}},
        "motion": {"lodge139": {}}, "audio": {"librosa35": {}}, "keymotion": {"lodge": {}},
    }  # fmt: skip
    build(parse_recipe(recipe), tmp_path / "source", tmp_path / "out", jobs=1, cache=tmp_path / "cache")
    text = PAGE.read_text(encoding="utf-8").replace('windows("train"', 'windows("all"')
    blocks = re.findall(r"```python\n(.*?)```", text.split("## Key motions")[1], flags=re.DOTALL)
    assert len(blocks) >= 2
    names: dict[str, object] = {"OUT": tmp_path / "out"}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    cues, window = names["cues"], names["motion"]
    assert cues.frames.shape == (13, 8, 139)
    assert np.shares_memory(cues.frames, window) is False
    assert not cues.filled.all()
    assert (names["relative"][1:, 0][:, [4, 6]] == 0).all()
