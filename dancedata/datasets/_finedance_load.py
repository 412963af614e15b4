"""One FineDance motion file -> canonical motion, with every way it can be wrong told apart."""

from __future__ import annotations

import math
import os
import tokenize
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import SMPLX52, SMPLX55
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import matrix_from_6d, rotvec_from_matrix
from dancedata.core.skeleton import Skeleton

__all__ = ["load_motion", "motion_length"]

JOINTS = SMPLX52.n_joints
COLUMNS = 3 + 6 * JOINTS
TOLERANCE = 1e-3
"""How far the rows of a matrix may be from orthonormal; float32 files are within 1e-7."""

# The file's joints among the skeleton's: all but jaw and eyes.
_OF_55 = [SMPLX55.index(joint) for joint in SMPLX52.joints]
# What numpy's reader of headers lets through, besides ValueError, for headers made up to hurt.
_HEADER_ERRORS = (ValueError, TypeError, OverflowError, SyntaxError, RecursionError, MemoryError, tokenize.TokenError)
_GET_ANEW = "get the file anew"

Floats = NDArray[np.float64]


def load_motion(path: Path, frame_rate: int, skeleton: Skeleton, trim_start: int = 0) -> Motion:
    """Read a (T, 315) array: translation 3, then 52 joints x 6D (two rows of each matrix).

    Parameters
    ----------
    path : .npy file. Nothing in it is executed; its header is checked before memory is taken.
    frame_rate : frames a second, 30 for FineDance.
    skeleton : SMPL-X's 55 joints, with the bones that are wanted.
    trim_start : first frame that belongs to the dance.

    Returns
    -------
    Motion
        rotations (T, 55, 3) axis-angle radians, jaw and eyes zero; translation (T, 3) metres as in the file;
        +Y up. The 6D columns of the result are the file's within float32's precision.

    Raises
    ------
    DataError
        reason ``broken_file``, ``unsafe_pickle``, ``bad_shape``, ``empty``, ``nan``, ``bad_rotation`` or
        ``too_short`` (nothing is left after the cut).
    """
    array = _read(path)
    _check_finite(path, array)
    rows = array[:, 3:].reshape(len(array), JOINTS, 6)
    _check_rotations(path, rows)
    if trim_start >= len(array):
        raise DataError(
            "nothing is left of the motion once its beginning is cut",
            reason="too_short",
            where=str(path),
            found=f"{len(array)} frames, the first {trim_start} of them to be cut",
            fix="check that this is the file of that id, or set trim: false",
        )
    rotations = np.zeros((len(array), SMPLX55.n_joints, 3))
    rotations[:, _OF_55] = rotvec_from_matrix(matrix_from_6d(rows))
    return Motion(array[:, :3], rotations, FrameGrid.of(frame_rate), skeleton, trim_start)


def motion_length(path: Path) -> int | None:
    """Return the number of frames that the file's header states; None if it cannot be read as motion."""
    try:
        with open(path, "rb") as file:
            shape = _header(path, file)
    except (OSError, DataError):
        return None
    return int(shape[0])


def _read(path: Path) -> Floats:
    """Return the array as float64, once its header is found to be sound."""
    try:
        with open(path, "rb") as file:
            _header(path, file)
            file.seek(0)
            array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    except OSError as error:
        raise _broken(path, str(error)) from error
    except _HEADER_ERRORS as error:  # the file changed since its header was read
        raise _broken(path, str(error)) from error
    return array.astype(np.float64)


def _header(path: Path, file: BinaryIO) -> tuple[int, ...]:
    """Check the header of a .npy file and return the shape, (T, 315)."""
    try:
        version = np.lib.format.read_magic(file)
        # Version 3 exists for names of fields in other scripts; plain arrays are 1 or 2.
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    except _HEADER_ERRORS as error:
        raise _broken(path, f"no .npy header: {error}") from error
    if dtype.hasobject:
        raise DataError(
            "the file holds pickled Python objects, which are not loaded",
            reason="unsafe_pickle",
            where=str(path),
            found=f"dtype {dtype}",
            allowed="an array of floats",
            fix="get the file anew, or save the array itself if you trust its source",
        )
    held, stated = os.fstat(file.fileno()).st_size - file.tell(), dtype.itemsize * math.prod(shape)
    if held != stated:
        problem = f"{held:,} bytes where an array {shape} of {dtype} has {stated:,}"
        raise _broken(path, problem)
    _check_shape(path, shape, dtype)
    return tuple(shape)


