"""The dataset reader folder: motion in .npz, .npy and .pkl, good and bad in every known way."""

import io
import pickle
import struct
import zipfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dancedata.core.bodies import SMPLH52, SMPLX52, SMPLX55
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion, forward_kinematics
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.folder import Folder
from dancedata.formats import arrays as _folder_arrays
from dancedata.formats.stated import UPRIGHT, same_rate
from dancedata.scene.inputs.files import FileClip, FileFormat
from tests.messages import raises_message

Floats = NDArray[np.float64]

N = 50


def load(path: Path, declared: dict[str, str] | None = None, **parameters: Any) -> Motion:
    clip = ClipRef("x", path, None, "train", declared=tuple((declared or {}).items()))
    return Folder(**parameters).load(clip)


def write(path: Path, content: dict[str, Any]) -> Path:
    if path.suffix == ".npz":
        np.savez_compressed(path, **content)
    else:
        path.write_bytes(pickle.dumps(content))
    return path


def standing(joints: int, n: int = N) -> tuple[Floats, Floats]:
    """Poses (n, joints, 3) of a person who stands and sways, and translation, +Y up."""
    rng = np.random.default_rng(4)
    poses = rng.normal(0, 0.1, (n, joints, 3))
    return poses, np.add(rng.normal(0, 0.05, (n, 3)), (0, 1.15, 0))


def z_up(poses: Floats, trans: Floats, skeleton: Skeleton) -> tuple[Floats, Floats]:
    """The same motion in a world with +Z up, as AMASS stores it."""
    turn, root = UPRIGHT["z"].T, skeleton.offsets[0]
    poses = poses.copy()
    poses[:, 0] = (Rotation.from_matrix(turn) * Rotation.from_rotvec(poses[:, 0])).as_rotvec()
    return poses, (trans + root) @ turn.T - root


def height(motion: Motion) -> float:
    return float(np.median(np.ptp(motion.joints()[..., 1], axis=1)))


@pytest.mark.parametrize(
    ("skeleton", "rate_key"), [(SMPLH52, "mocap_framerate"), (SMPLX55, "mocap_frame_rate")], ids=["smplh", "smplx"]
)
@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_amass(tmp_path: Path, skeleton: Skeleton, rate_key: str, suffix: str) -> None:
    poses, trans = standing(skeleton.n_joints)
    turned, moved = z_up(poses, trans, skeleton)
    more = {"betas": np.zeros(16), "gender": np.array("male"), "dmpls": np.zeros((N, 8))}
    content = {"poses": turned.reshape(N, -1), "trans": moved, rate_key: np.array(120.0, np.float32), **more}
    path = write(tmp_path / f"a_poses{suffix}", content)
    motion = load(path)
    assert motion.grid.rate == 120
    assert motion.skeleton.name == skeleton.name
    assert np.allclose(motion.joints(), forward_kinematics(skeleton, poses, trans), atol=1e-9)
    # The same in the file's own axes: nothing but the axes was changed.
    raw = forward_kinematics(skeleton, turned, moved)
    assert np.allclose(motion.joints(), raw @ UPRIGHT["z"].T, atol=1e-9)
    assert 1.2 < height(motion) < 2.2


def test_amass_in_parts_with_additional_objects(tmp_path: Path) -> None:
    """SMPL-X "stageii" files: what is pickled in them is not touched."""
    poses, trans = standing(55)
    turned, moved = z_up(poses, trans, SMPLX55)
    flat = turned.reshape(N, 165)
    path = tmp_path / "a_stageii.npz"
    np.savez(
        path, trans=moved, root_orient=flat[:, :3], pose_body=flat[:, 3:66], pose_jaw=flat[:, 66:69],
        pose_eye=flat[:, 69:75], pose_hand=flat[:, 75:], gender=np.array("neutral"),
        mocap_frame_rate=np.array(59.940059661865234), markers=np.array({"an": "object"}, dtype=object),
    )  # fmt: skip
    motion = load(path)
    assert motion.grid.rate == Fraction(60000, 1001)
    assert motion.skeleton is SMPLX55
    assert np.allclose(motion.joints(), forward_kinematics(SMPLX55, poses, trans), atol=1e-9)


