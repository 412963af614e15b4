"""FineDance's rotations: 52 joints in 6D, the first two rows of each matrix."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import SMPLX52, SMPLX55
from dancedata.core.errors import DataError
from dancedata.core.rotations import matrix_from_6d, rotvec_from_matrix

#: Tolerance of the orthonormality of two rows; files in float32 are within 1e-7.
TOLERANCE = 1e-3

# Indices of the file's joints in the skeleton: all except jaw and eyes.
_OF_55 = [SMPLX55.index(joint) for joint in SMPLX52.joints]

Floats = NDArray[np.float64]


def rotations_of(rows: Floats) -> Floats:
    """Return axis-angle rotations (T, 55, 3) in radians of 6D rotations (T, 52, 6); jaw and eyes are zero."""
    rotations = np.zeros((len(rows), SMPLX55.n_joints, 3))
    rotations[:, _OF_55] = rotvec_from_matrix(matrix_from_6d(rows))
    return rotations


def check_rows(path: Path, rows: Floats) -> None:
    """Check that all 6D rotations (T, 52, 6) are two rows of a rotation matrix.

    Raises
    ------
    DataError
        ``bad_rotation``.
    """
    off = _off_orthonormal(rows[..., :3], rows[..., 3:])
    bad = off > TOLERANCE
    if not bad.any():
        return
    frame, joint = (int(i) for i in np.argwhere(bad)[0])
    value = ", ".join(f"{x:.4g}" for x in rows[frame, joint])
    fix = "normalise the rotations (Gram-Schmidt) if a model generated them, or download the file again"
    # The pattern of two columns, flattened row by row (r00 r01 r10 r11 r20 r21).
    if (_off_orthonormal(rows[..., 0::2], rows[..., 1::2]) <= TOLERANCE).all():
        fix = (
            "all of them are valid as two columns of the matrix, flattened row by row (Zhou et al. 2019): write "
            "the first two rows instead"
        )
    raise DataError(
        "not a valid 6D rotation",
        reason="bad_rotation",
        where=f"{path}, frame {frame}, joint {SMPLX52.joints[joint]}",
        found=f"({value}), deviation {off[frame, joint]:.3g}; {int(bad.any(axis=1).sum())} of {len(rows)} frames",
        allowed=f"two rows of a rotation matrix, of length 1 and at right angles within {TOLERANCE:g}",
        fix=fix,
    )


def _off_orthonormal(a: Floats, b: Floats) -> Floats:
    """Return the deviation of pairs of vectors (..., 3) from length 1 and a right angle: the largest of the three."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = [np.abs(np.linalg.norm(v, axis=-1) - 1) for v in (a, b)]
        off = np.maximum.reduce([*lengths, np.abs(np.sum(a * b, axis=-1))])
    return np.asarray(np.nan_to_num(off, nan=np.inf, posinf=np.inf))
