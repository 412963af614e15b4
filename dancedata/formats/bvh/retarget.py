"""Retargets a BVH's skeleton to SMPL's 24 joints: constant rotations, bones with the file's lengths.

Each mapped joint keeps the file's world rotation, up to a constant that rotates SMPL's rest pose into the file's:
world rotation = file's world rotation @ align. `align` follows from the file's rest pose (all angles 0):

- A joint of the back or of a limb: the shortest rotation, applied after its parent's `align`, that maps SMPL's rest
  direction of its bone to the file's. A bone without length has the direction of the next joint along the limb or the
  spine that is elsewhere.
- The pelvis and the joint where neck and arms branch: the rotation that maps left to the file's line between the hips
  (the arms) and comes closest to up: the neck for the chest; for the pelvis the file's up axis, or the spine if that
  is more than 60 degrees away from it.
- Where the rest pose is SMPL's itself, within 1 % of the body, its lines between hips and arms are not taken as
  level: `align` is then one constant rotation, and a file that was written from SMPL comes back as it was.
- Head and neck, whose joints have no standard position: as the pelvis and the chest. Other leaf joints: as their
  parent.

So where nothing moves between two mapped joints, positions agree up to rounding. Where unmapped joints bend in
between (four joints of a spine on SMPL's three), the upper joint is rotated in each frame to point at the lower one.

The rest pose of some files is not a pose of a body (Rokoko's puts both legs and the spine along +X), and directions
of bones do not determine the rotations about them. If a joint's mean rotation relative to its parent exceeds 60
degrees (120 for hips and arms), which no dance has, `align` is rotated back by the nearest multiple of 90 degrees
(180).
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.rest import (
    LEGS,
    PELVIS,
    POINT,
    SMPL_REST,
    Aligner,
    anchor,
    body_size,
    missing_bone,
    norm,
    rest_positions,
)
from dancedata.core.rotations import rotvec_from_matrix, shortest_rotation
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.formats.bvh.joint_names import JointMap, ancestors
from dancedata.formats.bvh.kinematics import bone_offsets, world
from dancedata.formats.bvh.parse import Bvh

Floats = NDArray[np.float64]

#: Largest difference of a left and a right bone that needs no note, as a fraction of the longer one.
_UNEVEN = 0.1
_SAMPLES = 300
#: Largest movement by position channels, as a fraction of the body.
_STRETCH = 0.05
#: A rest pose whose joints are this near SMPL's, as a fraction of the body, is SMPL's; and how many it has to have.
_ALIKE, _SMPL_BODY = 0.01, range(22)
_CHUNK = 4096


@dataclass(frozen=True, eq=False)
class Rig:
    """Mapping from the joints of a BVH to SMPL's.

    `align`: (24, 3, 3); identity for joints without a counterpart.
    `child_of`: The next mapped joint below each joint that has bending unmapped joints in between.
    `offsets`: (24, 3) bones in SMPL's rest pose, in the file's unit; the root's is 0.
    `beyond`: Joints whose bone has no length, and the joint that gives its direction.
    """

    joints: JointMap
    align: Floats
    child_of: Mapping[int, int]
    offsets: Floats
    beyond: Mapping[int, int]


def make_rig(bvh: Bvh, joints: JointMap, up: Floats) -> Rig:
    """Compute the constant rotations and the bones; `up` (3,) is the file's up axis. DataError: ``bad_skeleton``."""
    rest = rest_positions([joint.parent for joint in bvh.joints], bone_offsets(bvh))
    places = {s: rest[b] for s, b in joints.of.items()}
    size = body_size(places)
    _check_bones(bvh, joints, places, size)
    turns = _sampled(bvh, joints)
    maker = Aligner(places, size * POINT, up, turns, level=not _rests_as_smpl(places, size))
    align = maker.run()
    child_of = {s: c for s, c in maker.child_of.items() if _bends(bvh, joints, s, c)}
    return Rig(joints, align, child_of, _bones(places, align, joints), maker.beyond)


def uneven_bones(rig: Rig) -> list[str]:
    """Return the bones of limbs whose left and right lengths differ by more than 10 %, with both lengths."""
    names = {1: "hip", 4: "thigh", 7: "shin", 16: "shoulder", 18: "upper arm", 20: "forearm"}
    uneven = []
    for left, right in (pair for pair in SMPL24.pairs if pair[0] in names):
        a, b = norm(rig.offsets[left]), norm(rig.offsets[right])
        if abs(a - b) > _UNEVEN * max(a, b):
            uneven.append(f"{names[left]} (left {a:.4g}, right {b:.4g})")
    return uneven


def skeleton_of(rig: Rig, metres: float) -> Skeleton:
    """Return SMPL's 24 joints with the file's bones; its name identifies them: "smpl24:bvh-1a2b3c4d"."""
    offsets = rig.offsets * metres
    offsets[PELVIS] = SMPL24.offsets[PELVIS]
    # Rounded to 0.01 mm, so that rounding errors do not change the name. + 0.0 turns -0.0 into 0.0.
    digest = hashlib.sha256((np.round(offsets, 5) + 0.0).astype("<f8").tobytes()).hexdigest()
    return replace(SMPL24, name=f"smpl24:bvh-{digest[:8]}", offsets=offsets, captured=True)