def test_the_manifest_has_the_last_word_on_amass(tmp_path: Path) -> None:
    poses, trans = standing(52)
    path = tmp_path / "a.npz"
    np.savez(path, poses=poses.reshape(N, 156), trans=trans * 100, mocap_framerate=120.0)
    motion = load(path, {"fps": "30000/1001", "up": "y", "unit": "cm"}, fps=50, up="z", unit="mm")
    assert motion.grid.rate == Fraction(30000, 1001)
    assert np.allclose(motion.joints(), forward_kinematics(SMPLH52, poses, trans))
    # Declarations of a recipe apply to files that state nothing.
    poses, trans = z_up(poses, trans, SMPLH52)
    np.savez(path, poses=poses.reshape(N, 156), trans=trans, mocap_framerate=120.0)
    assert load(path, fps=50, up="y", unit="mm").grid.rate == 120
    assert np.allclose(load(path, fps=50, up="y", unit="mm").translation, load(path).translation)


def test_aist_pickles(tmp_path: Path) -> None:
    poses, trans = standing(24)
    path = tmp_path / "a.pkl"
    for shape in ((N, 72), (N, 24, 3)):
        content = {"smpl_poses": poses.reshape(shape), "smpl_trans": trans * 93.5, "smpl_scaling": np.array([93.5])}
        path.write_bytes(pickle.dumps(content))
        motion = load(path, fps=60)
        assert np.allclose(motion.translation, trans)
        assert np.array_equal(motion.rotations, poses)
        assert motion.skeleton is SMPL24


def test_smpl_needs_all_declarations(tmp_path: Path) -> None:
    poses, trans = standing(24)
    path = tmp_path / "a.npz"
    np.savez(path, poses=poses.reshape(N, 72), trans=trans)
    said: dict[str, Any] = {}
    for key, value in (("fps", 60), ("up", "y"), ("unit", "m")):
        with raises_message(DataError, "declare", where="a.npz", reason="undeclared") as error:
            load(path, **said)
        assert f"declare {key}:" in str(error.value).lower()
        rest = {"fps": "Declare up and unit as well", "up": "Declare unit as well"}.get(key)
        assert rest in str(error.value) if rest else "as well" not in str(error.value)
        said[key] = value
    assert np.allclose(load(path, **said).joints(), forward_kinematics(SMPL24, poses, trans))
    with raises_message(DataError, "translation", where="a.npz", reason="undeclared"):
        load(path, **{**said, "unit": "guess"})


def test_smplx_in_parts(tmp_path: Path) -> None:
    poses, trans = standing(55)
    poses[:, 22:25] = 0
    path = tmp_path / "a.npz"
    hands = {"left_hand_pose": poses[:, 25:40].reshape(N, 45), "right_hand_pose": poses[:, 40:].reshape(N, 45)}
    body = {"global_orient": poses[:, :1], "body_pose": poses[:, 1:22], "transl": trans, "fps": np.array([25])}
    parts = body | hands
    np.savez(path, **parts)
    motion = load(path, up="y")
    assert motion.grid.rate == 25
    assert np.allclose(motion.joints(), forward_kinematics(SMPLX55, poses, trans))
    # The body alone, and as SMPL-H.
    np.savez(path, **body)
    assert not load(path, up="y").rotations[:, 22:].any()
    assert load(path, up="y", layout="smplh").skeleton is SMPLH52
    np.savez(path, **{**parts, "left_hand_pose": np.zeros((N, 12))})
    with raises_message(DataError, "left_hand_pose", where="a.npz", reason="bad_shape"):
        load(path, up="y")


