"""SMPL-X's skeleton and its subsets, and transfer of motion between the skeletons of the SMPL family."""

from typing import Literal

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array, matrix_from_rotvec, rotvec_from_matrix, shortest_rotation
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE, Skeleton

_FINGERS = ("index", "middle", "pinky", "ring", "thumb")

#: The 22 joints that SMPL, SMPL-H and SMPL-X share, in their common order.
BODY_JOINTS = SMPL24.joints[:22]
_FACE = ("jaw", "left_eye", "right_eye")
#: The joints of limbs, each with the next one: the end of the bone that it turns.
_LIMBS = {1: 4, 2: 5, 4: 7, 5: 8, 7: 10, 8: 11, 13: 16, 14: 17, 16: 18, 17: 19, 18: 20, 19: 21}
#: Rotations that differ from none by less than this, radians, are rounding errors.
_ALIKE = 1e-4
_HANDS = tuple(f"{side}_{finger}{k}" for side in ("left", "right") for finger in _FINGERS for k in (1, 2, 3))

#: Rest positions of the neutral SMPL-X body as Lodge and FineDance publish them (five decimals), metres.
_SMPLX_REST = np.array(
    (
        # The body and the face; then a line for each finger.
        (0.00312, -0.35141, 0.01204), (0.06131, -0.44417, -0.01396), (-0.06014, -0.45532, -0.00921),
        (0.00036, -0.24152, -0.01558), (0.11601, -0.82292, -0.02336), (-0.10435, -0.81770, -0.02604),
        (0.00981, -0.10966, -0.02152), (0.07255, -1.22598, -0.05524), (-0.08894, -1.22842, -0.04623),
        (-0.00152, -0.05743, 0.00693), (0.11981, -1.28398, 0.06298), (-0.12775, -1.28675, 0.07282),
        (-0.01369, 0.10774, -0.02469), (0.04484, 0.02752, -0.00029), (-0.04922, 0.02691, -0.00647),
        (0.01110, 0.26819, -0.00395), (0.16408, 0.08524, -0.01576), (-0.15179, 0.08043, -0.01914),
        (0.41820, 0.01309, -0.05821), (-0.42294, 0.04394, -0.04561), (0.67019, 0.03631, -0.06069),
        (-0.67221, 0.03941, -0.06093), (-0.00467, 0.26767, -0.00959), (0.03160, 0.31083, 0.06220),
        (-0.03160, 0.31083, 0.06219),
        (0.77209, 0.02763, -0.04134), (0.80404, 0.02984, -0.03832), (0.82659, 0.02749, -0.03827),
        (0.77959, 0.02999, -0.06467), (0.81020, 0.03079, -0.06869), (0.83371, 0.02879, -0.07280),
        (0.75424, 0.02177, -0.10444), (0.76971, 0.02064, -0.11644), (0.78524, 0.01898, -0.12765),
        (0.76763, 0.02705, -0.08803), (0.79568, 0.02853, -0.09330), (0.81850, 0.02707, -0.10039),
        (0.71083, 0.01834, -0.03508), (0.72784, 0.01931, -0.01010), (0.74837, 0.01415, 0.00543),
        (-0.77209, 0.02763, -0.04133), (-0.80404, 0.02984, -0.03832), (-0.82659, 0.02750, -0.03827),
        (-0.77959, 0.02999, -0.06467), (-0.81020, 0.03080, -0.06869), (-0.83371, 0.02879, -0.07281),
        (-0.75424, 0.02178, -0.10444), (-0.76971, 0.02064, -0.11644), (-0.78524, 0.01898, -0.12765),
        (-0.76764, 0.02705, -0.08803), (-0.79568, 0.02853, -0.09330), (-0.81850, 0.02707, -0.10039),
        (-0.71082, 0.01834, -0.03507), (-0.72784, 0.01931, -0.01010), (-0.74837, 0.01415, 0.00543),
    )
)  # fmt: skip


def _smplx55() -> Skeleton:
    joints = (*BODY_JOINTS, *_FACE, *_HANDS)
    parents = [*SMPL24.parents[:22], 15, 15, 15]
    for wrist, first in ((20, 25), (21, 40)):
        for finger in range(5):
            begin = first + 3 * finger
            parents += [wrist, begin, begin + 1]
    offsets = _SMPLX_REST.copy()
    offsets[1:] -= _SMPLX_REST[parents[1:]]
    pairs = [*SMPL24.pairs[:8], (23, 24), *((j, j + 15) for j in range(25, 40))]
    return Skeleton("smplx55", joints, tuple(parents), offsets, tuple(pairs), SMPL24.feet)


