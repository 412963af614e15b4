"""The dataset reader finedance: one motion file, good or bad in every known way."""

import io
import pickle
import sys
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dancedata.core.bodies import SMPLX52, SMPLX55
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError
from dancedata.core.rotations import matrix_from_rotvec, rotation_6d
from dancedata.datasets.finedance import FineDance
from tests.messages import raises_message


def load(path: Path, clip: str = "001", **fields: Any) -> Any:
    return FineDance(**fields).load(ClipRef(id=clip, motion_path=path, audio_path=None, split="train"))


def columns_of(motion: Any) -> Any:
    """The file's 315 columns of a motion."""
    rows = rotation_6d(matrix_from_rotvec(motion.rotations[:, [SMPLX55.index(j) for j in SMPLX52.joints]]))
    return np.concatenate([motion.translation, rows.reshape(motion.n_frames, -1)], axis=1)


def header(shape: Any, descr: Any = "<f4") -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": descr, "fortran_order": False, "shape": shape})
    return out.getvalue()


def test_motion_is_canonical(fine: Any) -> None:
    raw = fine.columns()
    motion = load(fine.motion("001"))
    assert motion.grid.rate == Fraction(30)
    assert motion.skeleton is SMPLX55
    assert motion.trim_start == 0
    assert motion.rotations.dtype == motion.translation.dtype == np.float64
    assert not motion.rotations.flags.writeable
    assert np.array_equal(motion.translation, raw[:, :3].astype(np.float64))
    assert not motion.rotations[:, 22:25].any(), "jaw and eyes"
    assert np.abs(columns_of(motion) - raw).max() < 1e-6
    left_index1 = SMPLX55.index("left_index1")
    assert np.abs(rotation_6d(matrix_from_rotvec(motion.rotations[0, left_index1])) - raw[0, 135:141]).max() < 1e-6


@pytest.mark.parametrize("form", [np.float64, np.dtype(">f4"), np.asfortranarray])
def test_other_forms_of_the_same_motion(fine: Any, form: Any) -> None:
    raw = fine.columns()
    array = form(raw) if form is np.asfortranarray else raw.astype(form)
    assert np.array_equal(load(fine.motion("002", array)).rotations, load(fine.motion("001")).rotations)


def test_cut_beginnings(fine: Any) -> None:
    path = fine.motion("004", fine.columns(300))
    assert load(path, "004").trim_start == 240
    assert load(path, "004").n_frames == 300
    assert load(path, "004", trim=False).trim_start == 0
    assert load(path, "010").trim_start == 3
    with raises_message(DataError, "trim", where="мой dänce 舞/motion/004.npy", reason="too_short"):
        load(path, "005")


def test_slightly_off_is_still_a_rotation(fine: Any) -> None:
    raw = fine.columns()
    raw[:, 3:] *= 1.0005
    motion = load(fine.motion("001", raw))
    assert np.abs(columns_of(motion)[:, 3:] * 1.0005 - raw[:, 3:]).max() < 1e-6


def test_bones_of_a_body_model(fine: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def body_model_skeleton(path: Path) -> Any:
        asked.append(path)
        return SMPLX55.with_root_offset("smplx55:12345678", (0.0, 1.0, 0.0))

    name = "dancedata.formats.body_model"
    monkeypatch.setitem(sys.modules, name, SimpleNamespace(body_model_skeleton=body_model_skeleton))  # type: ignore[arg-type]
    model = fine.root / "models" / "SMPLX_NEUTRAL.npz"
    path = fine.motion("150")
    assert load(path, body_model=model).skeleton.name == "smplx55:12345678"
    assert np.array_equal(load(path, body_model=model).rotations, load(path).rotations)
    scan = FineDance(labels="optional", body_model=model).scan(fine.root)
    assert scan.notes[-2] == "Bones: of the body model SMPLX_NEUTRAL.npz (smplx55:12345678)."
    assert set(asked) == {model}


@pytest.mark.parametrize(
    ("array", "reason"),
    [
        (np.zeros((90, 319), np.float32), "bad_shape"), (np.zeros((315, 90)), "bad_shape"),
        (np.float32(1), "bad_shape"), (np.zeros((90, 315), complex), "bad_shape"),
        (np.array([{"a": 1}]), "bad_shape"), (np.zeros((90, 315), np.float32), "bad_rotation"),
    ],
)  # fmt: skip
def test_bad_arrays(fine: Any, array: Any, reason: str) -> None:
    with raises_message(DataError, "download|floats|objects", reason=reason):
        load(fine.motion("bad one ü", array))


def test_one_bad_value(fine: Any) -> None:
    raw = fine.columns()
    raw[17, 200] = np.nan
    with raises_message(DataError, "finite", where="001.npy, frame 17, column 200", reason="nan"):
        load(fine.motion("001", raw))


def test_one_bad_rotation_is_named(fine: Any) -> None:
    raw = fine.columns()
    raw[17, 3 + 6 * 22 : 3 + 6 * 22 + 6] = [2, 0, 0, 0, 1e30, 0]
    with raises_message(DataError, "normalise", where="001.npy, frame 17, joint left_index1", reason="bad_rotation"):
        load(fine.motion("001", raw))


def test_columns_in_place_of_rows_are_recognised(fine: Any) -> None:
    raw = fine.columns()
    # (c0, c1) flattened row by row, from two rows that are taken for columns.
    raw[:, 3:] = raw[:, 3:].reshape(-1, 2, 3).swapaxes(1, 2).reshape(90, 312)
    with raises_message(DataError, "flattened", where="001.npy, frame 0, joint pelvis", reason="bad_rotation"):
        load(fine.motion("001", raw))


GOOD = header((90, 315)) + bytes(90 * 315 * 4)


@pytest.mark.parametrize(
    "data",
    [
        b"", b"no array at all", GOOD[:4], GOOD[:40], GOOD[:-1], GOOD + b"\0", b"\x93NUMPY\x09\x09" + GOOD[8:],
        b"\x93NUMPY\x01\x00\xff\xff" + GOOD[10:], header((10**12, 315)), header((2**62, 2**62)), header((-1, 315)),
        header((90, 315), [("a", "<f4")])[:80], b"\x93NUMPY\x01\x00\x76\x00" + b"[" * 117 + b"\n",
        b"\x93NUMPY\x01\x00\x10\x27" + b"(" * 9_999 + b"\n", pickle.dumps(np.zeros((90, 315))),
    ],
)  # fmt: skip
def test_broken_files(fine: Any, data: bytes) -> None:
    path = fine.write("motion/001.npy", data)
    with raises_message(DataError, "", reason="broken_file") as error:
        load(path)
    assert "001.npy" in str(error.value)


@pytest.mark.parametrize("bare", [True, False])
def test_hostile_pickle_is_not_executed(fine: Any, unpickled_marker: Any, bare: bool) -> None:
    marker, attack = unpickled_marker
    path = fine.write("motion/001.npy", attack() if bare else header((1,), "|O") + attack())
    with raises_message(DataError, "", reason="broken_file" if bare else "unsafe_pickle"):
        load(path)
    assert not marker.exists()
