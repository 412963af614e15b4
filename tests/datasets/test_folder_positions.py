"""Joint positions as input: of any skeleton, fitted and flagged; Motion-X's, HumanML3D's and MDM's files."""

import pickle
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.bodies import MOTORICA21, SMPLX55, transfer_to
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.quality import implausible_flags
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.aistpp import AistPP
from dancedata.datasets.folder import Folder
from dancedata.datasets.folder.positions import JOINT_SETS
from dancedata.formats.motion_files import motion_file
from dancedata.representations.humanml263 import Humanml263
from dancedata.scene.inputs.files import FileClip, FileFormat, clips_of
from dancedata.synthetic import synthesise_motion
from tests.commands import run
from tests.datasets import scans
from tests.messages import raises_message

N = 200
#: SMPL's joints by the names of three other programs.
MIXAMO = {
    "pelvis": "Hips", "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase", "collar": "Shoulder",
    "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand", "hand": "HandMiddle1", "neck": "Neck", "head": "Head",
    "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2",
}  # fmt: skip
XSENS = {"pelvis": "Hips", "foot": "Toe", "spine1": "Chest", "spine2": "Chest2", "spine3": "Chest4"}
#: Joints of arms and legs, whose places no set of joints leaves open.
LIMBS = [1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21]


@pytest.fixture(scope="module")
def dance() -> Motion:
    return synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=N)[0]


def renamed(joint: str, names: dict[str, str], prefix: str = "") -> str:
    side, _, bare = joint.rpartition("_")
    return prefix + side.capitalize() + names.get(bare, bare.capitalize())


def load(path: Path, **options: Any) -> Motion:
    folder = Folder(**{"fps": 60, "up": "y", "unit": "m", "music": "optional", **options})
    return folder.load(ClipRef("a", path, None, "train"))


def notes(path: Path, **options: Any) -> str:
    folder = Folder(**{"fps": 60, "up": "y", "unit": "m", "music": "optional", **options})
    (path.parent / "source" / "motions").mkdir(parents=True, exist_ok=True)
    (path.parent / "source" / "motions" / path.name).write_bytes(path.read_bytes())
    return " ".join(folder.scan(path.parent / "source").notes)


def apart(motion: Motion, joints: Any, of: list[int]) -> float:
    return float(np.linalg.norm(motion.joints()[:, of] - joints[:, of], axis=-1).max())


NAMED: dict[str, Callable[[str], str]] = {
    "smpl": lambda joint: joint,
    "SMPL in capitals": lambda joint: renamed(joint, {}),
    "mixamo": lambda joint: renamed(joint, MIXAMO, "mixamorig:"),
    "xsens": lambda joint: renamed(joint, XSENS),
}


@pytest.mark.parametrize(
    ("kind", "key"), [*((kind, "joint_names") for kind in NAMED), ("smpl", "names"), ("smpl", "joints")]
)
def test_positions_of_named_joints(tmp_path: Path, dance: Motion, kind: str, key: str) -> None:
    """In any order, unit and axes, with further joints among them."""
    order = np.random.default_rng(0).permutation(24)
    joints, names = dance.joints(), [NAMED[kind](SMPL24.joints[k]) for k in order]
    points = np.concatenate([joints[:, order], joints[:, :1] + 9], axis=1)
    turned = points @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
    np.savez(tmp_path / "a.npz", positions=turned * 100, **{key: [*names, "Camera"]})
    motion = load(tmp_path / "a.npz", up="z", unit="cm")
    assert apart(motion, joints, [*LIMBS, 0, 12, 15]) < 1e-4
    assert "twists" in notes(tmp_path / "a.npz", up="z", unit="cm")
    (flag,) = [flag for flag in implausible_flags(motion) if flag.kind == "fitted"]
    assert flag.value < 1e-3
    assert implausible_flags(motion) == [flag]


