"""lda61 against LDA's code (ListenDenoiseAction 9b0885b), and what its columns lose."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.bodies import MOTORICA21
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.placement import Placement, moved
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.motorica.motion import load_motion, write_recording
from dancedata.representations.lda61 import Lda61
from dancedata.testing.examples import random_motion
from tests.messages import raises_message

THIRTY = FrameGrid.of(30)
MADE = Lda61()
TOES = [MOTORICA21.index(name) for name in ("LeftToeBase", "RightToeBase")]


def take(path: Path, number: int, *, fingers: bool = False) -> np.ndarray:
    """Columns of LDA's take: every fourth frame of 120 per second, from frame 0 or 2."""
    return MADE.encode(load_motion(path, fingers=fingers, start=Fraction(number, 60)).resampled(THIRTY))


def assert_ldas(rows: np.ndarray, expected: np.ndarray) -> None:
    assert rows.dtype == np.float32
    assert rows.shape == expected.shape
    height = np.arange(61) == 57
    np.testing.assert_allclose(rows[:, ~height], expected[:, ~height], rtol=0, atol=1e-5)
    np.testing.assert_allclose(rows[:, height], expected[:, height], rtol=0, atol=1e-4)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lda") / "a.bvh"
    write_recording(path, 3, dance_s=2)
    return path


@pytest.mark.parametrize("number", [0, 1])
def test_columns_are_ldas(number: int, tmp_path: Path, crowd_golden: Any) -> None:
    arrays = crowd_golden("lda")
    path = tmp_path / "a.bvh"
    path.write_bytes(arrays["bvh"].tobytes())
    rows = take(path, number)
    assert_ldas(rows, arrays[f"0{number}"][: len(rows)])
    assert_ldas(MADE.columns.mirror.apply(rows), arrays[f"0{number}_mirrored"][: len(rows)])


def test_whole_recordings_are_ldas(shared: Path) -> None:
    crowd = shared / "golden" / "crowd"
    facts = json.loads((crowd / "motorica" / "facts.json").read_text())
    expected = np.load(crowd / "motorica" / "expmap61.npz")
    rows = {}
    for path in sorted((crowd / "inputs" / "motorica" / "bvh").glob("*.bvh")):
        for number in (0, 1):
            name = f"{path.stem}_0{number}"
            rows[name] = take(path, number, fingers=number == 1)
            rows[f"{name}_mirrored"] = MADE.columns.mirror.apply(rows[name])
    assert {key for key in expected if expected[key].ndim == 2 and "." not in key} == set(rows)
    for name, array in rows.items():
        assert_ldas(array, expected[name])
    # LDA's scaler and first window: cut to the rows of the music, then at both ends.
    cut, shorter = facts["dataset"]["trim_edges"], facts["dataset"]["audio_rows_minus_motion_rows"]
    kept = [rows[name][: len(rows[name]) + min(0, shorter[name])] for name in facts["dataset"]["list"]]
    data = np.concatenate([array[cut:-cut] for array in kept])
    np.testing.assert_allclose(data.mean(axis=0, dtype=float), expected["dataset.out_mean"], atol=1e-4)
    np.testing.assert_allclose(data.std(axis=0, dtype=float), expected["dataset.out_scale"], atol=1e-4)
    window = expected["dataset.window_start0_out"]
    np.testing.assert_allclose(data[: len(window)], window, atol=1e-4)
    # The names of its columns, in their order.
    axes = {"x": "alpha", "y": "beta", "z": "gamma"}
    parts = [label.removeprefix("axis_angle.").split(".") for label in MADE.columns.labels[:57]]
    assert [f"{joint}_{axes[axis]}" for joint, axis in parts] == facts["columns"][:57]
    assert MADE.columns.labels[57:] == ("root_height", "root_way.x", "root_way.z", "root_turn")


def test_decoding_gives_back_joints_from_another_place(recording: Path) -> None:
    motion = load_motion(recording, fingers=False).resampled(THIRTY)
    motion = moved(motion, Placement(2.0, 3.0, -1.0))
    rotations = motion.rotations.copy()
    rotations[:, TOES] = 0.3
    back = MADE.decode(MADE.encode(replace(motion, rotations=rotations)), THIRTY)
    assert back.skeleton is MOTORICA21
    first = motion.part(0, 1).joints()[0, 0]
    np.testing.assert_allclose(back.joints()[0, 0], (0, first[1], 0), atol=1e-6)
    # Hips: -X to the left crossed with up is forward.
    side = Motion(back.translation, back.rotations, THIRTY, MOTORICA21).matrices[0, 0] @ (-1.0, 0, 0)
    assert abs(side[2]) < 1e-6
    assert side[0] < 0
    # The same dance: turned and shifted once, toes at rest.
    angle = -np.arctan2(*(motion.matrices[0, 0] @ (1.0, 0, 0))[[2, 0]])
    wanted = moved(motion, Placement(-angle))
    wanted = replace(wanted, translation=wanted.translation - first * (1, 0, 1))
    kept = [j for j in range(21) if j not in TOES]
    np.testing.assert_allclose(back.joints()[:, kept], wanted.joints()[:, kept], atol=1e-5)
    assert not back.rotations[:, TOES].any()


def test_columns_come_back_from_decoding() -> None:
    rows = MADE.encode(random_motion(MOTORICA21, 40))
    np.testing.assert_allclose(MADE.encode(MADE.decode(rows, THIRTY)), rows, atol=2e-4)
    np.testing.assert_array_equal(rows[0, 60], rows[1, 60])
    assert np.hypot(*rows[0, 58:60]) == pytest.approx(np.hypot(*rows[1, 58:60]), rel=1e-5)
    assert np.abs(rows[:, 60]).max() <= np.pi
    assert np.linalg.norm(rows[:, :57].reshape(40, -1, 3), axis=-1).max() <= np.pi + 1e-6


def test_one_row_has_no_way() -> None:
    rows = MADE.encode(random_motion(MOTORICA21, 1))
    assert not rows[:, 58:].any()
    assert MADE.decode(rows, THIRTY).n_frames == 1


def test_hips_on_their_side_keep_the_last_facing() -> None:
    """LDA's division is by 0 there."""
    rotations = np.zeros((5, 21, 3))
    rotations[:, 0] = (0, 0.4, 0)
    rotations[2, 0] = (0, 0, np.pi / 2)
    rows = MADE.encode(Motion(np.zeros((5, 3)), rotations, THIRTY, MOTORICA21))
    assert np.isfinite(rows).all()
    assert np.abs(rows[:, 60]).max() < 1e-6


def test_the_turn_goes_the_shorter_way() -> None:
    rotations = np.zeros((3, 21, 3))
    rotations[:, 0, 1] = np.radians([170, 179, -172])
    rows = MADE.encode(Motion(np.zeros((3, 3)), rotations, THIRTY, MOTORICA21))
    np.testing.assert_allclose(np.degrees(rows[:, 60]), [9, 9, 9], atol=1e-4)


def test_refusals() -> None:
    with raises_message(UsageError, "lda61"):
        dancedata.encode(random_motion(SMPL24, 2), "lda61")
    with raises_message(UsageError, "lda61"):
        dancedata.decode(np.zeros((2, 60)), "lda61")
    with raises_message(DataError, "infinity", where="lda61", reason="nan"):
        dancedata.decode(np.full((2, 61), np.nan), "lda61")
    with raises_message(UsageError, "loses"):
        from dancedata.core.plugins import SampleField
        from dancedata.core.registry import AUGMENTATIONS

        AUGMENTATIONS.make("noise", {}).check_sample(SampleField("lda61", "motion", MADE.columns, THIRTY, MADE))
