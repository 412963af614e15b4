"""The plug-in: Lodge's joints, whole clips, other bodies."""

import math
from typing import Any

import numpy as np
import pytest

from dancedata.core.bodies import SMPLX22, transfer
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.keymotion.characteristic_primitives import joints_of
from dancedata.keymotion.lodge import Lodge
from dancedata.metrics.key_motion import KeyMotion, key_motion
from tests.messages import raises_message


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
