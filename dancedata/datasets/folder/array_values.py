"""Values of the arrays of a motion: finite and in range, scales, rotation matrices; and the errors about them."""

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.rotations import rotvec_from_matrix
from dancedata.datasets import checks
from dancedata.datasets.checks import require_finite
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.bvh.hierarchy import MAX_VALUE

#: Tolerance of the orthonormality of rotation matrices; float16 is within 2e-3.
_TOLERANCE = 1e-2

Floats = NDArray[np.float64]


def finite(arrays: ArrayFile, name: str) -> Floats:
    """Return one array as (T, columns), checked for frames, NaN and infinity."""
    shape = arrays.shape(name)
    if len(shape) < 2:
        raise bad_shape(arrays, name, "frames x columns")
    if 0 in shape:
        fix = "remove the file, or save it again"
        raise DataError("the motion has no frames", reason="empty", where=str(arrays.path), found=str(shape), fix=fix)
    array = arrays.read(name).reshape(shape[0], -1)
    require_finite(arrays.path, name or "the array", array, "remove these frames, or the file")
    if np.abs(array).max() > MAX_VALUE:
        frame = int(np.abs(array).max(axis=1).argmax())
        raise DataError(f"{name or 'the array'} contains numbers outside the range of angles and lengths",
                        reason="out_of_range", where=f"{arrays.path}, frame {frame}",
                        found=f"{np.abs(array[frame]).max():.3g}", allowed=f"numbers within +-{MAX_VALUE:g}",
                        fix="save the file again")  # fmt: skip
    return array


def scaling(arrays: ArrayFile, name: str) -> float:
    """Return AIST++'s number that turns the translation into metres; DataError (``bad_scaling``)."""
    value = arrays.read(name).reshape(-1)
    if len(value) != 1 or not 1e-3 <= value[0] <= 1e6:
        raise DataError(f"{name} cannot turn the translation into metres", reason="bad_scaling",
                        where=str(arrays.path), found=f"{value[:3].tolist()}",
                        allowed="one number above 0 (about 89 to 99 in AIST++; 1 for data in metres)",
                        fix="save the file again")  # fmt: skip
    return float(value[0])


def bad_shape(arrays: ArrayFile, name: str, allowed: str, fix: str | None = None) -> DataError:
    """Return the DataError for an array of another shape."""
    fix = fix or "save the motion in one of these layouts"
    return checks.bad_shape(arrays.path, name or "the array", arrays.shape(name), allowed, fix)


def scales(arrays: ArrayFile, name: str, n_frames: int) -> Floats:
    """Return (1, 1), or (T, 1): what the recipe's key ``scale`` divides the translation by; DataError.

    One number, one per frame, or a weak-perspective camera (T, 3 or 4) whose first column is the scale.
    """
    values = arrays.read(name)
    columns = (
        values.reshape(1, 1) if values.size == 1 else values[:, :1] if values.ndim == 2 else values.reshape(-1, 1)
    )
    if (
        columns.shape not in ((1, 1), (n_frames, 1))
        or values.ndim > 2
        or not ((columns >= 1e-6) & (columns <= 1e6)).all()
    ):
        raise DataError(f"{name or 'the array'} cannot scale the translation", reason="bad_scaling",
                        where=str(arrays.path),
                        found=f"shape {values.shape}, from {columns.min(initial=np.inf):.3g} to "
                        f"{columns.max(initial=-np.inf):.3g}",
                        allowed=f"one number, ({n_frames},), or ({n_frames}, 3) with the scale first; above 0",
                        fix="correct the key scale of dataset.folder.keys, or remove it")  # fmt: skip
    return columns


def from_matrices(arrays: ArrayFile, name: str, values: Floats) -> Floats:
    """Return axis-angle rotations (T, J, 3) of matrices (T, J * 9), row by row; DataError (``bad_rotation``)."""
    matrices = values.reshape(len(values), -1, 3, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-1, -2))
        bad = ~(off <= _TOLERANCE) | ~(np.linalg.det(matrices) > 0)
    if bad.any():
        frame, joint = (int(i) for i in np.argwhere(bad)[0])
        raise DataError(
            "not a rotation matrix",
            reason="bad_rotation",
            where=f"{arrays.path}, {name}, frame {frame}, joint {joint}",
            found=f"deviation {off[frame, joint]:.3g}; {int(bad.any(axis=1).sum())} of {len(values)} frames",
            allowed=f"rows of length 1 at right angles within {_TOLERANCE:g}, right-handed",
            fix="give the array that has rotation matrices (or axis-angle rotations, 3 columns per joint)",
        )
    return rotvec_from_matrix(matrices)
