"""BVH skeletons on SMPL's joints: names, positions and rotations that survive, on synthetic and on real files."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion, forward_kinematics
from dancedata.core.registry import CONTACTS, REPRESENTATIONS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.folder import Folder
from dancedata.formats.bvh.joint_names import map_joints
from dancedata.formats.bvh.kinematics import world
from dancedata.formats.bvh.parse import read_bvh, read_bvh_header
from dancedata.formats.bvh.producers import REQUIRED
from dancedata.formats.bvh.write import write_bvh
from dancedata.formats.stated import UPRIGHT
from dancedata.synthetic import synthesise_motion
from tests.messages import raises_message

Floats = NDArray[np.float64]

MIXAMO = """mixamorig:Hips mixamorig:LeftUpLeg mixamorig:RightUpLeg mixamorig:Spine mixamorig:LeftLeg
    mixamorig:RightLeg mixamorig:Spine1 mixamorig:LeftFoot mixamorig:RightFoot mixamorig:Spine2
    mixamorig:LeftToeBase mixamorig:RightToeBase mixamorig:Neck mixamorig:LeftShoulder mixamorig:RightShoulder
    mixamorig:Head mixamorig:LeftArm mixamorig:RightArm mixamorig:LeftForeArm mixamorig:RightForeArm
    mixamorig:LeftHand mixamorig:RightHand mixamorig:LeftHandMiddle1 mixamorig:RightHandMiddle1"""


def load(path: Path, **parameters: Any) -> Motion:
    return Folder(**parameters).load(ClipRef("x", path, None, "train"))


@pytest.fixture(scope="module")
def danced() -> Motion:
    return synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=60)[0]


def odd_bones(seed: int) -> Skeleton:
    """SMPL's tree with bones of other lengths, as another dancer has them."""
    scale = np.random.default_rng(seed).uniform(0.7, 1.3, (24, 1))
    offsets = np.array(SMPL24.offsets) * scale
    return Skeleton("odd", SMPL24.joints, SMPL24.parents, offsets, SMPL24.pairs, SMPL24.feet)


def write_as(
    path: Path,
    motion: Motion,
    bones: Skeleton,
    frames: Rotation,
    *,
    names: Sequence[str] = tuple(MIXAMO.split()),
    orders: Any = "ZYX",
) -> Floats:
    """Write a motion on `bones` with every joint's own axes turned by `frames`; returns joint positions, metres."""
    q = frames.as_matrix()
    local = Rotation.from_rotvec(np.array(motion.rotations.reshape(-1, 3))).as_matrix().reshape(-1, 24, 3, 3)
    offsets, turns = np.zeros((24, 3)), np.empty_like(local)
    turns[:, 0] = local[:, 0] @ q[0]
    for j in range(1, 24):
        parent = SMPL24.parents[j]
        offsets[j] = q[parent].T @ bones.offsets[j]
        turns[:, j] = q[parent].T @ local[:, j] @ q[j]
    pelvis = motion.translation + bones.offsets[0]
    write_bvh(path, names, SMPL24.parents, offsets * 100, turns, pelvis * 100, "0.0166667", orders)
    return forward_kinematics(bones, motion.rotations, motion.translation)


