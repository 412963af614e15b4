"""Maps the joints of a BVH file to SMPL's 24."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from dancedata.core.errors import DataError, did_you_mean
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed, shown
from dancedata.formats.bvh.hierarchy import POSITIONS, ROTATIONS, BvhJoint, bvh_error
from dancedata.formats.bvh.producers import REQUIRED, Detected, detect, refuse_twins

#: Characters of a name that are compared, and the least likeness of one that is suggested.
_COMPARED, _CLOSE = 60, 0.8
SPINE = ("spine1", "spine2", "spine3")


@dataclass(frozen=True)
class JointMap:
    """The mapping of a file's joints, index in SMPL24 -> index in the file, and the producer with evidence."""

    producer: str
    of: Mapping[int, int]

    def text(self, joints: Sequence[BvhJoint]) -> str:
        """Return the mapping as "pelvis = Hips, ...", and SMPL's joints without a counterpart."""
        named = [f"{SMPL24.joints[s]} = {joints[b].name}" for s, b in sorted(self.of.items())]
        missing = [name for s, name in enumerate(SMPL24.joints) if s not in self.of]
        return ", ".join(named) + (f"; none for {', '.join(missing)}" if missing else "")


def map_joints(path: Path, joints: Sequence[BvhJoint], declared: Mapping[str, str] | str | None) -> JointMap:
    """Map SMPL's joints to a file's; DataError if required ones are missing, or the tree is not SMPL's.

    `declared`: A producer, or names that take precedence ("" excludes a joint) over those that are detected.
    Of the joints from the pelvis to where neck and arms branch, the first is spine1, the last spine3.
    """
    chosen, declared = (declared, {}) if isinstance(declared, str) else ("", declared or {})
    # A joint with a namesake above it is the end of that one.
    ends = {k for k, joint in enumerate(joints) if joint.name in {joints[a].name for a in ancestors(joints, k)}}
    names = ["" if k in ends else joint.name for k, joint in enumerate(joints)]
    of = _declared(path, names, declared)
    detected = detect(path, names, declared, chosen)
    of.update(detected.of)
    missing = [name for name in REQUIRED if SMPL24.index(name) not in of]
    if SMPL24.index("neck") not in of and SMPL24.index("head") not in of:
        missing.append("neck or head")
    if missing:
        raise _unknown(path, joints, of, detected, missing)
    _add_spine(joints, of, declared)
    _check_tree(path, joints, of)
    _check_channels(path, joints, of[0])
    return JointMap(str(detected), dict(sorted(of.items())))


def _declared(path: Path, names: Sequence[str], declared: Mapping[str, str]) -> dict[int, int]:
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
                + "correct joint_map, or move files with other skeletons to a separate folder",
            )
        refuse_twins(path, names, joint, [k for k, other in enumerate(names) if name and other == name])
    return {SMPL24.index(joint): names.index(name) for joint, name in declared.items() if name}


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
            raise _bad_map(path, "the joints do not form a human body", found,
                           "a tree like SMPL's, with further joints in between")  # fmt: skip


def _check_channels(path: Path, joints: Sequence[BvhJoint], pelvis: int) -> None:
    above = [pelvis, *ancestors(joints, pelvis)]
    missing = [c for c in (*POSITIONS, *ROTATIONS) if not any(c in joints[k].channels for k in above)]
    if missing:
        raise bvh_error(
            path,
            joints[pelvis].line,
            f"the pelvis {joints[pelvis].name} has no {' and no '.join(missing)}"
            + (", nor has a joint above it" if len(above) > 1 else ""),
            "; ".join(f"{joints[k].name}: CHANNELS {' '.join(joints[k].channels) or 0}" for k in above),
            "three positions and three rotations among them",
            reason="missing_channels",
        )


def _bad_map(path: Path, problem: str, found: str, allowed: str) -> DataError:
    fix = "map the joints in joint_map"
    return DataError(problem, reason="bad_joint_map", where=str(path), found=found, allowed=allowed, fix=fix)


def _unknown(
    path: Path, joints: Sequence[BvhJoint], of: Mapping[int, int], detected: Detected, missing: Sequence[str]
) -> DataError:
    names = [joint.name for joint in joints]
    free = [name for k, name in enumerate(names) if k not in of.values()]
    table = detected.producers[0].joints if detected.producers else {}
    hints = []
    for joint in missing[:4]:
        usual = table.get(joint, (joint,))[0]
        hints.append(f"{joint} is {usual} there, {did_you_mean(usual, free[:40])}")
    return DataError(f"required joints are missing: {', '.join(missing)}", reason="unknown_joints", where=str(path),
                     found=f"{len(names)} joints; closest producer {detected if table else 'none'}",
                     allowed="; ".join(hints), fix="map the joints: joint_map {left_hip: NAME, ...}")  # fmt: skip
