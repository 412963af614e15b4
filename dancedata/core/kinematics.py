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
    local = matrix_from_rotvec(rotations)
    world = np.empty_like(local)
    positions = np.empty((*local.shape[:2], 3), dtype=np.float64)
    world[:, 0] = local[:, 0]
    positions[:, 0] = skeleton.offsets[0] + translation
    for joint in range(1, skeleton.n_joints):
        parent = skeleton.parents[joint]
        world[:, joint] = world[:, parent] @ local[:, joint]
        positions[:, joint] = positions[:, parent] + world[:, parent] @ skeleton.offsets[joint]
    return positions
