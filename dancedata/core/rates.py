"""Evidence in a motion that its frame rate is not the stated one: gravity, and frames that repeat.

A body in the air falls by 9.81 m/s2, and one on the floor sinks hardly faster. With a rate that is stated k times too
high all accelerations are k^2 times as large. Steps are no evidence: their lengths and numbers differ by more than a
factor of 2 between dances.
"""

import numpy as np

from dancedata.core.rotations import Float64Array
from dancedata.core.tracks import runs

_GRAVITY = 9.81
#: Masses of a body's parts at SMPL's 22 body joints, percent (Winter, 2009, table 4.1, shared out).
_MASSES = np.array(
    [12, 10, 10, 10, 6, 6, 10, 2, 2, 10, 0, 0, 3, 0, 0, 5, 3, 3, 2, 2, 1, 1],
    dtype=np.float64,
)  # fmt: skip
#: The lowest joint is in the air above this height over the floor, metres, which is a low quantile of its heights.
_AIR_M, _FLOOR = 0.05, 0.05
#: A jump has frames, a rise, metres, and a parabola that fits within a part of it and has its apex inside.
_LEAST_FRAMES, _RISE_M, _MISFIT, _APEX = 5, 0.02, 0.1, (0.2, 0.8)
#: Ratio of falls to gravity, jumps that show it: 0.94 to 1.6 in the medians of real and synthetic dances.
_HIGH, _LOW = (2.6, 2), (0.34, 3)
#: Below this, and if jumps differ more, what looks like jumps is none.
_LEAST_RATIO, _LEAST_AGREEING = 0.19, 0.75
#: Sinking of the body over 0.2 s that 0.5 % of frames exceed, as a multiple of gravity: at most 1.7 in dances.
_SINKING_S, _SINKING, _MOST_SINKING = 0.2, 0.995, 2.2
#: Runs of equal frames in a motion, and the part of them that are of two frames or more.
_LEAST_RUNS, _LEAST_REPEATED = 10, 0.9


def rate_factor(joints: Float64Array, rate: float) -> float | None:
    """Return how many times too high a rate is stated, of joints (T, J, 3), +Y up; None without evidence."""
    height = joints[:, : len(_MASSES), 1] @ _MASSES / _MASSES.sum()
    falls = np.array(_falls(height, joints[..., 1].min(axis=1), rate))
    ratio = float(np.median(falls)) if len(falls) else 1.0
    if len(falls) >= _HIGH[1] and ratio > _HIGH[0]:
        return float(np.sqrt(ratio))
    agreeing = np.mean(np.abs(np.log(falls / ratio)) < np.log(1.5)) if len(falls) >= _LOW[1] else 0.0
    if agreeing >= _LEAST_AGREEING and _LEAST_RATIO < ratio < _LOW[0]:
        return float(np.sqrt(ratio))
    sinking = _sinking(height, rate)
    return float(np.sqrt(sinking)) if sinking > _MOST_SINKING else None


def _falls(height: Float64Array, lowest: Float64Array, rate: float) -> list[float]:
    """Return the acceleration of each jump, as a multiple of gravity."""
    found = []
    for start, stop in runs(lowest > np.quantile(lowest, _FLOOR) + _AIR_M):
        if stop - start < _LEAST_FRAMES:
            continue
        time = np.arange(stop - start) / rate
        curve = np.polynomial.Polynomial.fit(time, height[start:stop], 2).convert()
        fall, rise = curve.coef, np.ptp(curve(time))
        misfit = np.sqrt(np.mean((curve(time) - height[start:stop]) ** 2))
        if len(fall) == 3 and fall[2] < 0 and rise > _RISE_M and misfit < _MISFIT * rise:
            apex = -fall[1] / (2 * fall[2]) / time[-1]
            found += [-2 * float(fall[2]) / _GRAVITY] if _APEX[0] < apex < _APEX[1] else []
    return found


def _sinking(height: Float64Array, rate: float) -> float:
    """Return the downward acceleration that few frames exceed, of parabolas over 0.2 s, as a multiple of gravity."""
    n = max(5, round(_SINKING_S * rate) | 1)
    if len(height) < 2 * n:
        return 0.0
    time = (np.arange(n) - n // 2) / rate
    kernel = 2 * np.linalg.pinv(np.vander(time, 3, increasing=True))[2]
    return float(np.quantile(-np.correlate(height, kernel, "valid"), _SINKING)) / _GRAVITY


def repeats(joints: Float64Array) -> float | None:
    """Return how many times each frame comes, the median, if nearly all come twice or more; None otherwise."""
    steps = np.abs(np.diff(joints, axis=0)).max(axis=(1, 2))
    if not len(steps):
        return None
    changes = np.flatnonzero(steps > max(1e-6, 1e-3 * float(np.quantile(steps, 0.9))))
    lengths = np.diff(changes)
    if len(lengths) < _LEAST_RUNS or np.mean(lengths >= 2) < _LEAST_REPEATED:
        return None
    return float(np.median(lengths))
