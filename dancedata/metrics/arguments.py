"""Checks of the arguments of metrics."""

from collections.abc import Iterable
from typing import Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import Undefined
from dancedata.core.errors import DataError, UsageError, did_you_mean
from dancedata.core.rotations import Float64Array

Up = Literal["y", "z"]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]


def axis_of(up: Up) -> int:
    """Return the number of the vertical axis."""
    if up not in ("y", "z"):
        raise UsageError("not a vertical axis", found=repr(up), allowed="y or z")
    return "xyz".index(up)


def y_up(joints: Float64Array, up: Up) -> Float64Array:
    """Return positions (T, J, 3) with y up: (x, y, z) becomes (x, z, -y) where z is up."""
    return joints if axis_of(up) == 1 else joints[..., (0, 2, 1)] * (1, 1, -1)


def checked_rate(fps: float) -> float:
    """Return frames per second; UsageError if they are not a number above 0."""
    rate = float(fps)
    if not (np.isfinite(rate) and rate > 0):
        raise UsageError("a frame rate must be above 0", found=fps, allowed="frames per second, > 0")
    return rate


def at_least(n_frames: int, joints: Float64Array) -> None:
    """Raise Undefined ("short") for joints (T, J, 3) with fewer frames."""
    if len(joints) < n_frames:
        raise Undefined("short", found=f"{len(joints)} frames", allowed=f"at least {n_frames}")


def first_joints(joints: Float64Array, n: int) -> Float64Array:
    """Return the first n joints of (T, J, 3); DataError "missing_joints" if there are fewer."""
    if joints.shape[1] < n:
        raise DataError("the metric needs more joints", reason="missing_joints", found=f"{joints.shape[1]} joints",
                        allowed=f"the first {n} joints of SMPL or SMPL-X")  # fmt: skip
    return joints[:, :n]


def known_name(what: str, name: str, allowed: Iterable[str]) -> None:
    """Raise UsageError with the closest allowed name for any other."""
    names = tuple(allowed)
    if name not in names:
        raise UsageError(f"unknown {what} {name!r}", fix=did_you_mean(str(name), names))
