"""HumanML3D's way from joint positions to columns and back (Guo et al., CVPR 2022; MIT), rewritten.

Its bones are those of the first frame of AMASS's clip 000021, to which every clip is retargeted: each bone keeps its
direction, and gets the length of the target's. Two peculiarities of the original are part of the numbers:

- The facing direction of a frame is computed from hips and shoulders taken in opposite directions, so that the hips
  count against the shoulders (`inverse_kinematics_np` swaps its names for the hips). The clip itself is turned to
  +Z by hips and shoulders taken the same way.
- The facing angle of a frame is within half a turn, and its step to the next is taken as the arc sine of half the
  difference. Where it passes half a turn, the step has the wrong sign, and recovered positions face elsewhere from
  there on.
"""

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DataError
from dancedata.core.rotations import Float64Array, shortest_rotation

N_JOINTS = 22
_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
#: Lengths of the target's bones, metres, to the parents; measured on the published new_joints/012314.npy, where they
#: are constant to 2e-6.
BONE_LENGTHS = (
    0.0, 0.10307395, 0.10988335, 0.13156825, 0.39362314, 0.39018813, 0.14319026, 0.43243298, 0.42564332, 0.05736471,
    0.14338174, 0.14941867, 0.21936, 0.13748683, 0.14338283, 0.10303927, 0.13161398, 0.12298431, 0.25683984,
    0.26309186, 0.26601186, 0.2698763,
)  # fmt: skip
_X, _Y, _Z = np.eye(3)
#: Direction of each bone at rest, from its parent.
_REST = np.stack(
    [0 * _X, _X, -_X, _Y, -_Y, -_Y, _Y, -_Y, -_Y, _Y, _Z, _Z, _Y, _X, -_X, _Z, -_Y, -_Y, -_Y, -_Y, -_Y, -_Y]
)
#: Axes of the half turns of bones that point against their rest; an arm straight up was raised sideways.
_HALF_TURNS = np.where(_REST[1:, 2:] == 0, _Z, _Y)
#: Joints whose rotation is relative to the body's facing direction: first of a chain.
_FIRST = (1, 2, 3, 13, 14)
_RIGHT_HIP, _LEFT_HIP, _RIGHT_SHOULDER, _LEFT_SHOULDER = 2, 1, 17, 16
#: Right knee and ankle: thigh and shin set the scale of the path.
_LEG = (5, 8)
#: Left ankle, left toe, right ankle, right toe.
_FEET = (7, 10, 8, 11)
#: Square of the displacement per frame, m2, below which a foot touches the ground.
_CONTACT = 0.002
_SMOOTHING_FRAMES = 20


def retargeted(joints: Float64Array, floor_m: float | None = None) -> Float64Array:
    """Return joints (T, 22, 3) with the target's bones, on the floor, first at the origin and facing +Z."""
    placed, scale = _on_target(joints)
    placed[..., 1] -= placed[..., 1].min() if floor_m is None else floor_m * scale
    placed -= placed[0, 0] * (1, 0, 1)
    first = placed[0]
    across = first[_RIGHT_HIP] - first[_LEFT_HIP] + first[_RIGHT_SHOULDER] - first[_LEFT_SHOULDER]
    return _turned(placed, np.broadcast_to(_yaw(np.cross(_Y, across)), len(placed)))


def floor_of(joints: Float64Array) -> float:
    """Return the height of the floor that `retargeted` takes, in the world of `joints`, metres."""
    placed, scale = _on_target(joints)
    return float(placed[..., 1].min() / scale)


def _on_target(joints: Float64Array) -> tuple[Float64Array, float]:
    """Return joints (T, 22, 3) with the target's bones, and the scale of the world."""
    lengths = np.linalg.norm(joints[0, 1:] - joints[0, list(_PARENTS[1:])], axis=-1)
    if not (lengths > 1e-6).all():
        joint = int(np.argmin(lengths)) + 1
        raise DataError("a bone has no length, so that it has no direction", reason="bad_skeleton",
                        where="humanml263", found=f"joint {joint} at its parent {_PARENTS[joint]}")  # fmt: skip
    scale = sum(BONE_LENGTHS[j] for j in _LEG) / sum(lengths[j - 1] for j in _LEG)
    placed = np.empty_like(joints)
    placed[:, 0] = joints[:, 0] * scale
    for j in range(1, N_JOINTS):
        bone = joints[:, j] - joints[:, _PARENTS[j]]
        placed[:, j] = placed[:, _PARENTS[j]] + BONE_LENGTHS[j] * bone / _length(bone)
    return placed, scale


