"""Forward kinematics of a BVH file: positions and rotations of its joints in the file's own axes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dancedata.formats.bvh.hierarchy import BvhJoint
from dancedata.formats.bvh.parse import Bvh

Floats = NDArray[np.float64]


def bone_offsets(bvh: Bvh) -> Floats:
    """Return (J, 3) offsets from the parents, in the file's unit; of position channels (`Bvh.placed`) the median."""
    offsets = np.array([joint.offset for joint in bvh.joints], dtype=np.float64)
    for k in bvh.placed:
        for axis, column in bvh.joints[k].position_columns.items():
            offsets[k, axis] = np.median(bvh.values[:, column])
    return offsets


def stretch(bvh: Bvh, root: int, indices: Sequence[int]) -> float:
    """Return how far position channels of `indices`, below `root`, are at most from their bones, file's unit."""
    needed = set(_with_ancestors(bvh.joints, indices)) - set(_with_ancestors(bvh.joints, [root]))
    bones = bone_offsets(bvh)
    apart = [np.linalg.norm(_offset(bvh, k, bvh.values) - bones[k], axis=1).max() for k in needed]
    return float(max(apart, default=0.0))


def world(bvh: Bvh, indices: Sequence[int], rows: slice) -> tuple[Floats, Floats]:
    """Return rotations (T, K, 3, 3) to the file's axes and positions (T, K, 3), the file's unit, of K joints.

    Angles are in degrees about the joint's own axes in the order of the channels; position channels replace OFFSET.
    """
    values = bvh.values[rows]
    rotations: dict[int, Floats] = {}
    positions: dict[int, Floats] = {}
    for k in _with_ancestors(bvh.joints, indices):
        joint = bvh.joints[k]
        local, offset = _rotation(joint, values), _offset(bvh, k, values)
        if joint.parent == -1:
            rotations[k], positions[k] = local, offset
        else:
            rotations[k] = rotations[joint.parent] @ local
            positions[k] = positions[joint.parent] + np.einsum("tij,tj->ti", rotations[joint.parent], offset)
    return np.stack([rotations[k] for k in indices], axis=1), np.stack([positions[k] for k in indices], axis=1)


def _with_ancestors(joints: Sequence[BvhJoint], indices: Sequence[int]) -> list[int]:
    """Return the indices of the joints and of all their ancestors; parents come first."""
    needed: set[int] = set()
    for k in indices:
        while k != -1 and k not in needed:
            needed.add(k)
            k = joints[k].parent
    return sorted(needed)


def _rotation(joint: BvhJoint, values: Floats) -> Floats:
    from scipy.spatial.transform import Rotation

    if not joint.order:
        return np.broadcast_to(np.eye(3), (len(values), 3, 3))
    # Capitals: intrinsic rotations. (T, 1) for a hinge.
    angles = values[:, joint.rotation_columns]
    return np.asarray(Rotation.from_euler(joint.order, angles, degrees=True).as_matrix(), dtype=np.float64)


def _offset(bvh: Bvh, k: int, values: Floats) -> Floats:
    joint = bvh.joints[k]
    offset = np.tile(np.array(joint.offset, dtype=np.float64), (len(values), 1))
    if joint.parent == -1 or k in bvh.placed:
        for axis, column in joint.position_columns.items():
            offset[:, axis] = values[:, column]
    return offset
