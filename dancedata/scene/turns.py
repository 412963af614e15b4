"""Turns of the joints: what the skin of a body needs beside their positions."""

from __future__ import annotations

import numpy as np

from dancedata.core.rotations import Float64Array, rotvec_from_matrix, shortest_rotation
from dancedata.core.skeleton import Skeleton

#: Weight of the parent's turn beside bones of a metre: bones in one line leave the turn about it open.
_PARENT = 1e-4


def rest_pose(joints: Float64Array, skeleton: Skeleton, measured: bool) -> Float64Array:
    """Return the joints at rest, (J, 3) metres, the root at 0; bones have the skeleton's or a `measured` length."""
    rest = np.zeros((skeleton.n_joints, 3))
    for joint, parent in list(enumerate(skeleton.parents))[1:]:
        offset = skeleton.offsets[joint]
        if measured:
            length = np.linalg.norm(joints[:, joint] - joints[:, parent], axis=-1).mean()
            offset = offset * (length / max(float(np.linalg.norm(offset)), 1e-9))
        rest[joint] = rest[parent] + offset
    return rest


def turns_of_bones(joints: Float64Array, rest: Float64Array, skeleton: Skeleton) -> Float64Array:
    """Return rotations that take bones at rest to those of a motion, (T, J, 3) axis-angle in the parent's axes.

    A joint of several bones has the rotation that fits them best (Kabsch 1976), one of a single bone the shortest
    from where its parent takes it, one without bones that of its parent. `joints` are (T, J, 3), `rest` (J, 3).
    """
    world = np.empty((len(joints), skeleton.n_joints, 3, 3))
    local = np.empty_like(world)
    for joint, parent in enumerate(skeleton.parents):
        above = np.broadcast_to(np.eye(3), world[:, 0].shape) if parent < 0 else world[:, parent]
        children = [k for k, of in enumerate(skeleton.parents) if of == joint and (rest[k] != rest[joint]).any()]
        bones, now = rest[children] - rest[joint], joints[:, children] - joints[:, joint, None]
        if len(children) == 1:
            carried = above @ bones[0]
            world[:, joint] = shortest_rotation(carried, now[:, 0]) @ above
        elif children:
            covariance = np.einsum("tka,kb->tab", now, bones) + _PARENT * above
            u, _, v = np.linalg.svd(covariance)
            u[..., -1] *= np.sign(np.linalg.det(u @ v))[:, None]
            world[:, joint] = u @ v
        else:
            world[:, joint] = above
        local[:, joint] = np.swapaxes(above, -1, -2) @ world[:, joint]
    return rotvec_from_matrix(local)
