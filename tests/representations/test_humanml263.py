"""humanml263 against HumanML3D's own functions, and its additions.

Gates: 1e-4 for columns, as the original computes inverse kinematics in float32; measured 5e-5 in rotations, 4e-6 in
positions and velocities, 3e-6 in the turn of the root. Contacts are equal. Recovered joints: 1 mm; measured 4e-7 m.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.contacts.velocity import Velocity
from dancedata.core.bodies import SMPLX55
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.placement import Placement, moved, moved_bounds, moved_rows, require_roles
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.aistpp import AistPP
from dancedata.representations import _humanml as humanml
from dancedata.representations.humanml263 import HUMANML22, Humanml263
from dancedata.representations.humanml264 import Humanml264, with_root_angle
from dancedata.testing.examples import mirrored_motion, random_motion
from tests.conftest import DATA, Arrays, unpack
from tests.messages import raises_message

TWENTY = FrameGrid.of(20)
MADE = Humanml263()
CONTACTS = MADE.columns.slice("foot_contact")


def _assert_columns(array: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(array, expected, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(array[:, CONTACTS], expected[:, CONTACTS])


def test_a_clip_of_the_corpus(peers: Any, tmp_path: Path) -> None:
    """From the reader of AIST++ to the columns; the reference's input were joints of the same clip."""
    arrays = Arrays(unpack(DATA / "humanml263", tmp_path) / "golden.npz")
    (name,) = (key for key in arrays if key.endswith(".263"))
    reader = AistPP(split="all")
    ref = next(c for c in reader.scan(peers / "inputs" / "edge_aistpp").clips if name.startswith(c.id))
    motion = reader.load(ref).resampled(TWENTY)
    array = MADE.encode(motion)
    assert array.dtype == np.float32
    _assert_columns(array[:-1], arrays[name])
    np.testing.assert_allclose(MADE.positions(arrays[name]), arrays[f"{name[:-4]}.recovered"], rtol=0, atol=1e-5)


def test_all_clips_and_real_ones(shared: Path) -> None:
    arrays = Arrays(shared / "golden" / "humanml263" / "golden.npz")
    synthetic = Arrays(shared / "golden" / "peers" / "fk_smpl24.npz")
    np.testing.assert_allclose(humanml.BONE_LENGTHS, arrays["target_bone_lengths"], rtol=0, atol=1e-7)
    clips = [key.removesuffix(".263") for key in arrays if key.endswith(".263")]
    assert len(clips) == 10
    for clip in clips:
        own = f"{clip}.joints20" in arrays
        joints = arrays[f"{clip}.joints20"] if own else synthetic[f"{clip}.yup60"][::3, :22]
        array = humanml.columns_of(humanml.retargeted(joints.astype(np.float64)))
        _assert_columns(array[:-1], arrays[f"{clip}.263"])
        # The columns themselves, and ours, give the joints that the original recovers.
        recovered = arrays[f"{clip}.recovered"]
        np.testing.assert_allclose(MADE.positions(arrays[f"{clip}.263"]), recovered, rtol=0, atol=1e-6)
        np.testing.assert_allclose(MADE.positions(array[:-1]), recovered, rtol=0, atol=1e-3)


def _dance(seconds: float = 4.0) -> Motion:
    return random_motion(SMPL24, int(20 * seconds), turn_rad=0.15, step_m=0.01)


@pytest.mark.parametrize("skeleton", [SMPL24, SMPLX55, HUMANML22], ids=lambda s: s.name)
@pytest.mark.parametrize("turn_rad", [0.15, 2.5])
def test_decoding_gives_a_motion_at_these_positions(skeleton: Any, turn_rad: float) -> None:
    array = MADE.encode(random_motion(skeleton, 60, turn_rad=turn_rad, step_m=0.01))
    motion = MADE.decode(array, TWENTY)
    np.testing.assert_allclose(motion.joints(), MADE.positions(array), rtol=0, atol=1e-5)
    assert motion.grid == TWENTY
    assert motion.skeleton.joints == HUMANML22.joints
    assert dancedata.decode(array, "humanml263", fps=20).n_frames == 60


