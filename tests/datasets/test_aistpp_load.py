"""The dataset reader aist++: one motion pickle, good or bad in every known way."""

import pickle
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError
from dancedata.datasets.aistpp import AistPP
from tests.datasets.scans import TRAIN
from tests.messages import raises_message


def load(path: Path) -> Any:
    return AistPP().load(ClipRef(id=TRAIN, motion_path=path, audio_path=None, split="train"))


def test_motion_is_canonical(official: Any) -> None:
    path = official.root / "motions" / f"{TRAIN}.pkl"
    motion = load(path)
    raw = official.content()
    assert motion.grid.rate == Fraction(60)
    assert motion.skeleton.name == "SMPL24" or len(motion.skeleton.joints) == 24
    assert motion.rotations.dtype == motion.translation.dtype == np.float64
    assert np.array_equal(motion.rotations, raw["smpl_poses"].astype(np.float64).reshape(-1, 24, 3))
    assert np.array_equal(motion.translation, raw["smpl_trans"].astype(np.float64) / 93.75)
    assert not motion.rotations.flags.writeable


@pytest.mark.parametrize("scaling", [93.75, np.float32(93.75), np.array(93.75), np.array([[93.75]]), [93.75]])
def test_other_forms_of_the_same_motion(official: Any, scaling: Any) -> None:
    poses = official.content()["smpl_poses"].reshape(-1, 24, 3)
    path = official.motion("x", smpl_poses=poses, smpl_scaling=scaling, smpl_loss=None, extra=["kept", 1])
    reference = load(official.root / "motions" / f"{TRAIN}.pkl")
    assert np.array_equal(load(path).rotations, reference.rotations)
    assert np.array_equal(load(path).translation, reference.translation)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"smpl_scaling": None}, "missing_key"),
        ({"smpl_poses": "text"}, "bad_shape"),
        ({"smpl_poses": [[1.0], [1.0, 2.0]]}, "bad_shape"),
        ({"smpl_poses": np.zeros((90, 72), complex)}, "bad_shape"),
        ({"smpl_scaling": np.zeros(1)}, "bad_scaling"),
        ({"smpl_scaling": np.array([-90.0])}, "bad_scaling"),
        ({"smpl_scaling": np.array([np.nan])}, "bad_scaling"),
        ({"smpl_scaling": np.array([1e-320])}, "bad_scaling"),
        ({"smpl_scaling": np.ones(2)}, "bad_shape"),
    ],
)
def test_bad_content(official: Any, changes: dict[str, Any], reason: str) -> None:
    path = official.motion("bad one ü", **changes)
    with raises_message(DataError, "floats|frames|smpl_poses|smpl_scaling|smpl_trans", reason=reason):
        load(path)


@pytest.mark.parametrize("content", [[1, 2], None, np.zeros((3, 72))])
def test_pickle_of_something_else(official: Any, content: Any) -> None:
    path = official.write("motions/other.pkl", pickle.dumps(content))
    with raises_message(DataError, "smpl_scaling", where="мой dänce 舞/motions/other.pkl", reason="broken_file"):
        load(path)
