"""Maps the joints of a BVH file to SMPL's 24 by the names in common use."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from dancedata.core.errors import DataError, did_you_mean
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed, shown
from dancedata.formats.bvh.hierarchy import BvhJoint

#: SMPL's joints that a skeleton must have; neck or head is required as well.
REQUIRED = tuple(
    ["pelvis"]
    + [f"{s}_{j}" for j in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist") for s in ("left", "right")]
)
#: Characters of a name that are compared, and the least likeness of one that is suggested.
_COMPARED, _CLOSE = 60, 0.8
SPINE = ("spine1", "spine2", "spine3")

_UP_LEG = {
    "pelvis": "Hips",
    "{side}_hip": "{Side}UpLeg",
    "{side}_knee": "{Side}Leg",
    "{side}_ankle": "{Side}Foot",
    "{side}_foot": "{Side}ToeBase {Side}Toe",
    "{side}_collar": "{Side}Shoulder",
    "{side}_shoulder": "{Side}Arm",
    "{side}_elbow": "{Side}ForeArm",
    "{side}_wrist": "{Side}Hand",
    "{side}_hand": "{Side}HandMiddle1 {Side}InHandMiddle {S}Fingers {Side}HandIndex1 {Side}HandEnd",
    "neck": "Neck1 Neck",
    "head": "Head",
}
_LIMBS = ("Hip", "Knee", "Ankle", "Foot", "Collar", "Shoulder", "Elbow", "Wrist", "Hand")
_SMPL = {
    "pelvis": "Pelvis",
    **{f"{{side}}_{limb.lower()}": f"{{Side}}{limb} {{S}}{limb}" for limb in _LIMBS},
    "neck": "Neck",
    "head": "Head",
}
_XSENS_JOINTS = {
    "pelvis": "Hips",
    **{f"{{side}}_{limb.lower()}": f"{{Side}}{limb}" for limb in _LIMBS},
    "{side}_foot": "{Side}Toe",
    "neck": "Neck",
    "head": "Head",
}
_XSENS_SEGMENTS = {
    "pelvis": "Pelvis Hips",
    "{side}_hip": "{Side}UpperLeg",
    "{side}_knee": "{Side}LowerLeg",
    "{side}_ankle": "{Side}Foot",
    "{side}_foot": "{Side}Toe",
    "{side}_collar": "{Side}Shoulder",
    "{side}_shoulder": "{Side}UpperArm",
    "{side}_elbow": "{Side}ForeArm {Side}LowerArm",
    "{side}_wrist": "{Side}Hand",
    "neck": "Neck",
    "head": "Head",
}


def _both_sides(table: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Expand a table for both sides: SMPL joint -> names, the preferred one first."""
    expanded = {}
    for joint, names in table.items():
        for side in ("left", "right") if "{" in joint else ("",):
            filled = names.format(Side=side.capitalize(), S=side[:1].upper())
            expanded[joint.format(side=side)] = tuple(filled.split())
    return expanded


#: The known styles, SMPL joint -> names. Namespaces ("mixamorig:"), case, spaces and _ - . are ignored.
STYLES: dict[str, dict[str, tuple[str, ...]]] = {
    "UpLeg/ForeArm (CMU, Mixamo, Rokoko, LaFAN, FAIR)": _both_sides(_UP_LEG),
    "Hip/Elbow (Xsens joints)": _both_sides(_XSENS_JOINTS),
    "UpperLeg/LowerLeg (Xsens segments)": _both_sides(_XSENS_SEGMENTS),
    "SMPL": _both_sides(_SMPL),
}


@dataclass(frozen=True)
class JointMap:
    """The mapping of a file's joints.

    Attributes
    ----------
    style
        Name of the matching style, "" if all names were given.
    of
        Index in SMPL24 -> index in the file.
    """

    style: str
    of: Mapping[int, int]

    def text(self, joints: Sequence[BvhJoint]) -> str:
        """Return the mapping as "pelvis = Hips, ...", and SMPL's joints without a counterpart."""
        named = [f"{SMPL24.joints[s]} = {joints[b].name}" for s, b in sorted(self.of.items())]
        missing = [name for s, name in enumerate(SMPL24.joints) if s not in self.of]
        return ", ".join(named) + (f"; none for {', '.join(missing)}" if missing else "")


def map_joints(path: Path, joints: Sequence[BvhJoint], declared: Mapping[str, str] | None) -> JointMap:
    """Map SMPL's joints to a file's.

    Names in `declared` take precedence ("" excludes a joint); the others follow the style that matches the most
    joints. The spine follows from the tree: of the joints from the pelvis to the joint where neck and arms
    branch, the first is spine1, the last spine3, the middle one spine2.

    Raises
    ------
    DataError
        ``unknown_joints`` if required ones are missing or a declared name is not in the file;
        ``bad_joint_map`` if the file's tree differs from SMPL's: a knee that is not below its hip.
    """
    declared = declared or {}
    of = _declared(path, joints, declared)
    style = _add_style(joints, of, declared)
    missing = [name for name in REQUIRED if SMPL24.index(name) not in of]
    if SMPL24.index("neck") not in of and SMPL24.index("head") not in of:
        missing.append("neck or head")
    if missing:
        raise _unknown(path, joints, of, style, missing)
    _add_spine(joints, of, declared)
    _check_tree(path, joints, of)
    return JointMap(style, dict(sorted(of.items())))


