"""Numpy's files that hold a dict, a table or people as an array of objects."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError
from dancedata.core.motion import Motion
from dancedata.datasets.folder import Folder
from tests.messages import raises_message

T = 60
POSES = np.random.default_rng(0).normal(0, 0.2, (T, 72))
DANCER = {"poses": POSES, "trans": np.linspace((0, 1, 0), (1, 1, 0), T)}
ROMP = {"smpl_thetas": POSES, "cam_trans": DANCER["trans"], "center_preds": np.zeros((T, 2))}


def boxed(*values: Any) -> Any:
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array


def load(path: Path, person: str = "", **options: Any) -> Motion:
    declared = (("person", person),) if person else ()
    ref = ClipRef("a", path, None, "train", declared=declared)
    return Folder(fps=30, up="y", unit="m", music="optional", **options).load(ref)


@pytest.mark.parametrize(
    ("name", "content", "person"),
    [
        ("a.npy", DANCER, ""), ("a.npy", boxed(DANCER), ""), ("a.npy", boxed(DANCER).reshape(1, 1), ""),
        ("a.npy", boxed(DANCER, DANCER), "1"), ("a.npz", {"results": DANCER}, ""),
        ("a.npz", {"results": boxed(DANCER), "fps": 30}, ""), ("a.npz", {"anna": DANCER, "ben": DANCER}, "ben"),
        ("a.npz", {**DANCER, "labels": {"poses": "other"}}, ""), ("a.pkl", boxed(DANCER), ""),
        ("a.pkl", [DANCER, DANCER], "0"), ("a.pkl", {**DANCER, "poses": POSES.astype(object)}, ""),
        ("a.npy", {**DANCER, "trans": DANCER["trans"].astype(object)}, ""),
    ],
)  # fmt: skip
def test_dicts_in_arrays_of_objects_are_read(tmp_path: Path, name: str, content: Any, person: str) -> None:
    path = tmp_path / name
    if name.endswith(".npy"):
        np.save(path, content, allow_pickle=True)
    elif name.endswith(".npz"):
        np.savez(path, **content)
    else:
        path.write_bytes(pickle.dumps(content))
    motion = load(path, person)
    np.testing.assert_allclose(motion.rotations.reshape(T, 72), POSES, atol=1e-12)
    np.testing.assert_allclose(motion.translation, DANCER["trans"], atol=1e-12)


def test_arrays_of_an_unknown_dict_are_named_by_keys(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "romp.npz", results=ROMP)  # type: ignore[arg-type]
    with raises_message(DataError, "smpl_thetas.*keys", where="romp.npz", reason="missing_key"):
        load(tmp_path / "romp.npz")
    motion = load(tmp_path / "romp.npz", keys={"rotation": "smpl_thetas", "translation": "cam_trans"})
    np.testing.assert_allclose(motion.rotations.reshape(T, 72), POSES, atol=1e-12)


@pytest.mark.parametrize("content", [boxed(1.0, None, "x"), boxed(POSES[:3], POSES[:2]), {"poses": None}, boxed()])
def test_other_objects_are_named(tmp_path: Path, content: Any) -> None:
    np.save(tmp_path / "a.npy", content, allow_pickle=True)
    np.savez(tmp_path / "a.npz", results=content)
    for name in ("a.npy", "a.npz"):
        with raises_message(DataError, "array", where="") as error:
            load(tmp_path / name)
        assert name in str(error.value)
        assert error.value.reason in ("bad_shape", "missing_key")