@pytest.mark.parametrize("by", [Placement(3.1, 3, -9), Placement(-1.2), Placement(x_m=0.5)])
def test_columns_do_not_depend_on_place_and_direction(by: Placement) -> None:
    """So yaw and root_offset leave these samples unchanged while they change other fields."""
    motion = _dance()
    wanted = MADE.encode(motion)
    np.testing.assert_allclose(MADE.encode(moved(motion, by)), wanted, rtol=0, atol=1e-5)
    spatial = MADE.spatial
    assert spatial is not None
    require_roles(spatial, MADE.columns)
    np.testing.assert_array_equal(moved_rows(spatial, wanted, MADE.columns, by), wanted)
    low, high = wanted.min(axis=0).astype(float), wanted.max(axis=0).astype(float)
    for bound, covered in zip(
        (low, high), moved_bounds(spatial, low, high, MADE.columns, turns=True, shift_m=1), strict=True
    ):
        np.testing.assert_array_equal(covered, bound)


def test_the_last_row_continues_the_one_before() -> None:
    motion = _dance()
    array = MADE.encode(motion)
    later = np.r_[0:3, 193:263]
    np.testing.assert_array_equal(array[-1, later], array[-2, later])
    assert not np.array_equal(array[-1], array[-2])
    one = MADE.encode(motion.part(0, 1))
    assert one.shape == (1, 263)
    assert not one[0, later[:-4]].any()
    assert one[0, CONTACTS].all()


def test_the_mirror_is_the_reflections_on_a_symmetric_body(monkeypatch: pytest.MonkeyPatch) -> None:
    lengths = np.array(humanml.BONE_LENGTHS)
    for left, right in HUMANML22.pairs:
        lengths[[left, right]] = lengths[[left, right]].mean()
    monkeypatch.setattr(humanml, "BONE_LENGTHS", tuple(lengths))
    symmetric = SMPL24.mirrored().offsets
    body = replace(SMPL24, name="symmetric", offsets=(SMPL24.offsets + symmetric) / 2)
    motion = _dance().on(body)
    for made in (MADE, Humanml264()):
        image = made.columns.mirror.apply(made.encode(motion))  # type: ignore[union-attr]
        np.testing.assert_allclose(image, made.encode(mirrored_motion(motion)), rtol=0, atol=1e-5)


def test_invalid_input_is_refused() -> None:
    with raises_message(UsageError, "contacts"):
        MADE.encode(_dance(), Velocity())
    flat = replace(SMPL24, offsets=np.zeros((24, 3)))
    with raises_message(DataError, "direction", where="humanml263", reason="bad_skeleton"):
        MADE.encode(_dance().on(flat))
    with raises_message(UsageError, "decodes"):
        MADE.decode(np.zeros((3, 262)), TWENTY)
    array = MADE.encode(_dance())
    array[3, 100] = np.nan
    with raises_message(DataError, "infinity", where="humanml263", reason="nan"):
        MADE.decode(array, TWENTY)


def test_infinitedances_columns(crowd_golden: Any) -> None:
    """Its 264 are columns 1 and 3 to 265 of 266; the clip passes half a turn, with the wrong sign in one row."""
    arrays = crowd_golden("infinitedance")
    expected = arrays["columns"][:, [1, *range(3, 266)]]
    columns = humanml.columns_of(humanml.retargeted(arrays["joints"].astype(np.float64)))
    made = Humanml264()
    array = with_root_angle(columns)
    np.testing.assert_allclose(array[:-1], expected, rtol=0, atol=2e-5)
    contacts = made.columns.slice("foot_contact")
    np.testing.assert_array_equal(array[:-1, contacts], expected[:, contacts])
    np.testing.assert_allclose(made.positions(expected), arrays["recovered"], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(made.positions(array), MADE.positions(columns))