def angles(one: Floats, other: Floats) -> Floats:
    """Degrees between rotations (T, J, 3)."""
    a, b = (Rotation.from_rotvec(np.array(r.reshape(-1, 3))) for r in (one, other))
    return np.degrees((a.inv() * b).magnitude()).reshape(one.shape[:2])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_positions_survive_any_skeleton(tmp_path: Path, danced: Motion, seed: int) -> None:
    """Random bones, random axes of every joint (the rest pose is a heap), random orders of rotation."""
    rng = np.random.default_rng(seed)
    orders = [str(rng.choice(["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])) for _ in range(24)]
    wanted = write_as(tmp_path / "a.bvh", danced, odd_bones(seed), Rotation.random(24, rng), orders=orders)
    motion = load(tmp_path / "a.bvh", unit="cm")
    assert motion.grid.rate == 60
    assert np.abs(motion.joints() - wanted).max() < 1e-5  # metres; the file has six decimals


@pytest.mark.parametrize("turned", [0, 90])
def test_smpls_own_rest_pose_gives_the_rotations_back(tmp_path: Path, danced: Motion, turned: int) -> None:
    """Exactly, although SMPL's hips, neck and head lie askew by a few degrees; so does every field of a build."""
    frames = Rotation.from_rotvec(np.tile([np.radians(turned), 0, 0], (24, 1)))
    wanted = write_as(tmp_path / "a.bvh", danced, SMPL24, frames)
    motion = load(tmp_path / "a.bvh", unit="cm")
    assert np.abs(motion.joints() - wanted).max() < 1e-5
    assert angles(motion.rotations, danced.rotations)[:, :22].max() < 1e-3
    columns = REPRESENTATIONS.make("edge151", {}).encode(motion, CONTACTS.make("velocity", {}))
    expected = REPRESENTATIONS.make("edge151", {}).encode(danced, CONTACTS.make("velocity", {}))
    np.testing.assert_allclose(columns[:, 4:139], expected[:, 4:139], atol=2e-5)


def test_spines_of_any_number() -> None:
    from dancedata.formats.bvh.hierarchy import POSITIONS, ROTATIONS, BvhJoint

    for n, expected in [(0, []), (1, [1]), (2, [1, 2]), (3, [1, 2, 3]), (4, [1, 3, 4]), (5, [1, 3, 5])]:
        names, parents = ["Hips"] + [f"s{k}" for k in range(1, n + 1)], [-1, *range(n)]
        for side in ("Left", "Right"):
            for chain, root in ((("UpLeg", "Leg", "Foot"), 0), (("Arm", "ForeArm", "Hand"), n)):
                for k, part in enumerate(chain):
                    parents.append(root if k == 0 else len(names) - 1)
                    names.append(side + part)
        names, parents = [*names, "Head"], [*parents, n]
        six = (*POSITIONS, *ROTATIONS)
        joints = [BvhJoint(a, p, (0, 1, 0), () if p >= 0 else six, 0, 1) for a, p in zip(names, parents, strict=True)]
        of = map_joints(Path("x"), joints, None).of
        spines = [of[s] for s in (3, 6, 9) if s in of]
        assert spines == expected


def agreement_cm(path: Path, motion: Motion, metres: float, up: str) -> Floats:
    """Largest distance in cm, for each required joint, between the motion and the file's own kinematics."""
    bvh = read_bvh(path)
    of = map_joints(path, bvh.joints, None).of
    wanted = [SMPL24.index(name) for name in REQUIRED]
    _, places = world(bvh, [of[s] for s in wanted], slice(None))
    places = places @ UPRIGHT[up].T * metres
    return np.linalg.norm(motion.joints()[:, wanted] - places, axis=-1).max(axis=0) * 100


REAL = [
    ("rokoko_jesse_dance", "cm", "y", 100, 0.001),
    ("cmu_01_01", "cmu", "y", 120, 0.001),
    # Four joints in the back: one of them is left out. Its unit is none of the usual ones.
    ("fair1_dab", "0.0381", "z", 30, 0.1),
]


@pytest.mark.parametrize(("name", "unit", "up", "rate", "tolerance_cm"), REAL)
def test_real_files(shared: Path, name: str, unit: str, up: str, rate: int, tolerance_cm: float) -> None:
    path = shared / "realdata" / "bvh" / f"{name}.bvh"
    motion = load(path, unit=unit, up=up)
    metres = {"cm": 0.01, "cmu": 0.0254 / 0.45}.get(unit) or float(unit)
    assert motion.grid.rate == rate
    assert agreement_cm(path, motion, metres, up).max() < tolerance_cm
    joints = motion.joints()
    for places in (joints, load(path, unit="guess", up=up).joints()):
        assert 1.2 < np.median(np.ptp(places[..., 1], axis=1)) < 2.2
    # Upright: the head is above the feet in nearly every frame.
    assert np.mean(joints[:, 15, 1] > joints[:, 7, 1] + 0.5) > 0.9
    # SMPL's knees bend about +x, its left elbow about -y and its right one about +y; nothing is wrung out.
    mean = {
        j: Rotation.from_rotvec(np.array(motion.rotations[:, k])).mean().as_rotvec(degrees=True)
        for k, j in enumerate(SMPL24.joints)
    }
    for side, sign in (("left", -1), ("right", 1)):
        knee, elbow = mean[f"{side}_knee"], mean[f"{side}_elbow"] * sign
        assert knee[0] > 5
        assert knee[0] > 2 * np.abs(knee[1:]).min()
        assert elbow[1] > 15
    for joint in ("left_ankle", "right_ankle", "left_collar", "right_collar", "spine1", "spine2", "head", "neck"):
        assert np.linalg.norm(mean[joint]) < 50


def test_a_file_with_z_up_says_so_when_nothing_is_declared(shared: Path) -> None:
    with raises_message(DataError, "convention", where="realdata/bvh/fair1_dab.bvh", reason="undeclared"):
        load(shared / "realdata" / "bvh" / "fair1_dab.bvh", unit="0.0381")


@pytest.fixture
def own(tmp_path: Path, danced: Motion) -> Path:
    write_as(tmp_path / "own.bvh", danced, SMPL24, Rotation.identity(24))
    return tmp_path / "own.bvh"


def test_unit_is_never_guessed_unasked(own: Path) -> None:
    with raises_message(DataError, "lengths", where="own.bvh", reason="undeclared"):
        load(own)


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "cm"), (0.01, "m"), (10.0, "mm"), (0.4, "inch"), (0.18, "cmu")])
def test_guess_finds_the_unit(own: Path, factor: float, unit: str) -> None:
    bvh = read_bvh(own)
    places = np.array([joint.offset for joint in bvh.joints]) * factor
    turns = Rotation.identity(48).as_matrix().reshape(2, 24, 3, 3)
    write_bvh(own, bvh.names, [j.parent for j in bvh.joints], places, turns, np.zeros((2, 3)), "0.01")
    motion = load(own, unit="guess")
    assert np.array_equal(motion.rotations, load(own, unit=unit).rotations)
    assert 1.2 < np.median(np.ptp(motion.joints()[..., 1], axis=1)) < 2.2
    assert motion.skeleton.name == load(own, unit=unit).skeleton.name


def test_up_axis(tmp_path: Path, danced: Motion) -> None:
    expected = write_as(tmp_path / "a.bvh", danced, SMPL24, Rotation.identity(24))
    lines = (tmp_path / "a.bvh").read_text().splitlines()
    # A root above the hips that turns the whole take to +Z up.
    turned = ["HIERARCHY", "ROOT World", "{", "OFFSET 0 0 0", f"CHANNELS 6 Xposition Yposition Zposition {ZYX}"]
    motion_at = lines.index("MOTION")
    body = [line.replace("ROOT", "JOINT") for line in lines[1:motion_at]]
    rows = ["0 0 0 0 0 90 " + line for line in lines[motion_at + 3 :]]
    text = [*turned, *body, "}", *lines[motion_at : motion_at + 3], *rows]
    (tmp_path / "b.bvh").write_text("\n".join(text))
    with raises_message(DataError, "convention", where="b.bvh", reason="undeclared"):
        load(tmp_path / "b.bvh", unit="cm")
    assert np.abs(load(tmp_path / "b.bvh", unit="cm", up="z").joints() - expected).max() < 1e-5


ZYX = "Zrotation Yrotation Xrotation"


def test_joint_map(tmp_path: Path, danced: Motion) -> None:
    names = [f"Knochen {k}" for k in range(24)]
    expected = write_as(tmp_path / "a.bvh", danced, SMPL24, Rotation.identity(24), names=names)
    with raises_message(DataError, "right_wrist", where="a.bvh", reason="unknown_joints"):
        load(tmp_path / "a.bvh", unit="cm")
    given = dict(zip(SMPL24.joints, names, strict=True))
    assert np.abs(load(tmp_path / "a.bvh", unit="cm", joint_map=given).joints() - expected).max() < 1e-5
    without = {**given, "spine2": "", "left_hand": ""}
    part = load(tmp_path / "a.bvh", unit="cm", joint_map=without).joints()
    assert np.abs(part - expected)[:, [7, 8]].max() < 1e-5


def test_a_missing_joint_is_named_with_its_like(own: Path) -> None:
    own.write_text(own.read_text().replace("mixamorig:LeftForeArm", "mixamorig:LeftForearmm"))
    with raises_message(DataError, "left_elbow", where="own.bvh", reason="unknown_joints"):
        load(own, unit="cm")
    named = load(own, unit="cm", joint_map={"left_elbow": "mixamorig:LeftForearmm"})
    assert named.n_frames == 60


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"left_knee": "mixamorig:LeftLeq"}, "unknown_joints"),
        ({"pelvis": "Root"}, "unknown_joints"),
        ({"left_knee": "mixamorig:RightLeg", "right_knee": "mixamorig:LeftLeg"}, "bad_joint_map"),
        ({"left_knee": ""}, "unknown_joints"),
        ({"left_knee": "mixamorig:LeftFoot"}, "unknown_joints"),
    ],
)
def test_wrong_joint_maps(own: Path, given: dict[str, str], reason: str) -> None:
    with raises_message(DataError, "joint_map", where="own.bvh", reason=reason):
        load(own, unit="cm", joint_map=given)


