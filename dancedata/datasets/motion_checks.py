"""Checks of the arrays of motion files that all readers make, and the errors about them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.text import listed, quoted
from dancedata.formats.arrays import ArrayFile

DOWNLOAD_AGAIN = "download the file again"
#: Bound of the deviation of published matrices from rotations.
_TOLERANCE = 1e-3

Floats = NDArray[np.float64]


def require_keys(arrays: ArrayFile, keys: Sequence[str], allowed: str = "") -> None:
    """Check that a motion file has its keys, of which `allowed` tells more than their names.

    Raises DataError: ``missing_key``.
    """
    missing = [key for key in keys if key not in arrays.names]
    if missing:
        raise DataError(f"the motion file has no {' and no '.join(missing)}", reason="missing_key",
                        where=str(arrays.path), found=f"keys {listed(arrays.names, show=quoted) or 'none'}",
                        allowed=f"a dict with {allowed or ', '.join(keys)}", fix=DOWNLOAD_AGAIN)  # fmt: skip


def require_finite(path: Path, what: str, array: Floats, fix: str, *, columns: bool = False) -> None:
    """Check that an array (T, ...) of a file is finite.

    Raises DataError: ``nan``, with the first frame that is not, and with its column if `columns` are known to the
        user.
    """
    finite = np.isfinite(array.reshape(len(array), -1))
    bad = np.asarray(~finite.all(axis=1))
    if bad.any():
        frame = int(bad.argmax())
        column = f", column {int(finite[frame].argmin())}" if columns else ""
        raise DataError(f"{what} contains values that are not finite", reason="nan",
                        where=f"{path}, frame {frame}{column}",
                        found=f"{int(bad.sum())} of {len(bad)} frames with NaN or infinity", fix=fix)  # fmt: skip


def bad_shape(path: Path, key: str, found: object, allowed: str, fix: str = DOWNLOAD_AGAIN) -> DataError:
    """Return the error for an array of another shape."""
    problem = f"{key} has the wrong shape"
    return DataError(problem, reason="bad_shape", where=str(path), found=str(found), allowed=allowed, fix=fix)


def lengths_differ(path: Path, a: str, n_a: int, b: str, n_b: int, fix: str = DOWNLOAD_AGAIN) -> DataError:
    """Return the error for two arrays, a and b, with different numbers of frames."""
    return DataError(f"{a} and {b} differ in length", reason="length_mismatch", where=str(path),
                     found=f"{n_a} and {n_b} frames", fix=fix)  # fmt: skip


def no_frames(path: Path) -> DataError:
    """Return the error for a motion without frames."""
    return DataError("the motion has no frames", reason="empty", where=str(path), fix=DOWNLOAD_AGAIN)


def require_dancer(path: Path, member: int, dancers: int) -> None:
    """Raise DataError, ``missing_dancer``, if a file with this number of dancers has no dancer `member`."""
    if not 0 <= member < dancers:
        problem, found = f"there is no dancer {member}", f"{dancers} dancers"
        raise DataError(problem, reason="missing_dancer", where=str(path), found=found)


def require_matrices(where: str, matrices: Floats, joints: Sequence[str]) -> None:
    """Raise DataError, ``bad_rotation`` with frame and joint, unless (T, J, 3, 3) are rotation matrices."""
    off = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    off = np.maximum(off, np.abs(np.linalg.det(matrices) - 1))
    if not (off <= _TOLERANCE).all():
        frame, joint = (int(k) for k in np.argwhere(~(off <= _TOLERANCE))[0])
        raise DataError("not a rotation matrix", reason="bad_rotation",
                        where=f"{where}, frame {frame}, joint {joints[joint]}",
                        found=f"deviation {off[frame, joint]:.3g}",
                        allowed=f"orthonormal, determinant 1, within {_TOLERANCE:g}", fix=DOWNLOAD_AGAIN)  # fmt: skip
