"""Producers of BVH: found by joint names, with evidence; ambiguity is an error."""

from pathlib import Path

import pytest

from dancedata.core.errors import DataError
from dancedata.core.skeleton import SMPL24
from dancedata.formats.bvh.producers import REQUIRED, detect, producers
from tests.messages import raises_message

UP_LEG = """Hips LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot RightToeBase Spine Spine1 Neck
    Head LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm RightHand"""
XSENS = """Hips Chest Chest2 Chest3 Chest4 Neck Head RightCollar RightShoulder RightElbow RightWrist LeftCollar
    LeftShoulder LeftElbow LeftWrist RightHip RightKnee RightAnkle RightToe LeftHip LeftKnee LeftAnkle LeftToe"""
ROKOKO = """Hips Spine1 Spine2 Spine3 Spine4 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder
    RightArm RightForeArm RightHand LeftThigh LeftShin LeftFoot LeftToe RightThigh RightShin RightFoot RightToe"""
FINGERS = " ".join(f"{side}Hand{finger}1" for side in ("Left", "Right") for finger in ("Thumb", "Middle", "Pinky"))
#: By names that the producers' own files have.
FILES = {
    "cmu": f"{UP_LEG} LHipJoint RHipJoint LowerBack Neck1 LeftFingerBase LeftHandIndex1 LThumb",
    "mixamo": " ".join(f"mixamorig:{name}" for name in f"{UP_LEG} Spine2 HeadTop_End {FINGERS}".split()),
    "mixamo, second character": " ".join(f"mixamorig1:{name}" for name in f"{UP_LEG} Spine2 {FINGERS}".split()),
    "motorica": f"{UP_LEG} {FINGERS}",
    "lafan": UP_LEG.replace("ToeBase", "Toe") + " Spine2",
    "fair": f"{UP_LEG} Spine2 Spine3 LeftHandEnd LeftHandThumb1",
    "rokoko": ROKOKO,
    "rokoko-humanik": f"{UP_LEG} Spine2 LeftInHandIndex LeftInHandMiddle {FINGERS}",
    "100style or xsens": XSENS,
}
HERE = Path("a.bvh")


@pytest.mark.parametrize("producer", FILES)
def test_producers_are_found_by_their_names(producer: str) -> None:
    names = FILES[producer].split()
    found = detect(HERE, names, {})
    assert str(found).partition(" (by ")[0] == producer.partition(",")[0]
    assert found.evidence
    assert {SMPL24.index(joint) for joint in REQUIRED} <= set(found.of)
    left = {SMPL24.joints[s]: names[k].rpartition(":")[2] for s, k in found.of.items()}
    assert left["pelvis"] == "Hips"
    assert all(left[joint].startswith("Left") for joint in left if joint.startswith("left_") and joint != "left_hand")


def test_real_captures(shared: Path) -> None:
    from dancedata.formats.bvh.parse import read_bvh_header

    of = {"cmu_01_01": "cmu", "fair1_dab": "fair", "rokoko_jesse_dance": "rokoko-humanik"}
    for file, producer in of.items():
        joints = read_bvh_header(shared / "realdata" / "bvh" / f"{file}.bvh").joints
        assert [p.name for p in detect(HERE, [joint.name for joint in joints], {}).producers] == [producer]


def test_without_evidence_all_producers_of_one_map_are_named() -> None:
    found = detect(HERE, UP_LEG.replace("Spine1", "").split(), {})
    names = "cmu or fair or lafan or mixamo or motorica or rokoko-humanik"
    assert str(found) == f"{names} (nothing typical of one of them, and one map)"


def test_a_file_with_the_joints_of_two_producers_is_ambiguous() -> None:
    names = [*UP_LEG.split(), *(set(XSENS.split()) - set(UP_LEG.split()))]
    with raises_message(DataError, "producers", where="a.bvh") as caught:
        detect(HERE, sorted(names), {})
    assert caught.value.reason == "ambiguous_joint_map"
    chosen = detect(HERE, names, {}, "xsens")
    assert [p.name for p in chosen.producers] == ["xsens"]
    assert names[chosen.of[SMPL24.index("left_hip")]] == "LeftHip"
    assert names[detect(HERE, names, {}, "mixamo").of[SMPL24.index("left_hip")]] == "LeftUpLeg"


def test_two_people_in_one_file_are_ambiguous() -> None:
    names = [f"{person}:{name}" for person in ("anna", "ben") for name in UP_LEG.split()]
    with raises_message(DataError, "joint_map", where="a.bvh") as caught:
        detect(HERE, names, {})
    assert caught.value.reason == "ambiguous_joint_map"


def test_an_unknown_producer() -> None:
    with raises_message(DataError, "mixano", where="a.bvh", reason="bad_declaration"):
        detect(HERE, UP_LEG.split(), {}, "mixano")


def test_all_producers_map_both_sides() -> None:
    for producer in producers().values():
        sides = {joint.replace("left_", "right_") for joint in producer.joints if joint.startswith("left_")}
        assert sides == {joint for joint in producer.joints if joint.startswith("right_")}
        assert set(REQUIRED) <= set(producer.joints)
        assert producer.evidence


def test_the_producer_may_be_declared_for_all_or_for_one_file(tmp_path: Path) -> None:
    """A body whose skeleton has mocap joints below a rig of other names: joint_map chooses."""
    from scipy.spatial.transform import Rotation

    from dancedata.core.errors import UsageError
    from dancedata.datasets.folder import Folder
    from dancedata.synthetic import synthesise_motion
    from tests.formats.test_bvh_retarget import MIXAMO, write_as

    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=60)[0]
    write_as(tmp_path / "a.bvh", motion, SMPL24, Rotation.identity(24), names=MIXAMO.split())
    (tmp_path / "manifest.csv").write_text("motion,unit,joint_map\na.bvh,cm,mixamo\n")
    scan = Folder(music="optional").scan(tmp_path)
    assert any("joint names mixamo (by mixamorig:)" in note for note in scan.notes)
    assert Folder(music="optional", joint_map="xsens").load(scan.clips[0]).n_frames == 60
    (tmp_path / "manifest.csv").write_text("motion,unit\na.bvh,cm\n")
    clip = Folder(music="optional").scan(tmp_path).clips[0]
    with raises_message(DataError, "right_wrist", where="a.bvh", reason="unknown_joints"):
        Folder(joint_map="xsens").load(clip)
    with raises_message(UsageError, "mixano"):
        Folder(joint_map="mixano")
