"""Rotations fitted to joint positions, which do not determine how bones turn about themselves."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array, rotvec_from_matrix, shortest_rotation
from dancedata.core.skeleton import Skeleton

#: Rounds in which the arrangement of a joint's children is averaged over frames; two suffice where it is rigid.
_ROUNDS = 4


def fitted(positions: Float64Array, skeleton: Skeleton, grid: FrameGrid, unseen: Collection[int] = ()) -> Motion:
    """Return a motion whose joints are at positions (T, J, 3), metres; `Motion.fit_m` says how far off they are.

    Bones have their mean length over the frames, and turn about themselves as little as possible from their parent. A
    joint with several children (pelvis, chest) takes the rotation that comes closest to all of them.

    `unseen`: Joints without children whose positions are not known: their bones do not turn, and stay the skeleton's.
    """
    children: list[list[int]] = [[] for _ in skeleton.joints]
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        if joint not in unseen:
            children[parent].append(joint)
    offsets = np.array(skeleton.offsets)
    world = np.empty((*positions.shape[:2], 3, 3))
    local = np.empty_like(world)
    for joint, below in enumerate(children):
        parent = skeleton.parents[joint]
        above = np.broadcast_to(np.eye(3), world[:, 0].shape) if parent < 0 else world[:, parent]
        bones = positions[:, below] - positions[:, [joint]]
        length = np.linalg.norm(bones, axis=-1).mean(axis=0)[:, None]
        offsets[below] *= length / np.linalg.norm(offsets[below], axis=-1, keepdims=True)
        if len(below) > 1:
            offsets[below] = _arrangement(bones, offsets[below])
            world[:, joint] = _closest(offsets[below], bones)
        elif below:
            world[:, joint] = _aimed(above, offsets[below[0]], bones[:, 0])
        else:
            world[:, joint] = above
        local[:, joint] = np.swapaxes(above, -1, -2) @ world[:, joint]
    body = replace(skeleton, offsets=offsets)
    motion = Motion(positions[:, 0] - offsets[0], rotvec_from_matrix(local), grid, body)
    seen = [joint for joint in range(skeleton.n_joints) if joint not in unseen]
    apart = np.linalg.norm(motion.joints()[:, seen] - positions[:, seen], axis=-1)
    return replace(motion, fit_m=float(apart.mean()))


def _aimed(rotations: Float64Array, offset: Float64Array, bones: Float64Array) -> Float64Array:
    """Turn rotations (T, 3, 3) as little as possible, so that they bring an offset (3,) to bones (T, 3)."""
    for _ in range(2):  # the second takes away what a half turn leaves where the bone is almost opposite
        rotations = shortest_rotation(rotations @ offset, bones, rotations[:, :, 2]) @ rotations
    return rotations


def _arrangement(bones: Float64Array, start: Float64Array) -> Float64Array:
    """Return the mean arrangement (K, 3) of bones (T, K, 3), turned onto each other, to begin with onto `start`."""
    mean = start
    for _ in range(_ROUNDS):
        mean = np.mean(np.swapaxes(_closest(mean, bones), -1, -2)[:, None] @ bones[..., None], axis=0)[..., 0]
    return mean


def _closest(offsets: Float64Array, bones: Float64Array) -> Float64Array:
    """Return the rotations (T, 3, 3) that bring offsets (K, 3) closest to bones (T, K, 3) (Kabsch, 1976)."""
    u, _, v = np.linalg.svd(np.einsum("tka,kb->tab", bones, offsets))
    u[..., 2] *= np.sign(np.linalg.det(u @ v))[:, None]
    return np.asarray(u @ v)
