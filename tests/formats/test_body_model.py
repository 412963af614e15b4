"""Skeletons from a user's body model: the published joints through both doors, betas, genders, what is refused."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.bodies import SMPLH52, SMPLX52, SMPLX55
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.folder import Folder
from dancedata.formats.body_model import body_model_skeleton, find_model, gender_of
from tests.body_models import body_model, body_model_arrays
from tests.messages import raises_message
from tests.video_files import smpl_pickle

N = 20


def model(path: Path, skeleton: Skeleton, *, taller: float = 0.0, **changes: Any) -> Path:
    """Write a small model in the published layout, whose first two betas are height and width."""
    vertices = body_model_arrays(skeleton)["v_template"] * (1 + taller)
    directions = np.zeros((*vertices.shape, 20))
    directions[:, 1, 0] = 0.1 * vertices[:, 1]
    directions[:, 0, 1] = 0.1 * vertices[:, 0]
    directions[..., 10:] = 7.0  # the face's: of no effect on the body
    return body_model(path, skeleton, **{"v_template": vertices, "shapedirs": directions, **changes})


def test_neutral_is_the_same_through_both_doors(tmp_path: Path) -> None:
    path = model(tmp_path / "SMPLX_NEUTRAL.npz", SMPLX55)
    rng = np.random.default_rng(0)
    poses, trans = rng.normal(0, 0.3, (N, 165)), rng.normal(0, 1, (N, 3))
    file = tmp_path / "a.npz"
    np.savez(file, poses=poses, trans=trans, mocap_frame_rate=60.0, gender="neutral", betas=np.zeros(10))
    default, own = load(file), load(file, body_model=path)
    assert np.abs(default.joints() - own.joints()).max() < 1e-5
    assert np.array_equal(default.rotations, own.rotations)
    assert own.skeleton.name.startswith("smplx55:")
    assert np.abs(own.skeleton.offsets - SMPLX55.offsets).max() < 1e-9


def load(path: Path, declared: dict[str, str] | None = None, **parameters: Any) -> Motion:
    clip = ClipRef("x", path, None, "train", declared=tuple((declared or {}).items()))
    return Folder(**parameters).load(clip)


def test_parts_and_betas(tmp_path: Path) -> None:
    path = model(tmp_path / "m.npz", SMPLX55)
    part = body_model_skeleton(path, joints=SMPLX52)
    assert part.joints == SMPLX52.joints
    assert np.abs(part.offsets - SMPLX52.offsets).max() < 1e-9
    assert part.name.startswith("smplx52:")
    tall = body_model_skeleton(path, betas=[2.0])
    assert np.allclose(tall.offsets[:, 1], SMPLX55.offsets[:, 1] * 1.2)
    assert np.allclose(tall.offsets[:, [0, 2]], SMPLX55.offsets[:, [0, 2]])
    assert tall.name != body_model_skeleton(path).name == body_model_skeleton(path, betas=np.zeros(300)).name


@pytest.mark.parametrize(
    ("file", "skeleton", "width"),
    [
        ("SMPLX_MALE.npz", SMPLX55, 165), ("smplx/SMPLX_MALE.npz", SMPLX55, 165),
        ("smplh/male/model.npz", SMPLH52, 156), ("SMPLH_MALE.npz", SMPLH52, 156), ("smpl/SMPL_MALE.npz", SMPL24, 72),
    ],
)  # fmt: skip
def test_folders_of_models(tmp_path: Path, file: str, skeleton: Skeleton, width: int) -> None:
    model(tmp_path / "models" / file, skeleton, taller=0.1)
    model(tmp_path / "models" / file.replace("MALE", "NEUTRAL").replace("male", "neutral"), skeleton)
    motion = tmp_path / "a.npz"
    content = {"poses": np.zeros((N, width)), "trans": np.zeros((N, 3)), "betas": np.zeros(10)}
    np.savez(motion, **content, gender="male", mocap_framerate=60)
    given = {"body_model": tmp_path / "models", "up": "y", "unit": "m"}
    assert np.allclose(load(motion, **given).skeleton.offsets, skeleton.offsets * 1.1)
    assert np.allclose(load(motion, {"gender": "neutral"}, **given).skeleton.offsets, skeleton.offsets)
    np.savez(motion, **content, gender="female", mocap_framerate=60)
    with raises_message(DataError, "body_model", where="a.npz", reason="bad_body_model"):
        load(motion, **given)


def test_betas_of_the_file_are_used_and_those_of_another_gender_are_not_believed(tmp_path: Path) -> None:
    path = model(tmp_path / "SMPLX_NEUTRAL.npz", SMPLX55)
    motion = tmp_path / "a.npz"
    content = {"poses": np.zeros((N, 165)), "trans": np.zeros((N, 3)), "mocap_framerate": 60, "gender": "neutral"}
    betas = np.zeros(16)
    betas[0] = 1.0
    for given in (betas, betas[:10], np.tile(betas, (N, 1))):
        np.savez(motion, betas=given, **content)
        assert np.allclose(load(motion, body_model=path).skeleton.offsets[:, 1], SMPLX55.offsets[:, 1] * 1.1)
    np.savez(motion, betas=np.arange(2 * N).reshape(N, 2), **content)
    with raises_message(DataError, "describe", where="a.npz"):
        load(motion, body_model=path)
    np.savez(motion, betas=np.ones(16), **content)
    with raises_message(DataError, "body_model", where="a.npz", reason="bad_body_model"):
        load(motion, body_model=path)
    np.savez(motion, betas=np.ones(10), **{**content, "gender": "female"})
    with raises_message(DataError, "genders", where="a.npz", reason="bad_declaration"):
        load(motion, body_model=path)
    assert load(motion, {"gender": "neutral"}, body_model=path).n_frames == N


def test_a_model_of_another_body(tmp_path: Path) -> None:
    path = model(tmp_path / "SMPLX_NEUTRAL.npz", SMPLX55)
    with raises_message(UsageError, "smpl24", where="SMPLX_NEUTRAL.npz"):
        body_model_skeleton(path, joints=SMPL24)
    with raises_message(UsageError, "body_model", where="b.npz"):
        body_model_skeleton(model(tmp_path / "b.npz", SMPLX55, J_regressor=np.zeros((22, 648))))


@pytest.mark.parametrize(
    "changes",
    [
        {"J_regressor": None}, {"v_template": np.zeros((7, 3))}, {"shapedirs": np.zeros((648, 3))},
        {"v_template": np.full((648, 3), np.nan)}, {"kintree_table": np.zeros((2, 55))},
        {"J_regressor": np.array({"sparse": 1}, dtype=object)},
    ],
)  # fmt: skip
def test_files_that_are_not_a_model(tmp_path: Path, changes: dict[str, Any]) -> None:
    with raises_message(UsageError, "body_model", where="m.npz"):
        body_model_skeleton(model(tmp_path / "m.npz", SMPLX55, **changes))


def model_arrays(tmp_path: Path, skeleton: Skeleton) -> dict[str, Any]:
    with np.load(model(tmp_path / "plain.npz", skeleton)) as arrays:
        return dict(arrays)


@pytest.mark.parametrize("protocol", [0, 1, 2, 4])
@pytest.mark.parametrize("skeleton", [SMPL24, SMPLX55], ids=lambda s: s.name)
def test_published_pickles_give_the_same_body_as_npz(tmp_path: Path, skeleton: Skeleton, protocol: int) -> None:
    arrays = model_arrays(tmp_path, skeleton)
    pickled = tmp_path / "SMPL_NEUTRAL.pkl"
    pickled.write_bytes(smpl_pickle({**arrays, "weights": np.ones((2, 3))}, ("shapedirs", "v_template"), protocol))
    betas = [0.5, -1.0]
    found = body_model_skeleton(pickled, joints=skeleton, betas=betas)
    plain = body_model_skeleton(tmp_path / "plain.npz", joints=skeleton, betas=betas)
    assert found.name == plain.name
    np.testing.assert_allclose(found.offsets, plain.offsets, atol=1e-12)
    assert "chumpy" not in sys.modules


def test_published_names_in_a_folder(tmp_path: Path) -> None:
    arrays = model_arrays(tmp_path, SMPL24)
    names = {"neutral": "basicModel_neutral_lbs_10_207_0_v1.0.0", "male": "basicmodel_m_lbs_10_207_0_v1.1.0"}
    for taller, (gender, name) in enumerate(names.items()):
        folder = tmp_path / "smpl" / "models"
        folder.mkdir(parents=True, exist_ok=True)
        arrays["v_template"] = arrays["v_template"] * (1 + taller)
        (folder / f"{name}.pkl").write_bytes(smpl_pickle(arrays))
        assert find_model(tmp_path / "smpl", joints=SMPL24, gender=gender).stem == name
        assert gender_of(folder / f"{name}.pkl") == gender
    (tmp_path / "smpl" / "SMPL_MALE.npz").write_bytes((tmp_path / "plain.npz").read_bytes())
    assert find_model(tmp_path / "smpl", joints=SMPL24, gender="male").suffix == ".npz"
    with raises_message(UsageError, r"SMPL_FEMALE\.npz", where="smpl"):
        find_model(tmp_path / "smpl", joints=SMPL24, gender="female")


def test_planted_code_in_a_model_does_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    data = smpl_pickle(model_arrays(tmp_path, SMPL24))
    for code in (b"cos\nsystem\n(S'touch PWNED'\ntR", b"cchumpy.ch\nCh\n(S'x'\ntR", b"cchumpy.ch\nMatVecMult\n)\x81"):
        Path("SMPL_NEUTRAL.pkl").write_bytes(data[:-1].removesuffix(b"u") + b"X\x01\x00\x00\x00z" + code + b"u.")
        with raises_message(UsageError, "refers", where="SMPL_NEUTRAL.pkl"):
            body_model_skeleton(Path("SMPL_NEUTRAL.pkl"), joints=SMPL24)
    assert not Path("PWNED").exists()


@pytest.mark.parametrize(
    "change",
    [
        {"_shape": (24, 2**29)}, {"_shape": (3, 4)}, {"_shape": (24.0, 276)}, {"indices": np.arange(192) + 1000},
        {"indices": np.zeros(192)}, {"indptr": np.arange(277)[::-1].astype(np.int32)}, {"data": "text"},
    ],
    ids=lambda change: next(iter(change)),
)  # fmt: skip
def test_sparse_matrices_that_contradict_themselves(tmp_path: Path, change: dict[str, Any]) -> None:
    arrays = model_arrays(tmp_path, SMPL24)
    (tmp_path / "SMPL_NEUTRAL.pkl").write_bytes(smpl_pickle(arrays, regressor=change))
    with pytest.raises(UsageError, match="J_regressor is not an array as csc_matrix holds it"):
        body_model_skeleton(tmp_path / "SMPL_NEUTRAL.pkl", joints=SMPL24)


def test_no_model(tmp_path: Path) -> None:
    for path in (tmp_path / "gone.npz", tmp_path):
        with raises_message(UsageError, "body_model"):
            body_model_skeleton(path)
    with raises_message(UsageError, "gender"):
        body_model_skeleton(tmp_path, gender="any")
    (tmp_path / "source").mkdir()
    np.save(tmp_path / "source" / "a.npy", np.zeros((3, 315)))
    with raises_message(SourceError, "correct", where="gone.npz"):
        Folder(body_model=tmp_path / "gone.npz", music="optional").scan(tmp_path / "source")
