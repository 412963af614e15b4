"""Clips whose movement is unlike that of the others, by robust z, each with its reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dancedata.pages.measure import ClipNumbers

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
#: Largest z.
_FARTHEST = 1e6


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


def robust_z(values: Sequence[float], among: Sequence[float] | None = None) -> list[float]:
    """Return 0.6745 (x - median) / MAD of values, with the median and MAD of `among`, by default of the values.

    Where the MAD is 0, the mean deviation over 0.7979 takes the place of MAD / 0.6745. No z is above 1e6.
    """
    numbers = np.asarray(values, dtype=np.float64)
    usual = numbers if among is None else np.asarray(among, dtype=np.float64)
    middle = np.median(usual)
    away = np.abs(usual - middle)
    spread = float(np.median(away)) / 0.6745 or float(away.mean()) * 1.2533
    if not spread:  # of equal numbers: any other is as far away as can be
        return [_FARTHEST * float(np.sign(number - middle)) for number in numbers]
    return [float(z) for z in np.clip((numbers - middle) / spread, -_FARTHEST, _FARTHEST)]


def outliers(clips: Mapping[str, ClipNumbers], among: Mapping[str, ClipNumbers] | None = None) -> tuple[Outlier, ...]:
    """Return the clips with a number far above the median of `among`, by default of all, the farthest first."""
    reasons: dict[str, list[Reason]] = {}
    for measure in MEASURES:
        named = {clip: v for clip, numbers in clips.items() if (v := getattr(numbers, measure)) is not None}
        if not named:
            continue
        usual = [v for numbers in (among or clips).values() if (v := getattr(numbers, measure)) is not None]
        if not usual:
            continue
        median = float(np.median(usual))
        for (clip, value), z in zip(named.items(), robust_z(list(named.values()), usual), strict=True):
            if z > LIMIT and value - median >= _LEAST.get(measure, 0.0):
                reasons.setdefault(clip, []).append(Reason(measure, float(value), median, round(z, 2)))
    found = [Outlier(clip, tuple(sorted(of_clip, key=lambda r: -r.z))) for clip, of_clip in reasons.items()]
    return tuple(sorted(found, key=lambda outlier: (-outlier.reasons[0].z, outlier.clip)))