def finedance(poses: Floats, trans: Floats) -> Floats:
    rows = Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix()[:, :2].reshape(len(poses), -1)
    return np.concatenate([trans, rows], axis=1)


@pytest.mark.parametrize("dtype", ["f4", "f8", ">f4"])
def test_finedance_arrays(tmp_path: Path, dtype: str) -> None:
    poses, trans = standing(52)
    path = tmp_path / "001.npy"
    np.save(path, finedance(poses, trans).astype(dtype))
    with raises_message(DataError, "declare", where="001.npy", reason="undeclared"):
        load(path)
    motion = load(path, fps=30)
    assert motion.skeleton is SMPLX55
    assert not motion.rotations[:, 22:25].any()
    of = [SMPLX55.index(joint) for joint in SMPLX52.joints]
    assert np.abs(motion.rotations[:, of] - poses).max() < 1e-5
    assert np.abs(motion.translation - trans).max() < 1e-6


POSES, TRANS = (array.reshape(N, -1) for array in standing(24))
GOOD = {"poses": POSES, "trans": TRANS}
NAN = np.where(np.arange(N)[:, None] == 7, np.nan, TRANS)


RATES = (np.nan, [30, 60], "fast", "", ["120", "60"], True)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ({"poses": POSES}, "missing_key"), ({"dance": POSES}, "missing_key"), ({}, "missing_key"),
        ({**GOOD, "poses": POSES[:, :69]}, "bad_shape"), ({**GOOD, "poses": POSES[0]}, "bad_shape"),
        ({**GOOD, "poses": np.float64(1)}, "bad_shape"), ({**GOOD, "poses": POSES.astype(complex)}, "bad_shape"),
        ({**GOOD, "poses": POSES.astype(str)}, "bad_shape"), ({**GOOD, "trans": TRANS[:, :2]}, "bad_shape"),
        ({**GOOD, "trans": TRANS[:-1]}, "length_mismatch"), ({"poses": POSES[:0], "trans": TRANS[:0]}, "empty"),
        ({**GOOD, "trans": NAN}, "nan"), ({**GOOD, "trans": TRANS * 1e200}, "out_of_range"),
        ({**GOOD, "fps": np.array(0)}, "bad_rate"),
        *(({**GOOD, "mocap_framerate": np.array(rate)}, "bad_rate") for rate in RATES),
        ({"smpl_poses": POSES, "smpl_trans": TRANS, "smpl_scaling": np.zeros(1)}, "bad_scaling"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_bad_content(tmp_path: Path, content: dict[str, Any], reason: str, suffix: str) -> None:
    path = write(tmp_path / f"bad ü{suffix}", content)
    declared = {"up": "y", "unit": "m"} | ({} if reason == "bad_rate" else {"fps": "30"})
    with raises_message(DataError, "body_pose|save|trans", reason=reason):
        load(path, declared)


def test_rounded_rates_are_the_same_and_others_are_not() -> None:
    exact = FrameGrid.of("30000/1001")
    assert same_rate(FrameGrid.of("29.97"), exact)
    assert same_rate(None, exact)
    assert not same_rate(FrameGrid.of(30), exact)


@pytest.mark.parametrize(
    ("value", "rate"),
    [
        (np.array("120"), 120), (np.array(["120"]), 120), (np.array([["120"]]), 120), (np.array(b"120.0"), 120),
        (np.array([b"120"]), 120), (np.array(" 60 "), 60), (np.array("59.94"), Fraction(60000, 1001)),
        (np.array("59.94005994"), Fraction(60000, 1001)), (np.array("30000/1001"), Fraction(30000, 1001)),
    ],
    ids=repr,
)  # fmt: skip
def test_rates_as_text(tmp_path: Path, value: Any, rate: Any) -> None:
    np.savez(tmp_path / "a.npz", **GOOD, mocap_framerate=value)
    assert load(tmp_path / "a.npz", {"up": "y", "unit": "m"}).grid.rate == rate
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({**GOOD, "mocap_framerate": value.reshape(-1)[0]}))
    assert load(tmp_path / "a.pkl", {"up": "y", "unit": "m"}).grid.rate == rate
    # Positions, as evaluation reads them.
    joints = forward_kinematics(SMPL24, POSES.reshape(N, 24, 3), TRANS)
    np.savez(tmp_path / "joints.npz", joints=joints, mocap_framerate=value)
    clip = FileClip(id="a", path=tmp_path / "joints.npz", format=FileFormat(up="y"))
    assert clip.load().grid.rate == rate