def test_joint_map_of_no_joint() -> None:
    with raises_message(UsageError, "left_nee"):
        Folder(joint_map={"left_nee": "x"})


def test_optional_joints_may_be_missing(tmp_path: Path, danced: Motion) -> None:
    """No spine, collars, toes, hands or head: the existing joints are where the file has them."""
    kept = [0, 1, 2, 4, 5, 7, 8, 12, 16, 17, 18, 19, 20, 21]
    world_offsets = np.zeros((24, 3))
    for j in range(1, 24):
        world_offsets[j] = world_offsets[SMPL24.parents[j]] + SMPL24.offsets[j]
    parents = []
    for j in kept:
        parent = SMPL24.parents[j]
        while parent not in kept and parent != -1:
            parent = SMPL24.parents[parent]
        parents.append(-1 if parent == -1 else kept.index(parent))
    offsets = np.array(
        [world_offsets[j] - world_offsets[kept[p]] * (p >= 0) for j, p in zip(kept, parents, strict=True)]
    )
    turns = Rotation.from_rotvec(np.array(danced.rotations[:, kept].reshape(-1, 3))).as_matrix().reshape(-1, 14, 3, 3)
    names = [MIXAMO.split()[j] for j in kept]
    write_bvh(tmp_path / "a.bvh", names, parents, offsets * 100, turns, danced.translation * 100, "0.0166667")
    motion = load(tmp_path / "a.bvh", unit="cm")
    assert agreement_cm(tmp_path / "a.bvh", motion, 0.01, "y").max() < 0.001
    toes = motion.joints()[:, 10] - motion.joints()[:, 7]
    assert np.allclose(np.linalg.norm(toes, axis=1), np.linalg.norm(SMPL24.offsets[10]), rtol=0.05)