#: The neutral SMPL-X body; kinematics add joint 0's rest position.
SMPLX55 = _smplx55()
#: The same without jaw and eyes: FineDance's 52 joints, in SMPL-H's order.
SMPLX52 = SMPLX55.subset("smplx52", (*BODY_JOINTS, *_HANDS))
#: The body alone, as in Lodge's 139 columns.
SMPLX22 = SMPLX55.subset("smplx22", BODY_JOINTS)


def _smplh52() -> Skeleton:
    offsets = np.array(SMPLX52.offsets)
    offsets[:22] = SMPL24.offsets[:22]
    return Skeleton("smplh52", SMPLX52.joints, SMPLX52.parents, offsets, SMPLX52.pairs, SMPLX52.feet)


#: SMPL-H: the body of SMPL (as in SMPL24), with SMPL-X's fingers at its wrists.
SMPLH52 = _smplh52()

#: Joints of Motorica's BVH files without the fingers, each with its parent and its usual offset in centimetres
#: (mean bones of the features that LDA's repository publishes; Alexanderson et al. 2023).
_MOTORICA_BONES = (
    ("Hips", "", (0, 0, 0)),
    ("Spine", "Hips", (0, 7.8, 0)),
    ("Spine1", "Spine", (0, 22.7, 0)),
    ("Neck", "Spine1", (0, 24.9, 0)),
    ("Head", "Neck", (0, 14.8, 1.2)),
    *(
        (f"{side}{name}", f"{side}{parent}" if parent != "Spine1" else parent, (sign * x, y, 0))
        for side, sign in (("Left", 1), ("Right", -1))
        for name, parent, x, y in (
            ("Shoulder", "Spine1", 3.8, 20.8),
            ("Arm", "Shoulder", 12.5, 0),
            ("ForeArm", "Arm", 28.7, 0),
            ("Hand", "ForeArm", 23.6, 0),
        )
    ),
    *(
        (f"{side}{name}", f"{side}{parent}" if parent != "Hips" else parent, (sign * x, y, z))
        for side, sign in (("Left", 1), ("Right", -1))
        for name, parent, x, y, z in (
            ("UpLeg", "Hips", 9.5, 0, 0),
            ("Leg", "UpLeg", 0, -35.7, 0),
            ("Foot", "Leg", 0, -40.6, 0),
            ("ToeBase", "Foot", 0, -6, 13),
        )
    ),
)


def _motorica21() -> Skeleton:
    joints = tuple(name for name, *_ in _MOTORICA_BONES)
    parents = tuple(joints.index(parent) if parent else -1 for _, parent, _ in _MOTORICA_BONES)
    pairs = tuple((j, joints.index(f"Right{name[4:]}")) for j, name in enumerate(joints) if name.startswith("Left"))
    offsets = np.array([offset for *_, offset in _MOTORICA_BONES], dtype=np.float64) / 100
    return Skeleton("motorica21", joints, parents, offsets, pairs, (15, 19, 16, 20))


#: The body of Motorica Dance, the root at the translation; recordings have the same joints with their own bones.
MOTORICA21 = _motorica21()

#: The skeletons of the package, by name.
SKELETONS = {s.name: s for s in (SMPL24, SMPL24_EDGE, SMPLX22, SMPLX52, SMPLX55, MOTORICA21)}

#: In the cache keys of motion that crosses from one body to another; raised by hand when it gets other numbers there.
CROSSING = 2

#: What to do with motion on a skeleton of another family.
RETARGET = "put the motions on SMPL's joints by the transform retarget: --set transforms.retarget.skeleton=smpl24"


def changes_body(source: Skeleton | None, target: Skeleton) -> bool:
    """Return whether motion on a body gets another translation on another one; None is an unknown body."""
    return source is None or not np.array_equal(source.offsets[0], target.offsets[0])


def has_body(skeleton: Skeleton) -> bool:
    """Return whether a skeleton begins with the 22 body joints that SMPL, SMPL-H and SMPL-X share."""
    return skeleton.joints[:22] == BODY_JOINTS