@pytest.mark.parametrize(
    ("name", "tolerance_m"),
    [("smpl", 1e-6), ("smpl22", 1e-6), ("coco17", 0.1), ("body25", 0.05), ("h36m17", 0.05), ("ntu25", 0.05)],
)  # fmt: skip
def test_sets_of_joints(tmp_path: Path, dance: Motion, name: str, tolerance_m: float) -> None:
    order = [SMPL24.index(joint) if joint in SMPL24.joints else 15 for joint in JOINT_SETS[name]]
    np.save(tmp_path / "a.npy", dance.joints()[:, order])
    motion = load(tmp_path / "a.npy", joints=name)
    assert apart(motion, dance.joints(), LIMBS) < tolerance_m
    # Directions of arms and legs are those of the positions, whatever the trunk is.
    for a, b in ((1, 4), (4, 7), (2, 5), (5, 8), (16, 18), (18, 20), (17, 19), (19, 21)):
        bones = [at[:, b] - at[:, a] for at in (motion.joints(), dance.joints())]
        cosine = np.sum(bones[0] * bones[1], axis=-1) / np.prod([np.linalg.norm(x, axis=-1) for x in bones], axis=0)
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.5
    named = [*JOINT_SETS[name]]
    np.testing.assert_array_equal(load(tmp_path / "a.npy", joints=named).rotations, motion.rotations)


def test_positions_of_smplx(tmp_path: Path, dance: Motion) -> None:
    joints = transfer_to(dance, SMPLX55).joints()
    np.savez(tmp_path / "a.npz", full_pose=joints, fps=30)
    motion = load(tmp_path / "a.npz", joints="smplx")
    assert motion.grid.rate == 30
    assert apart(motion, joints, LIMBS) < 1e-6


@pytest.mark.parametrize("count", [22, 24])
@pytest.mark.parametrize("name", ["", "joints", "positions", "keypoints3d_optim", "whatever"])
def test_smpls_order_by_the_proportions_of_the_bones(tmp_path: Path, dance: Motion, count: int, name: str) -> None:
    path, joints = tmp_path / ("a.npz" if name else "a.npy"), dance.joints()[:, :count]
    np.savez(path, **{name: joints}) if name else np.save(path, joints)
    assert apart(load(path), joints, list(range(count))) < 1e-6
    assert "SMPL's order" in notes(path)
    for wrong in (joints[:, ::-1], dance.rotations[:, :count]):
        np.savez(path, **{name: wrong}) if name else np.save(path, wrong)
        with raises_message(DataError, "joint_names", where=path.name, reason="unknown_joints"):
            load(path)


@pytest.mark.parametrize("form", ["pickle", "dict in npy", "torch", "keys"])
def test_positions_in_other_files(tmp_path: Path, dance: Motion, form: str) -> None:
    joints, names = dance.joints().astype(np.float32), [renamed(joint, MIXAMO) for joint in SMPL24.joints]
    content = {"positions": joints, "joint_names": names}
    path, options = tmp_path / "a.pkl", {}
    if form == "pickle":
        path.write_bytes(pickle.dumps(content))
    elif form == "dict in npy":
        path = tmp_path / "a.npy"
        np.save(path, content, allow_pickle=True)  # type: ignore[arg-type]
    elif form == "torch":
        torch, path = pytest.importorskip("torch"), tmp_path / "a.pt"
        torch.save({**content, "positions": torch.from_numpy(joints)}, path)
    else:
        path, options = tmp_path / "a.npz", {"keys": {"positions": "kp"}}
        np.savez(path, kp=joints, velocity=np.zeros((N, 24, 3)), joint_names=names)
    assert apart(load(path, **options), joints, LIMBS) < 1e-4


def test_the_unit_is_guessed_from_the_bones(tmp_path: Path, dance: Motion) -> None:
    np.save(tmp_path / "a.npy", dance.joints() * 1000)
    assert apart(load(tmp_path / "a.npy", unit="guess"), dance.joints(), LIMBS) < 1e-6
    assert "GUESSED" in notes(tmp_path / "a.npy", unit="guess")


