"""Producers of BVH: found by joint names, with evidence; ambiguity is an error."""

import re
from itertools import pairwise
from pathlib import Path

import pytest

from dancedata.core.errors import DataError
from dancedata.core.skeleton import SMPL24
from dancedata.formats.bvh.hierarchy import POSITIONS, ROTATIONS, BvhJoint
from dancedata.formats.bvh.joint_names import map_joints
from dancedata.formats.bvh.producers import REQUIRED, detect, producers
from tests.messages import raises_message

UP_LEG = """Hips LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot RightToeBase Spine Spine1 Neck
    Head LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm RightHand"""
XSENS = """Hips Chest Chest2 Chest3 Chest4 Neck Head RightCollar RightShoulder RightElbow RightWrist LeftCollar
    LeftShoulder LeftElbow LeftWrist RightHip RightKnee RightAnkle RightToe LeftHip LeftKnee LeftAnkle LeftToe"""
ROKOKO = """Hips Spine1 Spine2 Spine3 Spine4 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder
    RightArm RightForeArm RightHand LeftThigh LeftShin LeftFoot LeftToe RightThigh RightShin RightFoot RightToe"""
SIDES = {"{Side}": ("Left", "Right"), "{S}": ("L", "R"), "{s}": ("l", "r")}


def both(names: str) -> str:
    """Write names with a side once for each side."""
    filled = []
    for name in names.split():
        key = next((key for key in SIDES if key in name), "")
        filled += [name.replace(key, side) for side in SIDES[key]] if key else [name]
    return " ".join(filled)


