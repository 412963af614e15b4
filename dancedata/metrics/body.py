"""The floor that a dancer stands on, and the lengths of bones, over the time of a motion."""

from __future__ import annotations

import numpy as np

from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton

#: Seconds of a stretch whose lowest foot joint is the floor.
_STRETCH_S = 2.0


def floor_drift(joints: Float64Array, rate: float, skeleton: Skeleton) -> float:
    """Return the largest difference of the lowest foot joints of two stretches of 2 s, metres; 0 below 2 s."""
    lowest = lowest_of_stretches(joints, rate, skeleton)[1]
    return float(np.ptp(lowest)) if len(lowest) else 0.0


def lowest_of_stretches(joints: Float64Array, rate: float, skeleton: Skeleton) -> tuple[Float64Array, Float64Array]:
    """Return the frame and the height of the lowest foot joint of each whole stretch of 2 s."""
    stretch = max(1, round(_STRETCH_S * rate))
    feet = joints[:, list(skeleton.feet), 1].min(axis=1)
    starts = range(0, len(feet) - stretch + 1, stretch)
    frames = np.array([k + int(np.argmin(feet[k : k + stretch])) for k in starts], dtype=np.int64)
    return frames.astype(np.float64), feet[frames]


def bone_spread(joints: Float64Array, skeleton: Skeleton) -> float:
    """Return the largest range of the length of a bone of joints (T, J, 3), from its 1 % to its 99 % quantile."""
    child = [j for j, parent in enumerate(skeleton.parents) if parent >= 0]
    parents = [skeleton.parents[j] for j in child]
    lengths = np.linalg.norm(joints[:, child] - joints[:, parents], axis=2)
    spread = np.ptp(np.quantile(lengths, (0.01, 0.99), axis=0), axis=0).max() if len(joints) and child else 0.0
    return float(spread)