def columns_of(joints: Float64Array) -> npt.NDArray[np.float32]:
    """Return the columns (T, 263) of retargeted joints (T, 22, 3)."""
    facing = _facing(joints)
    local = joints - joints[:, :1] * (1, 0, 1)
    step = np.diff(joints, axis=0)
    root = np.zeros((len(joints), 4))
    root[:-1, 0] = np.arcsin(np.sin(np.diff(facing) / 2))
    root[:-1, 1:3] = _turned(step[:, :1], facing[1:])[:, 0, ::2]
    root[:, 3] = joints[:, 0, 1]
    velocity = np.zeros((len(joints), N_JOINTS * 3))
    velocity[:-1] = _turned(step, facing[:-1]).reshape(len(step), N_JOINTS * 3)
    contact = np.ones((len(joints), 4))
    contact[:-1] = np.sum(step[:, _FEET] ** 2, axis=-1) < _CONTACT
    if len(joints) > 1:
        root[-1, :3], velocity[-1], contact[-1] = root[-2, :3], velocity[-2], contact[-2]
    position = _turned(local, facing)[:, 1:].reshape(len(joints), -1)
    parts = [root, position, _rotations(joints, facing), velocity, contact]
    return np.concatenate(parts, axis=1).astype(np.float32)


def joints_of(columns: Float64Array) -> Float64Array:
    """Return joint positions (T, 22, 3) of columns (T, 263), from the path of the root and the local positions."""
    facing = np.concatenate([[0.0], 2 * np.cumsum(columns[:-1, 0])])
    step = np.zeros((len(columns), 1, 3))
    step[1:, 0, ::2] = columns[:-1, 1:3]
    root = np.cumsum(_turned(step, -facing), axis=0)
    joints = np.zeros((len(columns), N_JOINTS, 3))
    joints[:, 1:] = _turned(columns[:, 4:67].reshape(len(columns), -1, 3), -facing)
    joints += root
    joints[:, 0, 1] = columns[:, 3]
    return joints


def _facing(joints: Float64Array) -> Float64Array:
    """Return the angles (T,) about +Y that turn the frames to +Z, within half a turn; 0 for the first frame."""
    hips = joints[:, _LEFT_HIP] - joints[:, _RIGHT_HIP]  # against the shoulders, as in the original
    across = hips + joints[:, _RIGHT_SHOULDER] - joints[:, _LEFT_SHOULDER]
    forward = np.cross(_Y, across / _length(across))
    from scipy.ndimage import gaussian_filter1d  # takes half a second to load

    forward = gaussian_filter1d(forward, _SMOOTHING_FRAMES, axis=0, mode="nearest")
    angles = _yaw(forward)
    angles[0] = 0
    return angles


def _rotations(joints: Float64Array, facing: Float64Array) -> Float64Array:
    """Return 6D rotations (T, 126) of the bones, each relative to the one before: two columns of each matrix."""
    bones = joints[:, 1:] - joints[:, list(_PARENTS[1:])]
    world = shortest_rotation(np.broadcast_to(_REST[1:], bones.shape), bones, _HALF_TURNS)
    body = np.zeros((len(joints), 3, 3))
    cosine, sine = np.cos(facing), np.sin(facing)
    body[:, 0, 0], body[:, 0, 2], body[:, 1, 1], body[:, 2, 0], body[:, 2, 2] = cosine, sine, 1, -sine, cosine
    rotations = np.empty((len(joints), N_JOINTS - 1, 6))
    for j in range(1, N_JOINTS):
        before = body if j in _FIRST else world[:, _PARENTS[j] - 1]
        local = np.swapaxes(before, -1, -2) @ world[:, j - 1]
        rotations[:, j - 1] = np.concatenate([local[..., 0], local[..., 1]], axis=-1)
    return rotations.reshape(len(joints), -1)


def _yaw(forward: Float64Array) -> Float64Array:
    """Return the angles about +Y that turn directions (..., 3) to +Z."""
    angles: Float64Array = -np.arctan2(forward[..., 0], forward[..., 2])
    return angles


def _turned(points: Float64Array, angles: Float64Array) -> Float64Array:
    """Turn points (T, J, 3) about +Y by angles (T,)."""
    cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)


def _length(vectors: Float64Array) -> Float64Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1, keepdims=True))