FINGERS = " ".join(f"{side}Hand{finger}1" for side in ("Left", "Right") for finger in ("Thumb", "Middle", "Pinky"))
BIPED = """Pelvis Spine Spine1 Neck Head {S}_Thigh {S}_Calf {S}_Foot {S}_Toe0 {S}_Clavicle {S}_UpperArm {S}_Forearm
    {S}_Hand"""
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
    "bandai-namco": both("""joint_Root Hips Spine Chest Neck Head Shoulder_{S} UpperArm_{S} LowerArm_{S} Hand_{S}
        UpperLeg_{S} LowerLeg_{S} Foot_{S} Toes_{S}"""),
    "deepmotion": both("""hips_JNT spine_JNT spine1_JNT spine2_JNT neck_JNT head_JNT {s}_shoulder_JNT {s}_arm_JNT
        {s}_forearm_JNT {s}_hand_JNT {s}_handThumb1_JNT {s}_upleg_JNT {s}_leg_JNT {s}_foot_JNT {s}_toebase_JNT"""),
    "biovision": both("""Hip Chest Neck Head {Side}Collar {Side}UpArm {Side}LowArm {Side}Hand {Side}UpLeg {Side}LowLeg
        {Side}Foot"""),
    "unreal": both("""root pelvis spine_01 spine_02 spine_03 neck_01 head clavicle_{s} upperarm_{s}
        upperarm_twist_01_{s} lowerarm_{s} hand_{s} middle_01_{s} thigh_{s} thigh_twist_01_{s} calf_{s} foot_{s}
        ball_{s} ik_foot_{s}"""),
    "rigify": both("""spine spine.001 spine.002 spine.003 spine.004 spine.005 spine.006 pelvis.{S} thigh.{S} shin.{S}
        foot.{S} toe.{S} heel.02.{S} shoulder.{S} upper_arm.{S} forearm.{S} hand.{S} f_middle.01.{S}"""),
    "rigify, with a prefix": both("""root DEF-spine DEF-spine.001 DEF-spine.004 DEF-spine.006 DEF-thigh.{S}
        DEF-thigh.{S}.001 DEF-shin.{S} DEF-shin.{S}.001 DEF-foot.{S} DEF-toe.{S} DEF-shoulder.{S} DEF-upper_arm.{S}
        DEF-upper_arm.{S}.001 DEF-forearm.{S} DEF-hand.{S}"""),
    "rigify, old names": both("""hips spine chest neck head thigh.{S} shin.{S} foot.{S} shoulder.{S} upper_arm.{S}
        forearm.{S} hand.{S}"""),
    "daz, Genesis 8": both("""hip pelvis {s}ThighBend {s}ThighTwist {s}Shin {s}Foot {s}Metatarsals {s}Toe abdomenLower
        abdomenUpper chestLower chestUpper {s}Collar {s}ShldrBend {s}ShldrTwist {s}ForearmBend {s}ForearmTwist {s}Hand
        neckLower neckUpper head"""),
    "daz, Genesis 9": both("""hip pelvis {s}_thigh {s}_shin {s}_foot {s}_toes spine1 spine2 spine3 spine4 {s}_shoulder
        {s}_upperarm {s}_forearm {s}_hand neck1 neck2 head"""),
    "daz, cgspeed's CMU": both("""hip abdomen chest neck head leftEye rightEye {s}Collar {s}Shldr {s}ForeArm {s}Hand
        {s}Thumb1 {s}Mid1 {s}Buttock {s}Thigh {s}Shin {s}Foot"""),
    "100style or xsens, cgspeed's CMU for 3ds Max": both("""Hips Chest Neck Head {Side}Collar {Side}Shoulder
        {Side}Elbow {Side}Wrist {Side}Hip {Side}Knee {Side}Ankle {Side}Toe Chest2"""),
    "100style or xsens, one hip": both("""Hip Abdomen Chest Chest2 Neck Head {Side}Collar {Side}Shoulder {Side}Elbow
        {Side}Wrist {Side}Hip {Side}Knee {Side}Ankle"""),
    "humanik": "Reference Character1_Reference " + " ".join(f"Character1_{name}" for name in UP_LEG.split()),
    "ipi": both("""Hip LowerSpine MiddleSpine Chest Neck Head {S}Clavicle {S}Shoulder {S}Forearm {S}Hand {S}Thigh
        {S}Shin {S}Foot {S}Toe"""),
    "smpl": " ".join(SMPL24.joints),
    "smpl, short names": both("""Pelvis {S}_Hip Spine1 {S}_Knee Spine2 {S}_Ankle Spine3 {S}_Foot Neck {S}_Collar Head
        {S}_Shoulder {S}_Elbow {S}_Wrist {S}_Hand"""),
    "xsens-segments": both("""Pelvis {Side}UpperLeg L5 {Side}LowerLeg L3 {Side}Foot T12 {Side}Toe Neck {Side}Shoulder
        Head {Side}UpperArm {Side}ForeArm {Side}Hand {Side}Finger"""),
    "motive": both("Hip Ab Chest Neck Head {S}Shoulder {S}UArm {S}FArm {S}Hand {S}Thigh {S}Shin {S}Foot {S}Toe"),
    "vroid": both("""J_Bip_C_Hips J_Bip_C_Spine J_Bip_C_Chest J_Bip_C_Neck J_Bip_C_Head J_Bip_{S}_Shoulder
        J_Bip_{S}_UpperArm J_Bip_{S}_LowerArm J_Bip_{S}_Hand J_Bip_{S}_UpperLeg J_Bip_{S}_LowerLeg J_Bip_{S}_Foot"""),
    "biped, Character Creator": both("""CC_Base_BoneRoot CC_Base_Hip CC_Base_Pelvis CC_Base_{S}_Thigh CC_Base_{S}_Calf
        CC_Base_{S}_Foot CC_Base_Waist CC_Base_NeckTwist01 CC_Base_Head CC_Base_{S}_Clavicle CC_Base_{S}_Upperarm
        CC_Base_{S}_Forearm CC_Base_{S}_Hand"""),
    **{
        f"biped, {prefix}": both(" ".join(f"{prefix}{name}" for name in BIPED.split()))
        for prefix in ("Bip01_", "Bip001_", "ValveBiped.Bip01_", "")
    },
}
HERE = Path("a.bvh")


