"""Origin and instants of the positions that are measured."""

import math
from typing import Literal

import numpy as np

from dancedata.core.dance import checked_joints
from dancedata.core.rotations import Float64Array
from dancedata.metrics.arguments import checked_rate, known_name

Root = Literal["absolute", "zero_start", "root_relative"]
ROOTS = ("absolute", "zero_start", "root_relative")
#: Rate of `steady` positions, frames per second, and the width of their Gaussian, seconds.
STEADY_FPS = 120
_STEADY_S = 1 / 50


def rooted(joints: Float64Array, root: Root) -> Float64Array:
    """Return joint positions (T, J, 3) with another origin.

    Parameters
    ----------
    joints
        (T, J, 3) metres; joint 0 is the root.
    root
        "absolute": as they are. "zero_start": the root's position in frame 0 is subtracted, its height too (Bailando,
        MEGADance, Motius). "root_relative": then the other joints relative to the root of the same frame, while
        joint 0 keeps its path (Lodge).

    Examples
    --------
    >>> from dancedata.metrics import rooted
    >>> from dancedata.synthetic import synthesise_motion
    >>> joints = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0].joints()
    >>> rooted(joints, "zero_start")[0, 0].tolist()
    [0.0, 0.0, 0.0]
    """
    known_name("root", root, ROOTS)
    positions = checked_joints(joints)
    if root == "absolute":
        return positions
    moved: Float64Array = positions - positions[0, 0]
    if root == "root_relative":
        moved[:, 1:] -= moved[:, :1]
    return moved


def steady(joints: Float64Array, fps: float) -> Float64Array:
    """Return joint positions (T', J, 3) at 120 frames per second, of joints (T, J, 3) at any rate.

    They are those of cubic splines through the frames, smoothed by a Gaussian of 1/50 s, so that speeds and
    accelerations of a motion are the same at any rate: without, steps of 1/20 s cut its corners, and those of
    1/60 s hold more noise. A joint at rest stays exactly at rest.

    Raises DataError: As `checked_joints`.
    """
    from scipy.interpolate import CubicSpline
    from scipy.ndimage import gaussian_filter1d

    positions, rate = checked_joints(joints), checked_rate(fps)
    if len(positions) < 2:
        return positions
    last = (len(positions) - 1) * STEADY_FPS / rate
    frames = np.arange(int(last + 1e-6) + 1) * (rate / STEADY_FPS)
    fine = CubicSpline(np.arange(len(positions)), positions - positions[0])(frames)
    reach = math.ceil(4 * _STEADY_S * STEADY_FPS)
    # Continued by its point reflection, so that speeds at the ends stay.
    padded = np.pad(fine, ((reach, reach), (0, 0), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian_filter1d(padded, _STEADY_S * STEADY_FPS, axis=0)[reach:-reach]
    return np.asarray(smooth + positions[0], dtype=np.float64)