def retarget(bvh: Bvh, rig: Rig, upright: Floats) -> tuple[Floats, Floats]:
    """Return rotations (T, 24, 3), axis-angle to the parents, and the pelvis (T, 3), file's unit; `upright` to +Y."""
    mapped = sorted(rig.joints.of)
    indices = [rig.joints.of[s] for s in mapped]
    rotations = np.empty((bvh.n_frames, 24, 3))
    pelvis = np.empty((bvh.n_frames, 3))
    for start in range(0, bvh.n_frames, _CHUNK):
        rows = slice(start, min(start + _CHUNK, bvh.n_frames))
        turns, places = world(bvh, indices, rows)
        full = _body_rotations(rig, mapped, turns, places)
        full = upright @ full
        local = full.copy()
        for j in range(1, 24):
            local[:, j] = np.swapaxes(full[:, SMPL24.parents[j]], -1, -2) @ full[:, j]
        rotations[rows] = rotvec_from_matrix(local)
        pelvis[rows] = places[:, 0] @ upright.T
    return rotations, pelvis


def _rests_as_smpl(places: Mapping[int, Floats], size: float) -> bool:
    """Return whether a rest pose is SMPL's, turned and scaled: its hips and shoulders are then not level either."""
    joints = sorted(places)
    if len(joints) < len(_SMPL_BODY):
        return False
    at, smpl = np.array([places[j] - places[PELVIS] for j in joints]), SMPL_REST[joints]
    scaled = at * (np.linalg.norm(smpl) / max(float(np.linalg.norm(at)), 1e-300))
    from scipy.spatial.transform import Rotation

    rotation, _ = Rotation.align_vectors(smpl, scaled)
    extent = size * np.linalg.norm(smpl) / max(float(np.linalg.norm(at)), 1e-300)
    return bool(np.linalg.norm(rotation.apply(scaled) - smpl, axis=1).max() < _ALIKE * extent)


def _body_rotations(rig: Rig, mapped: list[int], turns: Floats, places: Floats) -> Floats:
    """Return world rotations (T, 24, 3, 3) of SMPL's joints; one without a counterpart rotates with its parent."""
    full = np.empty((len(turns), 24, 3, 3))
    for j in range(24):
        if j not in rig.joints.of:
            full[:, j] = full[:, SMPL24.parents[j]]
            continue
        full[:, j] = turns[:, mapped.index(j)] @ rig.align[j]
        if j in rig.child_of:
            child = rig.child_of[j]
            to = places[:, mapped.index(child)] - places[:, mapped.index(j)]
            full[:, j] = shortest_rotation(full[:, j] @ rig.offsets[child], to) @ full[:, j]
    return full


def _check_bones(bvh: Bvh, joints: JointMap, places: Mapping[int, Floats], size: float) -> None:
    where, fix = str(bvh.path), "export the file again with the skeleton of the capture"
    if (bone := missing_bone(places, size)) is not None:
        a, b, length, least = bone
        raise DataError(
            f"{bvh.joints[joints.of[a]].name} and {bvh.joints[joints.of[b]].name} are at the same position",
            reason="bad_skeleton",
            where=where,
            found=f"a distance of {length:.4g} in a body of {size:.4g}",
            allowed=f"more than {least:.4g}",
            fix=fix,
        )
    for k, joint in enumerate(bvh.joints):
        columns = list(joint.position_columns.values())
        if columns and len(bvh.values) and joints.of[PELVIS] in ancestors(bvh.joints, k):
            moved = np.ptp(bvh.values[:, columns], axis=0).max()
            if moved > _STRETCH * size:
                raise DataError(f"the bone of {joint.name} changes its length, but SMPL's bones are rigid",
                                reason="bad_skeleton", where=where,
                                found=f"its position channels move by {moved:.4g} in a body of {size:.4g}",
                                allowed=f"at most {_STRETCH:.0%} of the body",
                                fix="export with fixed bone lengths (rotations only)")  # fmt: skip


def _bones(places: Mapping[int, Floats], align: Floats, joints: JointMap) -> Floats:
    """Return the offsets (24, 3) in SMPL's rest pose, in the file's unit."""
    bones, smpl = (sum(norm(at[b] - at[a]) for a, b in LEGS) for at in (places, SMPL_REST))
    scale = bones / smpl
    inner = set(SMPL24.parents)
    offsets = np.zeros((24, 3))
    for j in range(1, 24):
        if j in joints.of:
            above = anchor(j, places)
            offsets[j] = align[above].T @ (places[j] - places[above])
        elif j not in inner:
            offsets[j] = SMPL24.offsets[j] * scale
    return offsets


def _sampled(bvh: Bvh, joints: JointMap) -> dict[int, Floats]:
    """Return world rotations (n, 3, 3) of the mapped joints in up to 300 frames; empty without all frames."""
    if len(bvh.values) < bvh.n_frames:
        return {}
    step = -(-len(bvh.values) // _SAMPLES)
    turns, _ = world(bvh, list(joints.of.values()), slice(None, None, step))
    return {s: turns[:, k] for k, s in enumerate(joints.of)}


def _bends(bvh: Bvh, joints: JointMap, joint: int, child: int) -> bool:
    k = bvh.joints[joints.of[child]].parent
    while k != joints.of[joint]:
        if bvh.joints[k].order:
            return True
        k = bvh.joints[k].parent
    return False