@pytest.mark.parametrize("producer", FILES)
def test_producers_are_found_by_their_names(producer: str) -> None:
    names = FILES[producer].split()
    found = detect(HERE, names, {})
    assert str(found).partition(" (by ")[0] == producer.partition(",")[0]
    assert found.evidence
    assert {SMPL24.index(joint) for joint in REQUIRED} <= set(found.of)
    named = {SMPL24.joints[s]: names[k].rpartition(":")[2] for s, k in found.of.items()}
    assert re.search("hip|pelvis|DEF-spine$|^spine$", named["pelvis"], re.IGNORECASE)
    for joint, name in named.items():
        if joint.startswith("left_") and joint != "left_hand":
            assert re.search(r"Left|(^|_)l|[_.\-]l\b|_l_|L", name), joint
            assert name != named[joint.replace("left", "right")]


def chains(text: str) -> list[BvhJoint]:
    """Joints of lines such as "hip pelvis lThigh": each is below the one before it."""
    parents: dict[str, str] = {}
    for line in both_lines(text):
        for above, name in pairwise(line.split()):
            parents.setdefault(name, above)
    root = next(name for name in parents.values() if name not in parents)
    names = [root, *parents]
    six = (*POSITIONS, *ROTATIONS)
    return [BvhJoint(n, names.index(parents[n]) if n in parents else -1, (0, 1, 0), six, 0, 1) for n in names]


def both_lines(text: str) -> list[str]:
    lines = []
    for line in text.strip().splitlines():
        key = next((key for key in SIDES if key in line), "")
        lines += [line.replace(key, side) for side in SIDES[key]] if key else [line]
    return lines


#: Trees that differ from SMPL's: what is mapped to pelvis, spine1, spine3, neck, left_hip, left_shoulder.
TREES = {
    "daz": (
        """hip abdomenLower abdomenUpper chestLower chestUpper neckLower neckUpper head
        hip pelvis {s}ThighBend {s}ThighTwist {s}Shin {s}Foot {s}Toe
        chestUpper {s}Collar {s}ShldrBend {s}ShldrTwist {s}ForearmBend {s}ForearmTwist {s}Hand""",
        "hip abdomenLower chestUpper neckLower lThighBend lShldrBend",
    ),
    "daz, cgspeed": (
        """hip abdomen chest neck head
        chest {s}Collar {s}Shldr {s}ForeArm {s}Hand
        hip {s}Buttock {s}Thigh {s}Shin {s}Foot""",
        "hip abdomen chest neck lThigh lShldr",
    ),
    "biped, clavicles below the neck": (
        """Bip01 Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Neck Bip01_Head
        Bip01_Neck Bip01_{S}_Clavicle Bip01_{S}_UpperArm Bip01_{S}_Forearm Bip01_{S}_Hand
        Bip01_Pelvis Bip01_{S}_Thigh Bip01_{S}_Calf Bip01_{S}_Foot Bip01_{S}_Toe0""",
        "Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Neck Bip01_L_Thigh Bip01_L_UpperArm",
    ),
    "biped, thighs below the spine": (
        """Bip01 Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Neck Bip01_Head
        Bip01_Spine1 Bip01_{S}_Clavicle Bip01_{S}_UpperArm Bip01_{S}_Forearm Bip01_{S}_Hand
        Bip01_Spine Bip01_{S}_Thigh Bip01_{S}_Calf Bip01_{S}_Foot""",
        "Bip01_Pelvis Bip01_Spine Bip01_Spine1 Bip01_Neck Bip01_L_Thigh Bip01_L_UpperArm",
    ),
    "biped, Character Creator": (
        """CC_Base_BoneRoot CC_Base_Hip CC_Base_Waist CC_Base_Spine01 CC_Base_Spine02 CC_Base_NeckTwist01 CC_Base_Head
        CC_Base_Hip CC_Base_Pelvis CC_Base_{S}_Thigh CC_Base_{S}_Calf CC_Base_{S}_Foot
        CC_Base_Spine02 CC_Base_{S}_Clavicle CC_Base_{S}_Upperarm CC_Base_{S}_Forearm CC_Base_{S}_Hand""",
        "CC_Base_Hip CC_Base_Waist CC_Base_Spine02 CC_Base_NeckTwist01 CC_Base_L_Thigh CC_Base_L_Upperarm",
    ),
    "rigify": (
        """spine spine.001 spine.002 spine.003 spine.004 spine.005 spine.006
        spine.003 shoulder.{S} upper_arm.{S} forearm.{S} hand.{S}
        spine pelvis.{S}
        spine thigh.{S} shin.{S} foot.{S} toe.{S}""",
        "spine spine.001 spine.003 spine.004 thigh.L upper_arm.L",
    ),
}