def test_the_fixes_for_an_invalid_rate(tmp_path: Path) -> None:
    """A rate that is an object or a word: declared in the manifest, or saved again as the message says."""
    for value in (np.array("fast"), np.array(None, dtype=object)):
        np.savez(tmp_path / "a.npz", **GOOD, mocap_framerate=value)
        with pytest.raises(DataError, match=r"Declare fps for this file in the manifest.*=numpy\.array\(120\.0\)"):
            load(tmp_path / "a.npz", {"up": "y", "unit": "m"}, fps=30)
        assert load(tmp_path / "a.npz", {"up": "y", "unit": "m", "fps": "50"}).grid.rate == 50
    np.savez(tmp_path / "a.npz", **GOOD, mocap_framerate=np.array(120.0))
    assert load(tmp_path / "a.npz", {"up": "y", "unit": "m"}).grid.rate == 120


def test_layouts_by_declaration(tmp_path: Path) -> None:
    poses, trans = z_up(*standing(52), SMPLH52)
    np.savez(tmp_path / "a.npz", poses=poses.reshape(N, -1), trans=trans)
    with raises_message(DataError, "camera", where="a.npz", reason="undeclared"):
        load(tmp_path / "a.npz", fps=30)
    amass = load(tmp_path / "a.npz", fps=30, layout="amass")
    assert np.array_equal(amass.joints(), load(tmp_path / "a.npz", fps=30, up="z").joints())
    np.savez(tmp_path / "a.npz", poses=poses.reshape(N, -1), trans=trans, mocap_framerate=60)
    with raises_message(DataError, "camera", where="a.npz", reason="undeclared"):
        load(tmp_path / "a.npz", layout="smplh")
    np.savez(tmp_path / "a.npz", **GOOD)
    with raises_message(DataError, "amass", where="a.npz", reason="bad_declaration"):
        load(tmp_path / "a.npz", {"layout": "amass"}, fps=30, up="y", unit="m")


def npy(header: str, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY" + version + struct.pack("<H", len(text)) + text + data


HEADERS = {
    "absurd": "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 315), }",
    "overflow": "{'descr': '<f8', 'fortran_order': False, 'shape': (0, 1" + "0" * 30 + "), }",
    "negative": "{'descr': '<f8', 'fortran_order': False, 'shape': (-5, 315), }",
    "short": "{'descr': '<f8', 'fortran_order': False, 'shape': (5, 315), }",
    "true": "{'descr': '<f8', 'fortran_order': False, 'shape': (True, 315), }",
    "records": "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (5, 315), }",
    "nested": "(" * 100,
    "code": "__import__('os').system('false')",
}
MADE_UP = {name: npy(header) for name, header in HEADERS.items()} | {
    "longer": npy(HEADERS["short"], bytes(5 * 315 * 8 + 1)),
    "version": npy(HEADERS["short"], bytes(5 * 315 * 8), b"\x09\x09"),
    "long header": npy("(" * 9_999 + " " * 10_000),
    "no array": b"no array at all",
}


@pytest.mark.parametrize("name", MADE_UP)
@pytest.mark.parametrize("packed", [False, True])
def test_headers_made_up_to_hurt(tmp_path: Path, name: str, packed: bool) -> None:
    data = MADE_UP[name]
    path = tmp_path / ("a.npz" if packed else "a.npy")
    if packed:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("poses.npy", data)
            archive.writestr("trans.npy", data)
    else:
        path.write_bytes(data)
    with pytest.raises(DataError) as error:
        load(path, fps=30)
    assert error.value.reason in ("broken_file", "too_large", "bad_shape")


def test_objects_are_not_unpickled(tmp_path: Path, unpickled_marker: Any) -> None:
    marker, attack = unpickled_marker
    bare = npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", attack())
    (tmp_path / "a.npy").write_bytes(bare)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("poses.npy", bare)
        archive.writestr("trans.npy", bare)
    (tmp_path / "a.pkl").write_bytes(attack())
    for suffix in (".npy", ".npz", ".pkl"):
        with raises_message(DataError, "arrays", reason="unsafe_pickle"):
            load(tmp_path / f"a{suffix}", fps=30)
    assert not marker.exists()


def test_lists_in_lists_are_not_unfolded(tmp_path: Path) -> None:
    """Ten lists of ten lists of ... : 10^40 numbers in a few hundred bytes."""
    value: Any = [0.0]
    for _ in range(40):
        value = [value] * 10
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"poses": value, "trans": value}))
    with raises_message(DataError, "floats", where="a.pkl, poses", reason="bad_shape"):
        load(tmp_path / "a.pkl", fps=30)


