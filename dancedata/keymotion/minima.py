"""Key motions: the kinetic curve of a dance and its minima (Lodge; Li et al., CVPR 2024)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DataError, UsageError
from dancedata.core.rotations import Float64Array, FloatArray

IntArray = npt.NDArray[np.int64]

#: Lodge's Gaussian, at 30 frames a second.
SIGMA_FRAMES = 5.0
#: Frames of a key motion: [m - 4, m + 4) around frame m.
LENGTH = 8
HALF = LENGTH // 2
#: Columns of a stored key motion: smoothed curve, 1 at a minimum, prominence.
SPEED, MINIMUM, PROMINENCE = range(3)
#: Metres a frame. Where a curve is flat, rounding makes minima of about 1e-17; those of a movement are above 1e-7.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class KeyMotion:
    """The kinetic curve of T frames and its minima.

    Frame m of a minimum is the index of the curve, as in Lodge. The curve's value m is the way from frame m to
    frame m + 1, so the body is slowest at the instant m + 1/2.

    Attributes
    ----------
    curve
        (T - 1,) smoothed kinetic curve, metres a frame.
    minima
        (M,) frames of its strict local minima, ascending.
    prominence
        (M,) depth, metres a frame: how far the curve rises before it falls below the minimum, on that side
        where it rises less.
    """

    curve: Float64Array
    minima: IntArray
    prominence: Float64Array

    def __repr__(self) -> str:
        """Show how many minima the curve has."""
        return f"KeyMotion(curve of {len(self.curve)} frames, {len(self.minima)} minima)"

    def to_rows(self) -> npt.NDArray[np.float32]:
        """Return one row a frame, (T, 3) float32: curve, 1 at a minimum else 0, prominence there else 0.

        The last frame has no next one: it repeats the last value of the curve and is no minimum. All three
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
        """Read rows (T, 3) that `to_rows` gave, or any stretch of them: the frames of a window count from its start.

        The minima of a stretch are those of the whole; none is found anew.

        Raises
        ------
        UsageError
            For another shape.
        """
        rows = np.asarray(rows)
        if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) == 0:
            raise UsageError("the rows of a key motion are (T, 3)", found=f"shape {rows.shape}")
        # A stretch may end on a minimum, which needs no next frame here.
        minima = np.flatnonzero(rows[:, MINIMUM])
        curve = rows[:-1, SPEED].astype(np.float64)
        return cls(curve, minima, rows[minima, PROMINENCE].astype(np.float64))


def kinetic_curve(joints: FloatArray) -> Float64Array:
    """Return how far the joints go to the next frame, as a mean over joints.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres.

    Returns
    -------
    (T - 1,) float64
        Metres a frame.

    Raises
    ------
    DataError
        "bad_shape", "empty" or "nan".
    """
    joints = np.asarray(joints, dtype=np.float64)
    if joints.ndim != 3 or joints.shape[2] != 3:
        raise DataError(
            "a kinetic curve is made of joints", reason="bad_shape", found=f"{joints.shape}", allowed="(T, J, 3)"
        )
    if joints.size == 0:
        raise DataError("a kinetic curve needs a frame and a joint", reason="empty", found=f"{joints.shape}")
    bad = ~np.isfinite(joints).all(axis=(1, 2))
    if bad.any():
        raise DataError(
            "the joints hold NaN or infinity",
            reason="nan",
            found=f"{int(bad.sum())} of {len(joints)} frames, the first at frame {int(np.argmax(bad))}",
        )
    displacement = np.linalg.norm(np.diff(joints, axis=0), axis=2)
    return np.asarray(displacement.mean(axis=1), dtype=np.float64)


def smoothed(curve: FloatArray, sigma_frames: float = SIGMA_FRAMES) -> Float64Array:
    """Smooth a curve (n,) by a Gaussian of `sigma_frames`, cut at 4 sigma; the curve is reflected at its ends."""
    from scipy.ndimage import gaussian_filter1d

    numbers = np.asarray(curve, dtype=np.float64)
    if len(numbers) == 0:
        return numbers
    return np.asarray(gaussian_filter1d(numbers, sigma_frames, mode="reflect"), dtype=np.float64)


def local_minima(curve: FloatArray) -> IntArray:
    """Return where a curve (n,) is lower than both neighbours, ascending; never its ends, never a plateau."""
    from scipy.signal import argrelextrema

    return np.asarray(argrelextrema(np.asarray(curve), np.less)[0], dtype=np.int64)


def prominences(curve: FloatArray, minima: IntArray) -> Float64Array:
    """Return how deep minima (M,) of a curve (n,) are, in its unit: `scipy.signal.peak_prominences` upside down."""
    from scipy.signal import peak_prominences

    return np.asarray(peak_prominences(-np.asarray(curve, dtype=np.float64), minima)[0], dtype=np.float64)


def key_motion(joints: FloatArray, sigma_frames: float = SIGMA_FRAMES) -> KeyMotion:
    """Find all key motions of a dance: strict local minima of the smoothed kinetic curve.

    As Lodge's code does it, save that a clip is taken as a whole and that ripples of rounding on a flat
    stretch (below 1e-12 m a frame) are no minima.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres. Frames before a trim belong to them.
    sigma_frames
        Of the Gaussian.

    Raises
    ------
    DataError
        As `kinetic_curve`.
    """
    curve = smoothed(kinetic_curve(joints), sigma_frames)
    minima = local_minima(curve)
    prominence = prominences(curve, minima)
    real = prominence > _ROUNDING
    return KeyMotion(curve, minima[real], prominence[real])
