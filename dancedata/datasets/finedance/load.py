"""One FineDance motion file -> canonical motion, with every way it can be wrong told apart."""

from __future__ import annotations

import math
import os
import tokenize
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import SMPLX52
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.regular_file import open_regular
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import shown
from dancedata.formats.npy_header import require_short_header
from dancedata.formats.six_d import check_rows, rotations_of

__all__ = ["load_motion", "motion_length"]

JOINTS = SMPLX52.n_joints
COLUMNS = 3 + 6 * JOINTS
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
    check_rows(path, rows)
    if trim_start >= len(array):
        raise DataError(
            "nothing is left of the motion once its beginning is cut",
            reason="too_short",
            where=str(path),
            found=f"{len(array)} frames, the first {trim_start} of them to be cut",
            fix="check that this is the file of that id, or set trim: false",
        )
    return Motion(array[:, :3], rotations_of(rows), FrameGrid.of(frame_rate), skeleton, trim_start)


def motion_length(path: Path) -> int | None:
    """Return the number of frames that the file's header states; None if it cannot be read as motion."""
    try:
        with open_regular(path) as file:
            shape = _header(path, file)
    except (OSError, DataError):
        return None
    return int(shape[0])


def _read(path: Path) -> Floats:
    """Return the array as float64, once its header is found to be sound."""
    try:
        with open_regular(path) as file:
            _header(path, file)
            file.seek(0)
            array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    except OSError as error:
        raise _broken(path, str(error)) from error
    except _HEADER_ERRORS as error:  # the file changed since its header was read
        raise _broken(path, shown(error)) from error
    with np.errstate(over="ignore", invalid="ignore"):  # of long doubles; reported as not finite
        return array.astype(np.float64)


def _header(path: Path, file: BinaryIO) -> tuple[int, ...]:
    """Check the header of a .npy file and return the shape, (T, 315)."""
    try:
        version = np.lib.format.read_magic(file)
        # Version 3 exists for names of fields in other scripts; plain arrays are 1 or 2.
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        require_short_header(file, version)
        shape, _, dtype = read(file)
    except _HEADER_ERRORS as error:
        raise _broken(path, f"no .npy header: {shown(error)}") from error
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


def _broken(path: Path, problem: str) -> DataError:
    return DataError(
        "the motion file cannot be read", reason="broken_file", where=str(path), found=problem, fix=_GET_ANEW
    )