def with_bones(**lengths: float) -> Skeleton:
    """SMPL's bones; those to some joints have other lengths, as factors."""
    offsets = np.array(SMPL24.offsets)
    for joint, factor in lengths.items():
        offsets[SMPL24.index(joint)] *= factor
    return Skeleton("odd", SMPL24.joints, SMPL24.parents, offsets, SMPL24.pairs, SMPL24.feet)


@pytest.mark.parametrize(
    "lengths",
    [
        {"left_knee": 0}, {"right_ankle": 0}, {"left_elbow": 0, "left_wrist": 0, "right_elbow": 0, "right_wrist": 0},
        {"left_elbow": 0, "left_wrist": 0}, {"right_elbow": 1e-7}, {"left_wrist": 0}, {"left_hip": 0, "right_hip": 0},
        {f"{side}_{joint}": 0 for side in ("left", "right") for joint in ("collar", "shoulder")},
        {"spine1": 0, "spine2": 0, "spine3": 0, "neck": 0},
    ],
    ids=lambda lengths: "-".join(lengths),
)  # fmt: skip
def test_bones_without_length_are_refused(tmp_path: Path, danced: Motion, lengths: dict[str, float]) -> None:
    write_as(tmp_path / "a.bvh", danced, with_bones(**lengths), Rotation.identity(24))
    with raises_message(DataError, "", reason="bad_skeleton"):
        load(tmp_path / "a.bvh", unit="cm")


@pytest.mark.parametrize(
    ("lengths", "noted"),
    [
        ({"left_elbow": 2}, "upper arm (left 5"),
        ({"right_knee": 1.3}, "thigh (left 38"),
        ({"left_hip": 0}, "hip (left 0, right 1"),
        ({"right_ankle": 0.85, "left_wrist": 1.2}, "shin"),
        ({"left_elbow": 1.05, "neck": 2}, ""),
    ],
)
def test_sides_of_unequal_length_are_a_note(tmp_path, danced, lengths, noted):
    wanted = write_as(tmp_path / "a.bvh", danced, with_bones(**lengths), Rotation.identity(24))
    assert np.abs(load(tmp_path / "a.bvh", unit="cm").joints() - wanted).max() < 1e-5
    clip = Folder(unit="cm", music="optional").scan(tmp_path).clips[0]
    notes = [note for note in clip.notes if note.startswith("BVH bones of unequal length: ")]
    assert [noted in note for note in notes] == [True] * bool(noted)