def test_a_file_of_export_keeps_its_rotations(tmp_path: Path, dance: Motion) -> None:
    (tmp_path / "a.npz").write_bytes(motion_file(dance, "npz"))
    motion = load(tmp_path / "a.npz", fps=None, up=None, unit=None)
    np.testing.assert_allclose(motion.rotations, dance.rotations, atol=1e-12)
    assert motion.fit_m is None
    assert motion.grid == dance.grid
    foreign = Motion(dance.translation, np.zeros((N, 21, 3)), dance.grid, MOTORICA21)
    (tmp_path / "b.npz").write_bytes(motion_file(foreign, "npz"))
    assert load(tmp_path / "b.npz").fit_m is not None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda at: at[:, :20], "bad_declaration"),
        (lambda at: np.where(np.arange(24)[:, None] == 18, at[:, [16]], at), "bad_skeleton"),
        (lambda at: np.where(at > 1, np.nan, at), "nan"),
        (lambda at: at[:0], "empty"),
        (lambda at: at * (-1, 1, 1), "swapped_sides"),
        (lambda at: at[:, :, [0, 2, 1]] * (1, -1, 1), "bad_declaration"),
    ],
    ids=["another number", "no forearm", "NaN", "no frames", "mirrored", "lying"],
)
def test_positions_that_are_refused(tmp_path: Path, dance: Motion, change: Any, reason: str) -> None:
    np.savez(tmp_path / "a.npz", positions=change(dance.joints()), joint_names=SMPL24.joints)
    with raises_message(DataError, "", reason=reason) as error:
        load(tmp_path / "a.npz")
    assert "a.npz" in str(error.value)


def test_names_that_are_not_known(tmp_path: Path, dance: Motion) -> None:
    names = [f"marker{k}" for k in range(24)]
    np.savez(tmp_path / "a.npz", positions=dance.joints(), joint_names=names)
    with raises_message(DataError, "joint_map", where="a.npz", reason="unknown_joints"):
        load(tmp_path / "a.npz")
    known = {joint: names[k] for k, joint in enumerate(SMPL24.joints)}
    assert apart(load(tmp_path / "a.npz", joint_map=known), dance.joints(), LIMBS) < 1e-6
    with raises_message(UsageError, "coco17"):
        Folder(joints="coco")


def smplx322(motion: Motion) -> Any:
    """Return Motion-X's columns of a motion on SMPL-X's joints, with a face and betas."""
    rows, face = motion.rotations.reshape(len(motion.rotations), 55, 3), np.full((motion.n_frames, 150), 0.3)
    parts = [rows[:, :22], rows[:, 25:], rows[:, 22:23]]
    columns = [part.reshape(len(rows), -1) for part in parts]
    betas = np.full((len(rows), 10), 0.2)
    return np.concatenate([*columns, face, motion.translation, betas], axis=1)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_motion_x(tmp_path: Path, dance: Motion, dtype: Any) -> None:
    moved = transfer_to(dance, SMPLX55)
    rotations = moved.rotations.copy()
    rotations[:, 22:23] += 0.1
    rotations[:, 25:] += np.linspace(0, 0.4, 30)[:, None]
    expected = Motion(moved.translation, rotations, moved.grid, SMPLX55)
    np.save(tmp_path / "000001.npy", smplx322(expected).astype(dtype))
    motion = load(tmp_path / "000001.npy", fps=None, up=None, unit=None)
    assert (motion.grid.rate, motion.skeleton.name) == (30, "smplx55")
    np.testing.assert_allclose(motion.rotations, expected.rotations, atol=1e-6)
    np.testing.assert_allclose(motion.translation, expected.translation, atol=1e-6)
    assert "motionx" in notes(tmp_path / "000001.npy")


def test_humanml3d(tmp_path: Path, dance: Motion) -> None:
    columns = Humanml263().encode(dance.part(0, 100))
    np.save(tmp_path / "M000001.npy", columns)
    motion = load(tmp_path / "M000001.npy", fps=None, up=None, unit=None)
    assert motion.grid.rate == 20
    assert apart(motion, Humanml263().positions(columns), list(range(22))) < 0.01
    np.save(tmp_path / "M000001.npy", (columns - columns.mean(axis=0)) / (columns.std(axis=0) + 1e-3))
    with raises_message(DataError, "Mean.npy", where="M000001.npy", reason="out_of_range"):
        load(tmp_path / "M000001.npy")


def mdm(path: Path, dance: Motion, lengths: list[int]) -> None:
    sample = dance.joints()[:, :22].transpose(1, 2, 0)
    content = {
        "motion": np.stack([sample + k for k in range(len(lengths))]),
        "text": ["a person dances"] * len(lengths),
        "lengths": np.array(lengths),
        "num_samples": len(lengths),
        "num_repetitions": 1,
    }
    np.save(path, content, allow_pickle=True)  # type: ignore[arg-type]