@pytest.mark.parametrize("producer", TREES)
def test_trees_of_producers(producer: str) -> None:
    text, mapped = TREES[producer]
    joints = chains(text)
    found = map_joints(HERE, joints, None)
    of = [joints[found.of[s]].name for s in (0, 3, 9, 12, 1, 16)]
    assert found.producer.startswith(producer.partition(",")[0])
    assert " ".join(of) == mapped


@pytest.mark.parametrize(
    ("prefix", "suffix"),
    [("mixamorig_", ""), ("mixamorig", ""), ("Character1_", ""), ("Skeleton_", ""), ("A:b_", ""), ("anna-", ""),
     ("x", "_jnt"), ("", ".001"), ("\u821e_", ""), ("Left_", ""), ("Hips_", "_Hand")],
)  # fmt: skip
@pytest.mark.parametrize("producer", ["cmu", "xsens", "unreal"])
def test_names_with_a_prefix_or_suffix_that_all_share(producer: str, prefix: str, suffix: str) -> None:
    """Joints without it, such as a root of another name, are none of the body's."""
    plain = UP_LEG.split() if producer == "cmu" else FILES[producer].split() if producer in FILES else XSENS.split()
    found = detect(HERE, ["Armature", *(f"{prefix}{name}{suffix}" for name in plain), "Hand"], {})
    expected = detect(HERE, plain, {})
    assert found.of == {s: k + 1 for s, k in expected.of.items()}
    assert {p.joints == expected.producers[0].joints for p in found.producers} == {True}
    assert found.affixes == (prefix, suffix) or ":" in prefix


def test_two_people_by_prefix_are_ambiguous() -> None:
    for between in (":", "_"):
        names = [f"{person}{between}{name}" for person in ("anna", "ben") for name in UP_LEG.split()]
        with raises_message(DataError, "joint_map", where="a.bvh", reason="ambiguous_joint_map"):
            detect(HERE, names, {})
    mine = {joint: f"anna_{name}" for joint, name in (("left_hip", "LeftUpLeg"), ("left_knee", "LeftLeg"))}
    with raises_message(DataError, "joint_map", reason="ambiguous_joint_map"):
        detect(HERE, names, mine)


def test_real_captures(shared: Path) -> None:
    from dancedata.formats.bvh.parse import read_bvh_header

    of = {"cmu_01_01": "cmu", "fair1_dab": "fair", "rokoko_jesse_dance": "rokoko-humanik"}
    for file, producer in of.items():
        joints = read_bvh_header(shared / "realdata" / "bvh" / f"{file}.bvh").joints
        assert [p.name for p in detect(HERE, [joint.name for joint in joints], {}).producers] == [producer]


def test_a_file_with_the_joints_of_two_producers_is_ambiguous() -> None:
    names = [*UP_LEG.split(), *(set(XSENS.split()) - set(UP_LEG.split()))]
    with raises_message(DataError, "producers", where="a.bvh", reason="ambiguous_joint_map"):
        detect(HERE, sorted(names), {})
    chosen = detect(HERE, names, {}, "xsens")
    assert [p.name for p in chosen.producers] == ["xsens"]
    assert names[chosen.of[SMPL24.index("left_hip")]] == "LeftHip"
    assert names[detect(HERE, names, {}, "mixamo").of[SMPL24.index("left_hip")]] == "LeftUpLeg"


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