def with_positions(path: Path, bones: Floats) -> None:
    """Give all joints of a file position channels with bones (24, 3) or, by frame, (T, 24, 3), in the file's unit."""
    text = path.read_text().replace("CHANNELS 3 Z", "CHANNELS 6 Xposition Yposition Zposition Z")
    order = [SMPL24.joints.index(MIXAMO_JOINT[name]) for name in read_bvh(path).names[1:]]
    head, _, tail = text.partition("Frame Time: 0.0166667\n")
    rows = []
    for line, places in zip(tail.splitlines(), np.broadcast_to(bones, (60, 24, 3)), strict=True):
        words = line.split()
        joints = [words[k : k + 3] for k in range(6, len(words), 3)]
        placed = [[*map(str, places[j]), *turn] for j, turn in zip(order, joints, strict=True)]
        rows.append(" ".join([*words[:6], *(word for joint in placed for word in joint)]))
    path.write_text(f"{head}Frame Time: 0.0166667\n" + "\n".join(rows) + "\n")


MIXAMO_JOINT = dict(zip(MIXAMO.split(), SMPL24.joints, strict=True))
ARMS = [SMPL24.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("elbow", "wrist")]


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3, -1e-4])
@pytest.mark.parametrize("of", ["arms", "all"])
def test_position_channels_of_rounding_errors_are_not_bones(own: Path, noise: float, of: str) -> None:
    """Whether exactly 0 or nearly: the OFFSETs count. Where those are 0 too, the file is refused."""
    expected = load(own, unit="cm").joints()
    bones = np.array(SMPL24.offsets) * 100
    bones[ARMS if of == "arms" else slice(None)] = noise
    with_positions(own, bones)
    assert np.abs(load(own, unit="cm").joints() - expected).max() < 1e-7
    own.write_text(re.sub("OFFSET .*", "OFFSET 0 0 0", own.read_text()))
    with raises_message(DataError, "", reason="bad_skeleton"):
        load(own, unit="cm")


def test_bones_in_position_channels_are_those_of_the_notes(own: Path) -> None:
    text, expected = own.read_text(), load(own, unit="cm").joints()
    bones = np.array(SMPL24.offsets) * 100
    with_positions(own, bones)
    own.write_text(re.sub("OFFSET .*", "OFFSET 1 2 3", own.read_text()))
    np.testing.assert_allclose(load(own, unit="cm").joints(), expected, atol=1e-9)
    own.write_text(text)
    bones[18] *= 1.5
    with_positions(own, bones)
    own.write_text(re.sub("OFFSET .*", "OFFSET 0 0 0", own.read_text()))
    notes = Folder(unit="cm", music="optional").scan(own.parent).clips[0].notes
    assert any("upper arm" in note for note in notes)
    assert not any("not usable" in note for note in notes)


#: Channels of a joint above the hips, of the hips, and the values of the first.
ROOTS = {
    "no channels above six": ("0", "6 Xposition Yposition Zposition Z", ()),
    "rotations above six": ("3 Zrotation Xrotation Yrotation", "6 Xposition Yposition Zposition Z", (0, 0, 0)),
    "turned above six": ("3 Zrotation Xrotation Yrotation", "6 Xposition Yposition Zposition Z", (0, 0, 90)),
    "a hinge above six": ("1 Yrotation", "6 Xposition Yposition Zposition Z", (90,)),
    "positions above six": ("3 Xposition Yposition Zposition", "6 Xposition Yposition Zposition Z", (50, 0, -20)),
    "positions above rotations": ("3 Xposition Yposition Zposition", "3 Z", None),
}