def limb_alignment(source: Skeleton, target: Skeleton) -> dict[int, Float64Array]:
    """Return the rotations that align the limbs of two bodies at rest, by joint; none where they point alike.

    A joint of `target` whose rotation in the world is that of `source`, times this (3, 3), points its bone as the
    source does. SMPL's and SMPL-X's limbs differ by up to 12.9 degrees. The back, the head, hands and toes, whose
    joints are at other places in other bodies, keep their rotations.
    """
    turns = {}
    for joint, below in _LIMBS.items():
        bones = np.stack([target.offsets[below], source.offsets[below]])
        turn = shortest_rotation(*bones)
        if bones.any(axis=1).all() and np.abs(turn - np.eye(3)).max() > _ALIKE:
            turns[joint] = turn
    return turns


def rotations_on(motion: Motion, body: Skeleton, *, align: bool) -> Float64Array:
    """Return the rotations (T, J, 3) of a motion for the joints of another body, matched by name.

    Both begin with the 22 body joints; joints that the motion lacks do not rotate. With `align`, limbs keep their
    directions, see `limb_alignment`; else rotations are copied.
    """
    source = motion.skeleton
    rotations = np.zeros((motion.n_frames, body.n_joints, 3))
    for j, joint in enumerate(body.joints):
        if joint in source.joints:
            rotations[:, j] = motion.rotations[:, source.joints.index(joint)]
    turns = limb_alignment(source, body) if align else {}
    # A capture without collars has its shoulders' bones from the chest.
    turns = {j: turn for j, turn in turns.items() if source.offsets[j].any() or motion.rotations[:, j].any()}
    for j, parent in enumerate(body.parents):
        if j in turns or parent in turns:
            above, turn = (turns.get(k, np.eye(3)) for k in (parent, j))
            rotations[:, j] = rotvec_from_matrix(above.T @ matrix_from_rotvec(rotations[:, j]) @ turn)
    return rotations


def transfer_to(motion: Motion, body: Skeleton, *, keep: Literal["pelvis", "translation"] = "pelvis") -> Motion:
    """Put a motion on the bones of another body of the SMPL family.

    Joints match by name; one that the motion lacks does not rotate, one that the body lacks is dropped (fingers on
    SMPL's 24 joints). Rotations are copied joint by joint, as SMPL's projects do with their parameters (Lodge with
    AIST++'s); limbs of a recording (`Skeleton.captured`) keep their directions.

    Parameters
    ----------
    motion
        On a skeleton that begins with the 22 body joints, in their order.
    body
        The skeleton of the result; a motion with its bones is returned as it is. UsageError for another family.
    keep
        "pelvis": it stays where it is, so that the translation changes by the difference of the two bodies' rest
        positions. "translation": its numbers, as in Lodge's treatment of AIST++, so that the pelvis moves.
    """
    source = motion.skeleton
    if source.joints == body.joints and np.array_equal(source.offsets, body.offsets):
        return motion
    if not has_body(source) or not has_body(body):
        raise UsageError(f"a motion on skeleton {source.name} cannot be transferred to {body.name}",
                         found=f"joints {', '.join(source.joints[:4])}, ...", fix=RETARGET,
                         allowed=f"bodies of the SMPL family: {', '.join(BODY_JOINTS[:4])}, ...")  # fmt: skip
    rotations = rotations_on(motion, body, align=source.captured)
    shift = source.offsets[0] - body.offsets[0]
    translation = motion.translation + shift if keep == "pelvis" and shift.any() else motion.translation
    return Motion(translation, rotations, motion.grid, body, motion.trim_start)


def transfer(motion: Motion, target: Skeleton) -> Motion:
    """Return a motion on the joints of another body of the SMPL family, as `transfer_to`; the pelvis stays in place.

    The bones are the target's, except where the motion has all of the target's joints on its own body (a body
    model with betas): then it keeps them. SMPL's 24 joints keep their bones only where the target's joints are the
    same; SMPL-H's mean body, which has SMPL's bones, takes the target's too.
    """
    source = motion.skeleton
    is_mean_smplh = source.joints == SMPLH52.joints and np.array_equal(source.offsets[:22], SMPLH52.offsets[:22])
    if source.joints == target.joints and not is_mean_smplh:
        return motion
    keeps = has_body(source) and source.joints != SMPL24.joints and set(target.joints) <= set(source.joints)
    if is_mean_smplh or not keeps:
        return transfer_to(motion, target)
    part = source.subset(f"{source.name}-{target.n_joints}", target.joints)
    return transfer_to(motion, target if np.array_equal(part.offsets, target.offsets) else part)