def _check_shape(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    if dtype.kind not in "fiu" or len(shape) != 2 or shape[1] != COLUMNS:
        raise DataError(
            "the motion file has the wrong shape",
            reason="bad_shape",
            where=str(path),
            found=f"{shape} of {dtype}",
            allowed=f"(T, {COLUMNS}) of floats: translation 3, then {JOINTS} joints x 6D",
            fix=_shape_advice(shape),
        )
    if shape[0] == 0:
        raise DataError("the motion has no frames", reason="empty", where=str(path), fix=_GET_ANEW)


def _shape_advice(shape: tuple[int, ...]) -> str:
    """Say what the file probably is."""
    if len(shape) == 2 and shape[1] == COLUMNS + 4:
        return (
            "319 columns are features that FineDance's or Lodge's scripts make (contacts first; Lodge's are cut and "
            "grounded as well): give the motion/ folder as it was published"
        )
    if len(shape) == 2 and shape[0] == COLUMNS:
        return "the array lies on its side: transpose it"
    return _GET_ANEW


def _check_finite(path: Path, array: Floats) -> None:
    bad = np.asarray(~np.isfinite(array).all(axis=1))
    if bad.any():
        frame = int(bad.argmax())
        column = int(np.argmax(~np.isfinite(array[frame])))
        raise DataError(
            "the motion holds values that are not finite",
            reason="nan",
            where=f"{path}, frame {frame}, column {column}",
            found=f"{int(bad.sum())} of {len(bad)} frames with NaN or infinity",
            fix=_GET_ANEW,
        )


def _check_rotations(path: Path, rows: Floats) -> None:
    """Check that all 6D rotations (T, 52, 6) are two rows of a rotation matrix."""
    off = _off_orthonormal(rows[..., :3], rows[..., 3:])
    bad = off > TOLERANCE
    if not bad.any():
        return
    frame, joint = (int(i) for i in np.argwhere(bad)[0])
    value = ", ".join(f"{x:.4g}" for x in rows[frame, joint])
    fix = "normalise the rotations (Gram-Schmidt) if a model made them, or get the file anew"
    # Two columns, flattened row by row (r00 r01 r10 r11 r20 r21), look just so.
    if (_off_orthonormal(rows[..., 0::2], rows[..., 1::2]) <= TOLERANCE).all():
        fix = (
            "as two columns of the matrix, flattened row by row (Zhou et al. 2019), all of them are rotations: write "
            "the first two rows instead"
        )
    raise DataError(
        "a 6D rotation is none",
        reason="bad_rotation",
        where=f"{path}, frame {frame}, joint {SMPLX52.joints[joint]}",
        found=f"({value}), {off[frame, joint]:.3g} off; {int(bad.any(axis=1).sum())} of {len(rows)} frames",
        allowed=f"two rows of a rotation matrix, of length 1 and at right angles within {TOLERANCE:g}",
        fix=fix,
    )


def _off_orthonormal(a: Floats, b: Floats) -> Floats:
    """Return how far pairs of vectors (..., 3) are from length 1 and a right angle: the worst of the three."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = [np.abs(np.linalg.norm(v, axis=-1) - 1) for v in (a, b)]
        off = np.maximum.reduce([*lengths, np.abs(np.sum(a * b, axis=-1))])
    return np.asarray(np.nan_to_num(off, nan=np.inf, posinf=np.inf))


def _broken(path: Path, problem: str) -> DataError:
    return DataError(
        "the motion file cannot be read", reason="broken_file", where=str(path), found=problem, fix=_GET_ANEW
    )