@pytest.mark.parametrize("kind", ROOTS)
def test_joints_above_the_hips(tmp_path: Path, danced: Motion, kind: str) -> None:
    """Blender's root of several bones, a reference: what moves the hips may be in any of them."""
    wanted = write_as(tmp_path / "a.bvh", danced, SMPL24, Rotation.identity(24))
    channels, of_hips, values = ROOTS[kind]
    head, _, tail = (tmp_path / "a.bvh").read_text().partition("Frame Time: 0.0166667\n")
    head = head.replace("ROOT", "JOINT").replace("CHANNELS 6 Xposition Yposition Zposition Z", f"CHANNELS {of_hips}")
    # Another bone without a parent, as a prop: two of its joints have one name.
    prop = "\nOFFSET 9 9 9\nCHANNELS 0\nEnd Site\n{\nOFFSET 0 0 1\n}\n}\n"
    props = f"JOINT Prop\n{{{prop}JOINT Nub\n{{{prop}JOINT Nub\n{{{prop}"
    head = head.replace("HIERARCHY\n", f"HIERARCHY\nROOT __0\n{{\nOFFSET 0 0 0\nCHANNELS {channels}\n{props}")
    head = head.replace("MOTION", "}\nMOTION")
    if values is not None:
        tail = "".join(f"{' '.join(map(str, values))} {line}\n" for line in tail.splitlines())
    (tmp_path / "a.bvh").write_text(f"{head}Frame Time: 0.0166667\n{tail}")
    turn = Rotation.from_euler("y", 90 if values and 90 in values else 0, degrees=True).as_matrix()
    shift = np.array(values) / 100 if "positions above six" in kind else np.zeros(3)
    motion = load(tmp_path / "a.bvh", unit="cm")
    np.testing.assert_allclose(motion.joints(), wanted @ turn.T + shift, atol=1e-5)


@pytest.mark.parametrize(
    ("root", "hips"),
    [
        (None, "CHANNELS 3 Z"),
        (None, "CHANNELS 5 Xposition Zposition Z"),
        ("CHANNELS 0", "CHANNELS 3 Z"),
        ("CHANNELS 3 Zrotation Yrotation Xrotation", "CHANNELS 3 Z"),
    ],
)
def test_hips_that_nothing_moves_are_refused(own: Path, root: str | None, hips: str) -> None:
    text = own.read_text().replace("CHANNELS 6 Xposition Yposition Zposition Z", hips)
    if root is not None:
        text = text.replace("ROOT", f"ROOT top\n{{\nOFFSET 0 0 0\n{root}\nJOINT").replace("MOTION", "}\nMOTION")
    own.write_text(text)
    with raises_message(DataError, "", reason="missing_channels"):
        map_joints(own, read_bvh_header(own).joints, None)


def test_names_that_occur_twice(own: Path) -> None:
    """No matter where they are not used; refused where one of them is a joint of the body, however it is mapped."""
    text = own.read_text()
    expected = load(own, unit="cm", joint_map={"left_hand": "", "right_hand": ""}).joints()
    own.write_text(text.replace("HandMiddle1", "Hand"))  # below a joint of its name: the end of that one
    np.testing.assert_array_equal(load(own, unit="cm").joints(), expected)
    own.write_text(text.replace("mixamorig:LeftToeBase", "Nub").replace("mixamorig:RightToeBase", "Nub"))
    assert load(own, unit="cm").n_frames == 60
    for joint_map in (None, {"left_foot": "Nub"}):
        if joint_map is None:
            own.write_text(text.replace("RightForeArm", "LeftForeArm"))
        else:
            own.write_text(text.replace("mixamorig:LeftToeBase", "Nub").replace("mixamorig:RightToeBase", "Nub"))
        with raises_message(DataError, "", reason="ambiguous_joint_map"):
            load(own, unit="cm", joint_map=joint_map)


def test_bones_that_change_their_length(own: Path) -> None:
    bones = np.tile(np.array(SMPL24.offsets) * 100, (60, 1, 1))
    bones[:, 23, 0] += np.arange(60) % 30  # it wanders by 30 cm
    with_positions(own, bones)
    with raises_message(DataError, "RightHandMiddle1", where="own.bvh", reason="bad_skeleton"):
        load(own, unit="cm")


@pytest.mark.parametrize("joint", ["left_shoulder", "right_shoulder", "spine2", "spine3"])
def test_a_bone_without_length_has_the_direction_of_the_next(tmp_path: Path, danced: Motion, joint: str) -> None:
    """A collar and a shoulder at one place: the collar points to the elbow."""
    for name, skeleton in (("zero", with_bones(**{joint: 0})), ("whole", odd_bones(1))):
        wanted = write_as(tmp_path / f"{name}.bvh", danced, skeleton, Rotation.identity(24))
        (tmp_path / f"{name}.wav").touch()
        assert np.abs(load(tmp_path / f"{name}.bvh", unit="cm").joints() - wanted).max() < 1e-5
    assert angles(load(tmp_path / "zero.bvh", unit="cm").rotations, danced.rotations).mean() < 6
    clips = {clip.id: clip for clip in Folder(unit="cm").scan(tmp_path).clips}
    assert [clips[name].revision for name in ("zero", "whole")] == [1, 0]
    assert any(note.startswith("BVH bones without length: ") for note in clips["zero"].notes)
