"""Intervals of scores by the bootstrap: how much they depend on the clips that happen to be in the set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from dancedata.core.dance import Undefined
from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array


@dataclass(frozen=True)
class Interval:
    """An interval of a score.

    Attributes
    ----------
    low, high
        Its ends.
    level
        Share of the resampled scores within.
    """

    low: float
    high: float
    level: float


def bootstrap(
    rows: Float64Array,
    scores: Callable[[Float64Array], Mapping[str, float]],
    *,
    n: int = 1000,
    level: float = 0.95,
    seed: int = 0,
) -> dict[str, Interval]:
    """Return an interval of each score of a set: clips are drawn with replacement, n times (Efron 1979).

    The quantiles of the drawn scores minus their mean are added to the score. For means this is the percentile
    interval. The Frechet distance of drawn sets is larger on average, as they have fewer different clips; this bias
    is left out.

    Parameters
    ----------
    rows
        (N, C) numbers of the clips.
    scores
        Gives the scores of rows, such as ``lambda rows: metric.summarise(rows, pool)``.
    n
        Number of draws.
    level
        Share of the draws within the interval.
    seed
        Equal seeds give equal intervals.

    Raises
    ------
    Undefined
        "few_clips": fewer than two.
    UsageError
        For n below 1 or a level that is not between 0 and 1.
    """
    if n < 1 or not 0 < level < 1:
        raise UsageError("invalid bootstrap", found=f"n={n}, level={level}", allowed="n >= 1, 0 < level < 1")
    if len(rows) < 2:
        raise Undefined("few_clips", found=f"{len(rows)} clips", allowed="at least 2")
    rng = np.random.default_rng(seed)
    drawn = [scores(rows[rng.integers(0, len(rows), len(rows))]) for _ in range(n)]
    intervals = {}
    for name, score in scores(rows).items():
        values = np.array([each[name] for each in drawn if name in each])
        low, high = np.quantile(values - values.mean(), [(1 - level) / 2, (1 + level) / 2])
        intervals[name] = Interval(float(score + low), float(score + high), level)
    return intervals
