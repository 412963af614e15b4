"""Forward kinematics."""

from __future__ import annotations

import numpy as np

from dancedata.core.rotations import Float64Array, FloatArray, matrix_from_rotvec
from dancedata.core.skeleton import Skeleton

#: Frames whose matrices are copied at a time.
_FRAMES = 256


def forward_kinematics(skeleton: Skeleton, rotations: FloatArray, translation: FloatArray) -> Float64Array:
    """Return joint positions.

    Parameters
    ----------
    skeleton
        J joints. The posed root lies at offsets[0] + translation, as in SMPL (Loper et al. 2015).
    rotations
        (T, J, 3) axis-angle, radians, each relative to the parent.
    translation
        (T, 3) metres.

    Returns
    -------
    (T, J, 3) float64
        Positions in metres, in the axes of the input.
    """
    return joint_positions(skeleton, world_matrices(skeleton, matrix_from_rotvec(rotations)), translation)


def world_matrices(skeleton: Skeleton, local: Float64Array) -> Float64Array:
    """Return every joint's rotation in the world, (T, J, 3, 3), from those relative to the parents."""
    world = np.empty_like(local)
    world[:, 0] = local[:, 0]
    for joint in range(1, skeleton.n_joints):
        np.matmul(world[:, skeleton.parents[joint]], local[:, joint], out=world[:, joint])
    return world


def joint_positions(skeleton: Skeleton, world: Float64Array, translation: FloatArray) -> Float64Array:
    """Return joint positions (T, J, 3) from rotations in the world (T, J, 3, 3) and the root's translation (T, 3)."""
    return placed(skeleton, posed_bones(skeleton, world), translation)


def posed_bones(skeleton: Skeleton, world: Float64Array) -> Float64Array:
    """Return the vectors from each joint's parent to it, (J - 1, T, 3), without the root; rotations as above."""
    parents = list(skeleton.parents[1:])
    bones = np.empty((len(parents), len(world), 3), dtype=np.float64)
    for begin in range(0, len(world), _FRAMES):
        some = slice(begin, begin + _FRAMES)
        # For matrices this small `@` takes four times as long.
        np.einsum("tjab,jb->jta", world[some, parents], skeleton.offsets[1:], out=bones[:, some])
    return bones


def placed(skeleton: Skeleton, bones: Float64Array, translation: FloatArray) -> Float64Array:
    """Return joint positions (T, J, 3) from `posed_bones` and the root's translation (T, 3)."""
    positions = np.empty((skeleton.n_joints, *translation.shape), dtype=np.float64)
    np.add(skeleton.offsets[0], translation, out=positions[0])
    for joint, bone in enumerate(bones, 1):
        np.add(positions[skeleton.parents[joint]], bone, out=positions[joint])
    return np.ascontiguousarray(positions.swapaxes(0, 1))
