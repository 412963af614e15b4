"""humanml264 both ways against InfiniteDance's code: every key of its reference outputs, and the sign of the turn."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.grid import FrameGrid
from dancedata.representations import _humanml as humanml
from dancedata.representations.humanml263 import HUMANML22
from dancedata.representations.humanml264 import Humanml264, with_root_angle

MADE = Humanml264()
CLIPS = ("video_0001", "my clip 2 (live)", "gBR_sBM_cAll_d04_mBR0_ch02")
#: The clip whose facing passes -z: InfiniteDance's sign slip, in this row of its turn.
TURNED, SLIP = "my clip 2 (live)", 42
#: Columns of its 266 that are our 264; the others are the root's x and z.
KEPT = [1, *range(3, 266)]
#: Bounds of the difference, as its README states them: its inverse kinematics are in float32.
TOLERANCE, TOLERANCE_6D = 1e-5, 2e-5


@pytest.fixture(scope="module")
def arrays(crowd: Path) -> dict[str, np.ndarray]:
    with np.load(crowd / "infinitedance" / "columns266.npz") as file:
        return {key: file[key] for key in file.files}


@pytest.fixture(scope="module")
def facts(crowd: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((crowd / "infinitedance" / "facts.json").read_text())
    return document


def joints_of(crowd: Path, clip: str) -> np.ndarray:
    joints = np.load(crowd / "inputs" / "infinitedance" / "joints" / f"{clip}.npy")
    return joints.astype(np.float64)


def group(name: str) -> slice:
    return MADE.columns.slice(name)


def test_every_key_is_compared(arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
    made = {f"{clip}.{what}" for clip in CLIPS for what in ("266", "recovered264")}
    assert set(arrays) == made | {"target_offsets", "raw_offsets"}
    assert set(facts["clips"]) == set(CLIPS)
    assert facts["rule_264"] == "columns 1 and 3..265 of the 266"


def test_its_skeleton(arrays: dict[str, np.ndarray]) -> None:
    """Our bones have the directions of SMPL at rest, its directions are axes: only lengths are the target's."""
    np.testing.assert_array_equal(arrays["raw_offsets"], humanml._REST)
    lengths = np.linalg.norm(arrays["target_offsets"], axis=-1)
    np.testing.assert_allclose(humanml.BONE_LENGTHS, lengths, rtol=0, atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(HUMANML22.offsets[1:], axis=-1), lengths[1:], rtol=0, atol=2e-6)


@pytest.mark.parametrize("clip", CLIPS)
def test_its_columns(crowd: Path, arrays: dict[str, np.ndarray], facts: dict[str, Any], clip: str) -> None:
    its, about = arrays[f"{clip}.266"], facts["clips"][clip]
    expected = its[:, KEPT]
    array = with_root_angle(humanml.columns_of(humanml.retargeted(joints_of(crowd, clip))))
    assert (len(array), len(its)) == (about["frames"], about["rows"]), "our last row is the one that it lacks"
    for name in MADE.columns.names:
        bound = TOLERANCE_6D if name == "rotation_6d_columns" else TOLERANCE
        np.testing.assert_allclose(
            array[:-1, group(name)], expected[:, group(name)], rtol=0, atol=bound, err_msg=name
        )
    contacts = group("foot_contact")
    np.testing.assert_array_equal(array[:-1, contacts], expected[:, contacts])
    assert array[:-1, contacts].mean() == pytest.approx(about["contact_rate"], abs=1e-6)
    # The root's x and z, which the 264 lack, follow from the others.
    np.testing.assert_allclose(MADE.positions(array)[:-1, 0][:, [0, 2]], its[:, [0, 2]], rtol=0, atol=TOLERANCE)
    # Its last running angle; twice that is the turn.
    assert array[-2, group("root_angle")] == pytest.approx(about["total_yaw_turn"], abs=TOLERANCE)


@pytest.mark.parametrize("clip", CLIPS)
def test_its_joints_of_the_columns(arrays: dict[str, np.ndarray], clip: str) -> None:
    columns = arrays[f"{clip}.266"][:, KEPT]
    recovered = arrays[f"{clip}.recovered264"]
    np.testing.assert_allclose(MADE.positions(columns), recovered, rtol=0, atol=TOLERANCE)
    decoded = MADE.decode(columns, FrameGrid.of(30))
    np.testing.assert_allclose(decoded.joints(), recovered, rtol=0, atol=TOLERANCE)
    # What its code does not read either: the running angle, rotations, velocities, contacts.
    for name in ("root_angle", "rotation_6d_columns", "local_velocity", "foot_contact"):
        columns[:, group(name)] = 7
    np.testing.assert_array_equal(MADE.decode(columns, FrameGrid.of(30)).joints(), decoded.joints())


@pytest.mark.parametrize("clip", CLIPS)
def test_the_sign_of_the_turn_past_minus_z(crowd, arrays, facts, clip):
    """The root's quaternion changes sign there, so that one row turns the wrong way: all rows after it are turned."""
    about = facts["clips"][clip]
    array = with_root_angle(humanml.columns_of(humanml.retargeted(joints_of(crowd, clip))))[:-1]
    turns = np.sign(array[:, group("root_turn")][:, 0])
    lone = 1 + np.flatnonzero((turns[1:-1] != turns[:-2]) & (turns[1:-1] != turns[2:]))
    assert lone.tolist() == about["lone_sign_changes_of_yaw_velocity"] == ([SLIP] if clip == TURNED else [])
    on_floor = humanml.retargeted(joints_of(crowd, clip))[:-1]
    off = np.abs(MADE.positions(array) - on_floor).max(axis=(1, 2))
    wrong = np.flatnonzero(off > 1e-4)
    first = about["first_row_recovered_wrong"]
    assert (wrong[0] if len(wrong) else None) == first == (SLIP + 1 if clip == TURNED else None)
    assert off.max() == pytest.approx(about["recovered_against_ground_positions_max"], abs=TOLERANCE)
    if clip == TURNED:
        # With the sign of its neighbours the row turns as the dancer does.
        right = array.copy()
        right[SLIP, group("root_turn")] *= -1
        np.testing.assert_allclose(MADE.positions(right), on_floor, rtol=0, atol=TOLERANCE)
