"""Key motions: the kinetic curve of a dance and its minima (Lodge; Li et al., CVPR 2024)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import checked_joints
from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array, FloatArray

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

#: Lodge's Gaussian, at 30 frames per second.
SIGMA_FRAMES = 5.0
#: Frames of a key motion: [m - 4, m + 4) around frame m.
LENGTH = 8
HALF = LENGTH // 2
#: Columns of a stored key motion: smoothed curve, 1 at a minimum, prominence.
SPEED, MINIMUM, PROMINENCE = range(3)
#: Metres per frame. On a flat curve, rounding makes minima of about 1e-17; those of a movement are above 1e-7.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class KeyMotion:
    """The kinetic curve of T frames and its minima.

    The frame m of a minimum is its index in the curve, as in Lodge. Value m of the curve is the distance from frame m
    to frame m + 1, so the body is slowest at the instant m + 1/2.

    Attributes
    ----------
    curve
        (T - 1,) smoothed kinetic curve, metres per frame.
    minima
        (M,) frames of its strict local minima, ascending.
    prominence
        (M,) depth, metres per frame: the rise of the curve before it falls below the minimum, on the side
        with the smaller rise.
    """

    curve: Float64Array
    minima: IntArray
    prominence: Float64Array

    def __repr__(self) -> str:
        return f"KeyMotion(curve of {len(self.curve)} frames, {len(self.minima)} minima)"

    def to_rows(self) -> npt.NDArray[np.float32]:
        """Return one row per frame, (T, 3) float32: curve, 1 at minima, their prominence; 0 elsewhere.

        The last frame has no next one: it repeats the last value of the curve and is not a minimum. All three
        columns of a single frame are 0.
        """
        rows = np.zeros((len(self.curve) + 1, 3), dtype=np.float32)
        if len(self.curve):
            rows[:-1, SPEED] = self.curve
            rows[-1, SPEED] = rows[-2, SPEED]
        rows[self.minima, MINIMUM] = 1
        rows[self.minima, PROMINENCE] = self.prominence
        return rows

    @classmethod
    def from_rows(cls, rows: npt.NDArray[Any]) -> KeyMotion:
        """Make a key motion from rows (T, 3) of `to_rows`, or of a window of them: its frames count from its start.

        The minima of a window are those of the whole; no others are found. UsageError for rows of another shape.
        """
        rows = np.asarray(rows)
        if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) == 0:
            raise UsageError("invalid rows of a key motion", found=f"shape {rows.shape}", allowed="(T, 3)")
        # A window may end on a minimum, which needs no next frame here.
        minima = np.flatnonzero(rows[:, MINIMUM])
        curve = rows[:-1, SPEED].astype(np.float64)
        return cls(curve, minima, rows[minima, PROMINENCE].astype(np.float64))


def kinetic_curve(joints: FloatArray) -> Float64Array:
    """Return the distance (T - 1,) that the joints move to the next frame, a mean over joints, metres per frame.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres.

    Raises
    ------
    DataError
        "bad_shape", "empty" or "nan".
    """
    displacement = np.linalg.norm(np.diff(checked_joints(joints), axis=0), axis=2)
    return np.asarray(displacement.mean(axis=1), dtype=np.float64)


def smoothed(curve: FloatArray, sigma_frames: float = SIGMA_FRAMES) -> Float64Array:
    """Smooth a curve (n,) by a Gaussian of `sigma_frames`, truncated at 4 sigma; reflected at its ends."""
    from scipy.ndimage import gaussian_filter1d

    numbers = np.asarray(curve, dtype=np.float64)
    if len(numbers) == 0:
        return numbers
    return np.asarray(gaussian_filter1d(numbers, sigma_frames, mode="reflect"), dtype=np.float64)


def local_minima(curve: FloatArray, order: int = 1) -> IntArray:
    """Return the indices, ascending, at which a curve (n,) is below all neighbours within `order`; no plateaus.

    Within `order` of an end, the end itself is a neighbour, so that an end is never a minimum.
    """
    from scipy.signal import argrelextrema

    return np.asarray(argrelextrema(np.asarray(curve), np.less, order=order)[0], dtype=np.int64)


def _prominences(curve: FloatArray, minima: IntArray) -> Float64Array:
    """Return the depths of minima (M,) of a curve (n,), in its unit: `peak_prominences` of the negative curve."""
    from scipy.signal import peak_prominences

    return np.asarray(peak_prominences(-np.asarray(curve, dtype=np.float64), minima)[0], dtype=np.float64)


def key_motion(joints: FloatArray, sigma_frames: float = SIGMA_FRAMES) -> KeyMotion:
    """Find all key motions of a dance: strict local minima of the smoothed kinetic curve.

    As in Lodge's code, except that a clip is taken as a whole, and that rounding errors on a flat curve (below
    1e-12 m per frame) are not minima.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres, including frames before a trim.
    sigma_frames
        Of the Gaussian.

    Raises
    ------
    DataError
        As `kinetic_curve`.
    """
    curve = smoothed(kinetic_curve(joints), sigma_frames)
    minima = local_minima(curve)
    prominence = _prominences(curve, minima)
    real = prominence > _ROUNDING
    return KeyMotion(curve, minima[real], prominence[real])
