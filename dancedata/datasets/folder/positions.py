"""Joint positions (T, J, 3) on SMPL's 24 joints: rotations are fitted, twists of bones are unknown.

Which joint is which follows from names: the file's own (an array ``joint_names``, or ``joints``) or the recipe's
(``joints``). Without names, 22 or 24 joints are in SMPL's order if bones have a body's proportions. Names of BVH's
producers are known. What a set of joints lacks is put where it usually is: the pelvis between the hips, the neck
between the shoulders, the spine and the collars along straight lines. Toes and hands that it lacks do not turn.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import SMPLX55
from dancedata.core.errors import DataError
from dancedata.core.fitting import fitted
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rest import SMPL_REST
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed
from dancedata.datasets.checks import is_human
from dancedata.datasets.folder.facts import finite
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.bvh.producers import REQUIRED, detect, plain
from dancedata.formats.stated import JOINT_NAMES

#: Names under which files have positions; "" is the only array of a file.
_POSITION_NAMES = (
    "positions", "joint_positions", "joints", "joints3d", "joints_3d", "keypoints3d_optim", "keypoints3d",
    "keypoints_3d", "new_joints", "full_pose", "",
)  # fmt: skip
_SIDES = "left", "right"
#: Orders of joints of programs for video and sensors, in SMPL's names where SMPL has the joint.
_ORDERS = {
    "coco17": "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow "
    "left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle",
    "body25": "nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist pelvis right_hip "
    "right_knee right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear left_ear left_foot "
    "left_small_toe left_heel right_foot right_small_toe right_heel",
    "h36m17": "pelvis right_hip right_knee right_ankle left_hip left_knee left_ankle spine2 neck nose head_top "
    "left_shoulder left_elbow left_wrist right_shoulder right_elbow right_wrist",
    "ntu25": "pelvis spine2 neck head left_shoulder left_elbow left_wrist left_hand right_shoulder right_elbow "
    "right_wrist right_hand left_hip left_knee left_ankle left_foot right_hip right_knee right_ankle right_foot "
    "spine3 left_fingertip left_thumb right_fingertip right_thumb",
}
#: Orders of joints that a recipe may name.
JOINT_SETS: Mapping[str, tuple[str, ...]] = {
    "smpl": SMPL24.joints,
    "smpl22": SMPL24.joints[:22],
    "smplx": SMPLX55.joints,
    **{name: tuple(joints.split()) for name, joints in _ORDERS.items()},
}
_COUNTS = {22: "smpl22", 24: "smpl"}
_LIKE_SPINE = ("spine", "chest", "thorax", "torso", "abdomen", "upperback", "lowerback")
#: A bone of the limbs, or the trunk, is longer than this fraction of the body's height.
_LEAST_BONE = 0.01
_FRAMES = 300
#: Range of the height of HumanML3D's pelvis above its floor in the median of a clip; normalised columns are near 0.
_PELVIS_M = (0.15, 3.0)

Floats = NDArray[np.float64]


def positions_in(arrays: ArrayFile) -> str | None:
    """Return the name of the array (T, J, 3) that may be joint positions: one of the usual names, or the only one."""
    shaped = [name for name in arrays.names[:100] if _is_positions(arrays, name)]
    usual = [name for name in _POSITION_NAMES if name in shaped]
    return usual[0] if usual else shaped[0] if len(shaped) == 1 else None


def _is_positions(arrays: ArrayFile, name: str) -> bool:
    try:
        shape = arrays.shape(name)
    except DataError:
        return False  # not numbers
    return len(shape) == 3 and shape[1] > 1 and shape[2] == 3


def joint_names(arrays: ArrayFile, name: str, declared: Sequence[str] | str | None) -> tuple[tuple[str, ...], str]:
    """Return the names of the joints of an array (T, J, 3), and their origin; DataError if nothing names them."""
    count = arrays.shape(name)[1]
    stored = next((names for key in JOINT_NAMES if key in arrays.names and (names := arrays.texts(key))), ())
    names = JOINT_SETS[declared] if isinstance(declared, str) else tuple(declared or stored)
    where = "the recipe" if declared else "the file"
    if not names:
        by_count = _COUNTS.get(count)
        if by_count is None or not _has_proportions(arrays, name, JOINT_SETS[by_count]):
            raise DataError("it is unknown which joints these positions belong to", reason="unknown_joints",
                            where=str(arrays.path),
                            found=f"{name or 'the array'} {arrays.shape(name)} without names of joints",
                            allowed=f"{', '.join(JOINT_SETS)}, or the names of the {count} joints in their order",
                            fix="name them in the recipe: dataset.folder.joints=NAME or [NAME, ...]; or in the file: "
                            "numpy.savez(file, positions=..., joint_names=[...])")  # fmt: skip
        names, where = JOINT_SETS[by_count], "SMPL's order, by their number and the lengths of bones"
    if len(names) != count:
        raise DataError("the number of names differs from the number of joints", reason="bad_declaration",
                        where=str(arrays.path),
                        found=f"{len(names)} names, {name or 'the array'} {arrays.shape(name)}",
                        fix="correct dataset.folder.joints, or the names in the file")  # fmt: skip
    return names, where


def _has_proportions(arrays: ArrayFile, name: str, joints: Sequence[str]) -> bool:
    """Return whether bones by SMPL's order have the proportions of a body, and keep their length."""
    points = arrays.read(name)
    points = points[:: max(1, len(points) // _FRAMES)]
    bones = np.linalg.norm(points[:, 1:22] - points[:, list(SMPL24.parents[1:22])], axis=-1)
    return bool(np.isfinite(bones).all()) and is_human(bones.mean(axis=0))


def map_names(path: Path, names: Sequence[str], joint_map: Mapping[str, str] | str | None) -> dict[int, int]:
    """Return index in SMPL24 -> index in `names`, by SMPL's or a producer's names and `joint_map`; DataError."""
    chosen, declared = (joint_map, {}) if isinstance(joint_map, str) else ("", dict(joint_map or {}))
    declared = {joint: name for joint, name in declared.items() if not name or name in names}
    of = {SMPL24.index(joint): names.index(name) for joint, name in declared.items() if name}
    required = [SMPL24.index(joint) for joint in REQUIRED if joint != "pelvis"]
    own = {s: names.index(joint) for s, joint in enumerate(SMPL24.joints) if joint in names and joint not in declared}
    of |= own if set(required) <= own.keys() | of.keys() else detect(path, names, declared, chosen).of
    for side, hand in (("left", 22), ("right", 23)):  # SMPL-X's knuckle of the middle finger
        if hand not in of and f"{side}_middle1" in names:
            of[hand] = names.index(f"{side}_middle1")
    missing = [SMPL24.joints[s] for s in required if s not in of]
    if missing:
        raise DataError(
            f"required joints are missing: {', '.join(missing)}",
            reason="unknown_joints",
            where=str(path),
            found=f"joints {listed(list(names))}",
            allowed="hips, knees, ankles, shoulders, elbows, wrists, by SMPL's names or those of a producer of BVH",
            fix="map the joints: joint_map {left_hip: NAME, ...}",
        )
    return dict(sorted(of.items()))


def _body_positions(points: Floats, names: Sequence[str], of: Mapping[int, int]) -> tuple[Floats, list[int]]:
    """Return positions (T, 24, 3) of SMPL's joints, and the leaves of its tree that are not known."""
    at = np.full((len(points), 24, 3), np.nan)
    for smpl, joint in of.items():
        at[:, smpl] = points[:, joint]
    index = {plain(name): k for k, name in enumerate(names)}
    known = set(of)

    def put(joint: str, place: Floats) -> None:
        if SMPL24.index(joint) not in known:
            at[:, SMPL24.index(joint)] = place
            known.add(SMPL24.index(joint))

    put("pelvis", at[:, (1, 2)].mean(axis=1))
    put("neck", at[:, (16, 17)].mean(axis=1))
    ears = [points[:, index[ear]] for ear in ("leftear", "rightear") if ear in index]
    face = np.mean(ears, axis=0) if len(ears) == 2 else points[:, index["nose"]] if "nose" in index else None
    if face is None:
        up = at[:, 12] - at[:, 0]
        rest = np.linalg.norm(SMPL_REST[15] - SMPL_REST[12]) / np.linalg.norm(SMPL_REST[12])
        face = at[:, 12] + rest * up
    put("head", face)
    _fill_spine(points, names, at, known)
    for side, (collar, shoulder) in zip(_SIDES, ((13, 16), (14, 17)), strict=True):
        bone, line = SMPL_REST[collar] - SMPL_REST[9], SMPL_REST[shoulder] - SMPL_REST[9]
        put(f"{side}_collar", at[:, 9] + float(bone @ line / (line @ line)) * (at[:, shoulder] - at[:, 9]))
    return at, [joint for joint in range(24) if joint not in known]


def _fill_spine(points: Floats, names: Sequence[str], at: Floats, known: set[int]) -> None:
    """Place the spine's joints: at those of `names` between pelvis and neck, else on straight lines."""
    chain = [0, 3, 6, 9, 12]
    if not known & {3, 6, 9}:
        between = [k for k, name in enumerate(names) if plain(name).startswith(_LIKE_SPINE)]
        between.sort(key=lambda k: float(np.linalg.norm(points[:, k] - at[:, 0], axis=-1).mean()))
        if between:
            places = {3: between[0]} | ({9: between[-1]} if len(between) > 1 else {})
            places |= {6: between[(len(between) - 1) // 2]} if len(between) > 2 else {}
            for joint, k in places.items():
                at[:, joint] = points[:, k]
                known.add(joint)
    rest = [0.0, *np.cumsum(np.linalg.norm(SMPL_REST[chain[1:]] - SMPL_REST[chain[:-1]], axis=1))]
    for k, joint in enumerate(chain):
        if joint not in known:
            low = max(i for i in range(k) if chain[i] in known)
            high = min(i for i in range(k + 1, len(chain)) if chain[i] in known)
            share = (rest[k] - rest[low]) / (rest[high] - rest[low])
            at[:, joint] = at[:, chain[low]] + share * (at[:, chain[high]] - at[:, chain[low]])
            known.add(joint)


def body_at(
    arrays: ArrayFile, name: str, joints: Sequence[str] | str | None, joint_map: Mapping[str, str] | str | None
) -> tuple[Floats, list[int]]:
    """Return positions (T, 24, 3) in a file's axes and unit, and the leaves of the tree that are not known."""
    names, _ = joint_names(arrays, name, joints)
    rows = finite(arrays, name)
    return _body_positions(rows.reshape(len(rows), -1, 3), names, map_names(arrays.path, names, joint_map))


def humanml_at(arrays: ArrayFile) -> tuple[Floats, list[int]]:
    """Return positions (T, 24, 3) of HumanML3D's columns, metres, +Y up, and the leaves that they lack; DataError."""
    columns = finite(arrays, "")
    height = float(np.median(columns[:, 3]))
    if not _PELVIS_M[0] < height < _PELVIS_M[1]:
        raise DataError(
            "the columns are not HumanML3D's, or are normalised",
            reason="out_of_range",
            where=str(arrays.path),
            found=f"a pelvis at a height of {height:.3g} m (median of column 3)",
            allowed=f"{_PELVIS_M[0]} to {_PELVIS_M[1]} m",
            fix="undo the normalisation with the Mean.npy and Std.npy that it was made with: columns * std + mean",
        )
    representation: Any = REPRESENTATIONS.get("humanml263")()
    points = representation.positions(columns)
    return _body_positions(points, JOINT_SETS["smpl22"], {joint: joint for joint in range(22)})


def _bone_lengths(at: Floats) -> Floats:
    """Return the mean lengths (24,) of the bones from their parents; 0 for the pelvis, NaN for unknown joints."""
    bones = np.zeros((len(at), 24))
    bones[:, 1:] = np.linalg.norm(at[:, 1:] - at[:, list(SMPL24.parents[1:])], axis=-1)
    return np.asarray(bones.mean(axis=0))


def height_of(at: Floats) -> float:
    """Return the height of the body from toes, or ankles, to the head joint, as SMPL stands at rest."""
    lengths = _bone_lengths(at)
    legs = lengths[[4, 5, 7, 8]].sum() / 2
    scale = legs / (np.linalg.norm(SMPL24.offsets[[4, 5, 7, 8]], axis=1).sum() / 2)
    return float(scale * np.ptp(SMPL_REST[:, 1]))


def fit_body(path: Path, at: Floats, unseen: Sequence[int], grid: FrameGrid) -> Motion:
    """Return the motion of positions (T, 24, 3), metres, +Y up, on their own bones; DataError: ``bad_skeleton``."""
    lengths = _bone_lengths(at)
    size = height_of(at)
    trunk = float(np.linalg.norm(at[:, 12] - at[:, 0], axis=-1).mean())
    short = [SMPL24.joints[j] for j in (1, 2, 4, 5, 7, 8, 18, 19, 20, 21) if not lengths[j] > _LEAST_BONE * size]
    short += ["neck"] * (not trunk > _LEAST_BONE * size)
    if short:
        raise DataError("joints are at the position of the joint above them", reason="bad_skeleton", where=str(path),
                        found=f"{listed(short)}, in a body of {size:.4g} m",
                        allowed=f"bones longer than {_LEAST_BONE:.0%} of the body",
                        fix="correct the names of the joints, or save the positions again")  # fmt: skip
    scale = size / float(np.ptp(SMPL_REST[:, 1]))
    places = np.where(np.isfinite(at), at, 0.0)
    for joint in (j for j in range(1, 24) if j not in unseen and not lengths[j] > 1e-6):
        # A joint at its parent has no direction: it stands a millimetre along the bone at rest.
        places[:, joint] += 1e-3 * SMPL24.offsets[joint] / np.linalg.norm(SMPL24.offsets[joint])
    rest = replace(SMPL24, offsets=np.array(SMPL24.offsets) * np.r_[1.0, np.full(23, scale)][:, None])
    motion = fitted(places, rest, grid, unseen)
    offsets = np.round(motion.skeleton.offsets, 5) + 0.0
    digest = hashlib.sha256(offsets.astype("<f8").tobytes()).hexdigest()
    return replace(motion, skeleton=replace(motion.skeleton, name=f"smpl24:fit-{digest[:8]}", captured=True))