def test_bombs_are_refused_before_they_are_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_folder_arrays, "BOMB_BYTES", 1 << 16)
    np.savez_compressed(tmp_path / "a.npz", poses=np.zeros((5000, 72)), trans=np.zeros((5000, 3)))
    with raises_message(DataError, "limit", where="a.npz", reason="too_large"):
        load(tmp_path / "a.npz", fps=30, up="y", unit="m")


def test_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_folder_arrays, "MAX_ARRAY_BYTES", 1000)
    monkeypatch.setattr("dancedata.formats.values.MAX_PICKLE_BYTES", 1000)
    monkeypatch.setattr(_folder_arrays, "MAX_MEMBERS", 1)
    np.save(tmp_path / "a.npy", np.zeros((5, 315)))
    np.savez(tmp_path / "a.npz", **GOOD)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(GOOD))
    for suffix in (".npy", ".npz", ".pkl"):
        with raises_message(DataError, "limit", reason="too_large"):
            load(tmp_path / f"a{suffix}", fps=30)


def test_other_ways_to_pack_an_archive(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_LZMA) as archive:
        for name, array in GOOD.items():
            file = io.BytesIO()
            np.save(file, array)
            archive.writestr(f"{name}.npy", file.getvalue())
    with raises_message(DataError, "numpy", where="a.npz", reason="broken_file"):
        load(tmp_path / "a.npz", fps=30)


def _small(suffix: str) -> bytes:
    file = io.BytesIO()
    if suffix == ".npz":
        np.savez_compressed(file, poses=POSES[:3], trans=TRANS[:3], mocap_framerate=np.array(30.0))
    elif suffix == ".npy":
        np.save(file, finedance(*standing(52, 2)))
    else:
        pickle.dump({"smpl_poses": POSES[:3], "smpl_trans": TRANS[:3], "smpl_scaling": np.ones(1)}, file)
    return file.getvalue()


SMALL = {suffix: _small(suffix) for suffix in (".npz", ".npy", ".pkl")}


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    suffix=st.sampled_from(sorted(SMALL)),
    changes=st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=6), st.integers(0, 8)), min_size=1, max_size=4),
    keep=st.one_of(st.just(1.0), st.floats(0, 1)),
)
def test_any_damage_is_a_data_error_or_a_motion(tmp_path, suffix, changes, keep):
    data = SMALL[suffix]
    for where, new, length in changes:
        at = int(where * len(data))
        data = data[:at] + new + data[at + length :]
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data[: int(keep * len(data))])
    try:
        motion = load(path, fps=30, up="y", unit="m")
    except DataError:
        return
    assert motion.n_frames > 0