def test_mdms_results(tmp_path: Path, dance: Motion) -> None:
    mdm(tmp_path / "results.npy", dance, [120, 196, 60])
    shown = clips_of(tmp_path / "results.npy", FileFormat())
    assert [(clip.id, len(clip.pose().joints)) for clip in shown] == [
        ("results-person0", 120), ("results-person1", 196), ("results-person2", 60),
    ]  # fmt: skip
    with raises_message(DataError, "split", where="results.npy", reason="several_people"):
        load(tmp_path / "results.npy")
    (tmp_path / "source" / "motions").mkdir(parents=True)
    (tmp_path / "results.npy").rename(tmp_path / "source" / "motions" / "results.npy")
    folder = Folder(people="split", music="optional")
    clips = folder.scan(tmp_path / "source").clips
    assert [clip.id for clip in clips] == ["results-person0", "results-person1", "results-person2"]
    motions = [folder.load(clip) for clip in clips]
    assert [motion.n_frames for motion in motions] == [120, 196, 60]
    assert {motion.grid.rate for motion in motions} == {Fraction(20)}
    assert apart(motions[1], dance.joints()[:196, :22] + 1, list(range(22))) < 1e-6
    mdm(tmp_path / "results.npy", dance, [90])
    assert load(tmp_path / "results.npy", fps=None, up=None, unit=None).n_frames == 90
    mdm(tmp_path / "results.npy", dance, [90, 0])
    with raises_message(DataError, "", reason="empty"):
        Folder(music="optional").load(
            ClipRef("a", tmp_path / "results.npy", None, "train", declared=(("person", "1"),))
        )


def test_named_positions_are_measured_by_their_names(tmp_path: Path, dance: Motion) -> None:
    """Twenty-five joints in Kinect's order are not SMPL's first 22."""
    order = [SMPL24.index(joint) if joint in SMPL24.joints else 15 for joint in JOINT_SETS["ntu25"]]
    np.savez(tmp_path / "a.npz", positions=dance.joints()[:, order], joint_names=JOINT_SETS["ntu25"], fps=60)
    pose = FileClip(id="a", path=tmp_path / "a.npz", format=FileFormat(up="y", unit="m")).pose()
    assert np.abs(pose.joints[:, LIMBS] - dance.joints()[:, LIMBS]).max() < 0.05


def test_a_dataset_of_positions(tmp_path: Path, dance: Motion) -> None:
    motions = tmp_path / "source" / "motions"
    motions.mkdir(parents=True)
    for k in range(2):
        np.save(motions / f"clip{k}.npy", dance.joints()[:, :22])
    np.save(motions / "coco.npy", dance.joints()[:, :17])
    recipe = {
        "recipe": 1, "name": "positions", "windows": {"length_s": 2, "stride_s": 1}, "audio": {},
        "dataset": {"folder": {"fps": 60, "up": "y", "unit": "m", "music": "optional"}},
        "motion": {"edge151": {}, "joints": {}, "lodge139": {}},
    }  # fmt: skip
    places = {"cache": tmp_path / "cache", "jobs": 1, "progress": False}
    with dancedata.build(recipe, tmp_path / "source", tmp_path / "out", **places).open() as store:
        assert [(row["clip"], row["reason"]) for row in store.rejects] == [("coco", "unknown_joints")]
        assert sorted(clip.id for clip in store) == ["clip0", "clip1"]
        assert {flag["kind"] for flag in store.quality} == {"fitted"}
        assert store["clip0"].read("joints").shape == (N // 2, 72)
    assert "twist unknown" in run("check", tmp_path / "out").stdout


def test_the_keypoints_that_aistpp_publishes(shared: Path) -> None:
    """Arms and shins have the directions of the rotations that were fitted to them with SMPL, up to its own error."""
    source = shared / "realdata" / "aistpp"
    (path, *_) = sorted((source / "keypoints3d").glob("*d03*.pkl"))
    motion = load(path, joints="coco17", unit="guess")
    expected = scans.load(AistPP(), source / "motions" / path.name)
    for a, b in ((4, 7), (5, 8), (16, 18), (18, 20), (17, 19), (19, 21)):
        bones = [at[:, b] - at[:, a] for at in (motion.joints(), expected.joints())]
        cosine = np.sum(bones[0] * bones[1], axis=-1) / np.prod([np.linalg.norm(x, axis=-1) for x in bones], axis=0)
        assert np.degrees(np.arccos(cosine)).mean() < 3
