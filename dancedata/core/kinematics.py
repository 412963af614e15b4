"""Forward kinematics."""

from __future__ import annotations

import numpy as np

from dancedata.core.rotations import Float64Array, FloatArray, matrix_from_rotvec
from dancedata.core.skeleton import Skeleton


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
        world[:, joint] = world[:, skeleton.parents[joint]] @ local[:, joint]
    return world


def joint_positions(skeleton: Skeleton, world: Float64Array, translation: FloatArray) -> Float64Array:
    """Return joint positions (T, J, 3) from rotations in the world (T, J, 3, 3) and the root's translation (T, 3)."""
    positions = np.empty((*world.shape[:2], 3), dtype=np.float64)
    positions[:, 0] = skeleton.offsets[0] + translation
    for joint in range(1, skeleton.n_joints):
        parent = skeleton.parents[joint]
        # For matrices this small `@` takes four times as long.
        bone = np.einsum("tab,b->ta", world[:, parent], skeleton.offsets[joint])
        np.add(positions[:, parent], bone, out=positions[:, joint])
    return positions
