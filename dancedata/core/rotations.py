"""Rotations as arrays, on scipy's Rotation. Axis-angle vectors in radians; all in float64."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

FloatArray = npt.NDArray[np.floating[Any]]
Float64Array = npt.NDArray[np.float64]


def rotation(rotvec: FloatArray) -> Rotation:
    """Return scipy's Rotation of axis-angle vectors (..., 3); lengths beyond pi are fine."""
    from scipy.spatial.transform import Rotation

    # A fresh array: scipy takes no read-only one.
    return Rotation.from_rotvec(np.array(rotvec, dtype=np.float64))


def matrix_from_rotvec(rotvec: FloatArray) -> Float64Array:
    """Turn axis-angle vectors (..., 3) into matrices (..., 3, 3)."""
    return np.asarray(rotation(rotvec).as_matrix(), dtype=np.float64)


def rotvec_from_matrix(matrix: FloatArray) -> Float64Array:
    """Turn matrices (..., 3, 3) into axis-angle vectors (..., 3) of length at most pi."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(np.array(matrix, dtype=np.float64)).as_rotvec(), dtype=np.float64)


def rotation_6d(matrix: FloatArray) -> FloatArray:
    """Take the first two ROWS of matrices (..., 3, 3), flattened to (..., 6).

    The convention of pytorch3d, EDGE and Lodge; Zhou et al., CVPR 2019, and HumanML3D take columns.
    """
    return matrix[..., :2, :].reshape(*matrix.shape[:-2], 6)


def matrix_from_6d(rows: FloatArray) -> Float64Array:
    """Turn 6D rotations (..., 6), two rows, into matrices (..., 3, 3) by Gram-Schmidt (Zhou et al. 2019, eq. 15)."""
    first, second = np.asarray(rows[..., :3], np.float64), np.asarray(rows[..., 3:], np.float64)
    a = first / np.linalg.norm(first, axis=-1, keepdims=True)
    b = second - np.sum(a * second, axis=-1, keepdims=True) * a
    b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    return np.stack([a, b, np.cross(a, b)], axis=-2)


def slerp(rotvec: FloatArray, frames: Float64Array) -> Float64Array:
    """Interpolate rotations (T, J, 3) at fractional frames (M,), along the shortest arc: (M, J, 3)."""
    lower = np.minimum(frames.astype(np.int64), max(len(rotvec) - 2, 0))
    upper = np.minimum(lower + 1, len(rotvec) - 1)
    start = rotation(rotvec[lower])
    turn = (start.inv() * rotation(rotvec[upper])).as_rotvec()
    between = start * rotation(turn * (frames - lower)[:, None, None])
    return np.asarray(between.as_rotvec(), dtype=np.float64)
