"""Clips whose movement is unlike that of the others, by robust z, each with its reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dancedata.report.measure import ClipNumbers

#: A robust z above this is a reason (Iglewicz and Hoaglin 1993).
LIMIT = 3.5
#: Numbers that are compared, their names and units; only large values are a fault.
MEASURES = {
    "floor_drift_m": ("floor drifts", "m"),
    "below_floor_m": ("joints below the floor", "m"),
    "sliding": ("feet slide", ""),
    "bone_spread_m": ("bones change length", "m"),
    "jerk": ("jerk", "m/s³"),
}
#: Smallest differences from the median that are a reason, whatever the spread: noise of equal clips is none.
_LEAST = {"floor_drift_m": 0.02, "below_floor_m": 0.02, "sliding": 0.02, "bone_spread_m": 0.005}


@dataclass(frozen=True)
class Reason:
    """A number of a clip that is unlike the others: the number, the median of all, and its robust z."""

    measure: str
    value: float
    median: float
    z: float


@dataclass(frozen=True)
class Outlier:
    """A clip with its reasons, the strongest first."""

    clip: str
    reasons: tuple[Reason, ...]


def robust_z(values: Sequence[float]) -> list[float]:
    """Return 0.6745 (x - median) / MAD of values.

    Where the MAD is 0, the mean deviation over 0.7979 takes the place of MAD / 0.6745.
    """
    numbers = np.asarray(values, dtype=np.float64)
    away = numbers - np.median(numbers)
    spread = float(np.median(np.abs(away))) / 0.6745 or float(np.abs(away).mean()) * 1.2533
    return (away / spread).tolist() if spread else [0.0] * len(numbers)


def outliers(clips: Mapping[str, ClipNumbers]) -> tuple[Outlier, ...]:
    """Return the clips with a number far above the median of all, the farthest first."""
    reasons: dict[str, list[Reason]] = {}
    for measure in MEASURES:
        named = {clip: v for clip, numbers in clips.items() if (v := getattr(numbers, measure)) is not None}
        if not named:
            continue
        median = float(np.median(list(named.values())))
        for (clip, value), z in zip(named.items(), robust_z(list(named.values())), strict=True):
            if z > LIMIT and value - median >= _LEAST.get(measure, 0.0):
                reasons.setdefault(clip, []).append(Reason(measure, float(value), median, round(z, 2)))
    found = [Outlier(clip, tuple(sorted(of_clip, key=lambda r: -r.z))) for clip, of_clip in reasons.items()]
    return tuple(sorted(found, key=lambda outlier: (-outlier.reasons[0].z, outlier.clip)))