def _declared(path: Path, joints: Sequence[BvhJoint], declared: Mapping[str, str]) -> dict[int, int]:
    names = [joint.name for joint in joints]
    for joint, name in declared.items():
        if name and name not in names:
            # As shown in messages, so that a name of any length is compared in bounded time.
            close = get_close_matches(shown(name, _COMPARED), [shown(n, _COMPARED) for n in names], 1, _CLOSE)
            raise DataError(
                f"joint_map: the file has no joint {name!r} for {joint}",
                reason="unknown_joints",
                where=str(path),
                found=f"{len(names)} joints",
                allowed=listed(names),
                fix=(f"did you mean {close[0]!r}? " if close else "")
                + "correct joint_map, or move files with other skeletons to a folder of their own",
            )
    return {SMPL24.index(joint): names.index(name) for joint, name in declared.items() if name}


def _add_style(joints: Sequence[BvhJoint], of: dict[int, int], declared: Mapping[str, str]) -> str:
    """Add the joints of the best matching style; return its name."""
    plain: dict[str, int] = {}
    for k, joint in enumerate(joints):
        plain.setdefault(_plain(joint.name), k)
    best: dict[int, int] = {}
    best_style = ""
    for style, table in STYLES.items():
        matches = {}
        for smpl, usual in table.items():
            index = next((plain[_plain(n)] for n in usual if _plain(n) in plain), None)
            if index is not None and smpl not in declared and index not in of.values():
                matches[SMPL24.index(smpl)] = index
        if len(matches) > len(best):
            best, best_style = matches, style
    of.update(best)
    return best_style


def _plain(name: str) -> str:
    """Return the name without namespace, case, spaces and separators."""
    return re.sub(r"[\s_.\-]", "", re.split(r"[:|]", name)[-1]).lower()


def _add_spine(joints: Sequence[BvhJoint], of: dict[int, int], declared: Mapping[str, str]) -> None:
    """Map the spine by the tree, unless joint_map contains any of it."""
    if any(name in declared for name in SPINE):
        return
    upper = [SMPL24.index(n) for n in ("neck", "left_collar", "right_collar", "left_shoulder", "right_shoulder")]
    lines = [ancestors(joints, of[s]) for s in upper if s in of]
    pelvis = of[0]
    shared = [b for b in lines[0] if all(b in line for line in lines)]
    # From the joint where neck and arms branch down to the pelvis.
    chain = shared[: shared.index(pelvis)] if pelvis in shared else []
    chain = [b for b in chain if b not in of.values()]
    if chain:
        of[SMPL24.index("spine1")] = chain[-1]
    if len(chain) > 1:
        of[SMPL24.index("spine3")] = chain[0]
    if len(chain) > 2:
        of[SMPL24.index("spine2")] = chain[(len(chain) - 1) // 2]


def ancestors(joints: Sequence[BvhJoint], joint: int) -> list[int]:
    """Return the ancestors of a joint, the nearest first."""
    line = []
    while (joint := joints[joint].parent) != -1:
        line.append(joint)
    return line


def _check_tree(path: Path, joints: Sequence[BvhJoint], of: Mapping[int, int]) -> None:
    seen: dict[int, int] = {}
    for smpl, bvh in sorted(of.items()):
        name = joints[bvh].name
        if bvh in seen:
            both = f"{SMPL24.joints[seen[bvh]]} and {SMPL24.joints[smpl]}"
            raise _bad_map(path, f"{name} is mapped to two joints", both, "one joint each")
        seen[bvh] = smpl
        above = SMPL24.parents[smpl]
        while above != -1 and above not in of:
            above = SMPL24.parents[above]
        if above != -1 and of[above] not in ancestors(joints, bvh):
            pair = f"{joints[of[above]].name} ({SMPL24.joints[above]})"
            found = f"{name} ({SMPL24.joints[smpl]}), which is not below {pair}"
            raise _bad_map(
                path,
                "the joints do not form a human body",
                found,
                "a tree like SMPL's, with further joints in between",
            )


def _bad_map(path: Path, problem: str, found: str, allowed: str) -> DataError:
    fix = "map the joints in joint_map"
    return DataError(problem, reason="bad_joint_map", where=str(path), found=found, allowed=allowed, fix=fix)


def _unknown(
    path: Path, joints: Sequence[BvhJoint], of: Mapping[int, int], style: str, missing: Sequence[str]
) -> DataError:
    names = [joint.name for joint in joints]
    free = [name for k, name in enumerate(names) if k not in of.values()]
    table = STYLES.get(style, {})
    hints = []
    for joint in missing[:4]:
        usual = table.get(joint, (joint,))[0]
        hints.append(f"{joint} is {usual} in that style, {did_you_mean(usual, free[:40])}")
    return DataError(
        f"required joints are missing: {', '.join(missing)}",
        reason="unknown_joints",
        where=str(path),
        found=f"{len(names)} joints; closest style {style or 'none'}",
        allowed="; ".join(hints),
        fix="map the joints: joint_map {left_hip: NAME, ...}",
    )
