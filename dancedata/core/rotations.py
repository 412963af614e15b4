"""Rotations as arrays. Axis-angle vectors in radians; all in float64.

The functions that every build needs, axis-angle to matrix and the angle between two rotations, are plain numpy:
importing scipy's Rotation takes half a second in every worker. The others use scipy, the reference of the tests.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

FloatArray = npt.NDArray[np.floating[Any]]
Float64Array = npt.NDArray[np.float64]


def rotation(rotvec: FloatArray) -> Rotation:
    """Return scipy's Rotation of axis-angle vectors (..., 3); lengths beyond pi are allowed."""
    from scipy.spatial.transform import Rotation

    # A copy: scipy does not accept read-only arrays.
    return Rotation.from_rotvec(np.array(rotvec, dtype=np.float64))


def _quaternion(rotvec: FloatArray) -> Float64Array:
    """Convert axis-angle vectors (..., 3) to unit quaternions (4, ...), real part first."""
    x, y, z = np.ascontiguousarray(np.moveaxis(np.asarray(rotvec, dtype=np.float64), -1, 0))
    square = np.asarray(x * x + y * y + z * z)  # for a single vector, numpy's operations return numbers
    angle = np.sqrt(square)
    # sin(angle / 2) / angle; near 0 its Taylor series, whose next term is below 1e-16 here.
    near = np.asarray(angle < 1e-3)
    scale = np.asarray(np.sin(angle / 2))
    np.divide(scale, angle, out=scale, where=~near)
    small = square[near]
    scale[near] = 0.5 - small / 48 + small * small / 3840
    return np.stack([np.cos(angle / 2), x * scale, y * scale, z * scale])


def matrix_from_rotvec(rotvec: FloatArray) -> Float64Array:
    """Convert axis-angle vectors (..., 3) to matrices (..., 3, 3); lengths beyond pi are allowed.

    Examples
    --------
    >>> import numpy as np
    >>> from dancedata.core.rotations import matrix_from_rotvec
    >>> matrix_from_rotvec(np.array([0, np.pi / 2, 0])).round().tolist()
    [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    """
    w, x, y, z = _quaternion(rotvec)
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz, wx, wy, wz = x * y, x * z, y * z, w * x, w * y, w * z
    matrix = np.empty((*w.shape, 3, 3))
    for axis, others in enumerate((yy + zz, xx + zz, xx + yy)):
        np.subtract(1, 2 * others, out=matrix[..., axis, axis])
    for row, column, first, second in ((0, 1, xy, wz), (2, 0, xz, wy), (1, 2, yz, wx)):
        np.multiply(2, first - second, out=matrix[..., row, column])
        np.multiply(2, first + second, out=matrix[..., column, row])
    return matrix


def angles_between(rotvecs: FloatArray) -> Float64Array:
    """Return the angles, 0 to pi radians, of the rotations from each frame to the next: (T, J, 3) to (T - 1, J)."""
    quaternions = _quaternion(rotvecs)
    (w, *start), (v, *end) = quaternions[:, :-1], quaternions[:, 1:]
    real = w * v + sum(a * b for a, b in zip(start, end, strict=True))
    turn = w * np.stack(end) - v * np.stack(start) - np.cross(start, end, axis=0)
    # The arccosine of the real part would lose all precision near 0.
    return np.asarray(2 * np.arctan2(np.sqrt(np.sum(turn * turn, axis=0)), np.abs(real)))


def rotvec_from_matrix(matrix: FloatArray) -> Float64Array:
    """Convert matrices (..., 3, 3) to axis-angle vectors (..., 3) of length at most pi."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(np.array(matrix, dtype=np.float64)).as_rotvec(), dtype=np.float64)


def rotation_6d(matrix: FloatArray) -> FloatArray:
    """Return the first two ROWS of matrices (..., 3, 3), flattened to (..., 6).

    The convention of pytorch3d, EDGE and Lodge; Zhou et al., CVPR 2019, and HumanML3D use columns.

    Examples
    --------
    >>> import numpy as np
    >>> from dancedata.core.rotations import rotation_6d
    >>> rotation_6d(np.eye(3)).tolist()
    [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    """
    return matrix[..., :2, :].reshape(*matrix.shape[:-2], 6)


def matrix_from_6d(rows: FloatArray) -> Float64Array:
    """Convert 6D rotations (..., 6), two rows, to matrices (..., 3, 3) by Gram-Schmidt (Zhou et al. 2019, eq. 15).

    Examples
    --------
    >>> import numpy as np
    >>> from dancedata.core.rotations import matrix_from_6d
    >>> matrix_from_6d(np.array([2.0, 0, 0, 1, 1, 0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    first, second = np.asarray(rows[..., :3], np.float64), np.asarray(rows[..., 3:], np.float64)
    a = first / np.linalg.norm(first, axis=-1, keepdims=True)
    b = second - np.sum(a * second, axis=-1, keepdims=True) * a
    b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    return np.stack([a, b, np.cross(a, b)], axis=-2)


def shortest_rotation(start: FloatArray, end: FloatArray, fallback: FloatArray | None = None) -> Float64Array:
    """Return the shortest rotations (..., 3, 3) from one direction (..., 3) to another.

    For opposite directions: 180 degrees about the part of `fallback`, (..., 3), perpendicular to them, or the
    identity without one. `fallback` must not be parallel to them.
    """
    a = start / np.maximum(np.linalg.norm(start, axis=-1, keepdims=True), 1e-300)
    b = end / np.maximum(np.linalg.norm(end, axis=-1, keepdims=True), 1e-300)
    cosine = np.sum(a * b, axis=-1)[..., None, None]
    axis = np.cross(a, b)
    cross = np.zeros((*axis.shape[:-1], 3, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -axis[..., 2], axis[..., 1], -axis[..., 0]
    cross -= np.swapaxes(cross, -1, -2)
    opposite = cosine < -0.999999
    turned = np.eye(3) + cross + cross @ cross / np.where(opposite, 1.0, 1 + cosine)
    half = np.eye(3)
    if fallback is not None:
        perpendicular = fallback - np.sum(fallback * a, axis=-1, keepdims=True) * a
        perpendicular /= np.maximum(np.linalg.norm(perpendicular, axis=-1, keepdims=True), 1e-300)
        half = 2 * perpendicular[..., :, None] * perpendicular[..., None, :] - np.eye(3)
    return np.where(opposite, half, turned)


def slerp(rotvec: FloatArray, frames: Float64Array) -> Float64Array:
    """Interpolate rotations (T, J, 3) at fractional frames (M,), along the shortest arc: (M, J, 3).

    Examples
    --------
    >>> import numpy as np
    >>> from dancedata.core.rotations import slerp
    >>> quarter_turn = np.array([[[0, 0, 0]], [[0, np.pi / 2, 0]]])
    >>> np.degrees(slerp(quarter_turn, np.array([0.5]))).round(1).tolist()
    [[[0.0, 45.0, 0.0]]]
    """
    lower = np.minimum(frames.astype(np.int64), max(len(rotvec) - 2, 0))
    upper = np.minimum(lower + 1, len(rotvec) - 1)
    start = rotation(rotvec[lower])
    turn = (start.inv() * rotation(rotvec[upper])).as_rotvec()
    between = start * rotation(turn * (frames - lower)[:, None, None])
    return np.asarray(between.as_rotvec(), dtype=np.float64)
