"""Intervals of scores: their dependence on the choice of clips."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from dancedata.core.dance import Undefined
from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array

#: Sets of fewer clips have no intervals.
MIN_CLIPS = 3


@dataclass(frozen=True)
class Interval:
    """An interval of a score.

    Attributes
    ----------
    low, high
        Its ends, within the bounds of the score.
    level
        Share of sets of clips whose interval holds the score of the population; measured in
        docs/reference/protocols.md.
    clips
        Effective number of clips (Kish 1965): those that carry the score. Where it is far below the number of clips,
        tails are heavy, and the interval is too short.
    """

    low: float
    high: float
    level: float
    clips: float


def jackknife(
    rows: Float64Array,
    scores: Callable[[Float64Array], Mapping[str, float]],
    *,
    n: int = 200,
    level: float = 0.95,
    seed: int = 0,
    bounds: tuple[float, float] = (-np.inf, np.inf),
) -> dict[str, Interval]:
    """Return an interval of each score of a set: Student's t with the standard error of the jackknife (Tukey 1958).

    Each clip is left out once; of more than `n` clips, each of `n` groups. For means this is the usual standard
    error; it is defined for Frechet distance and diversity too, whose population score is that of sets of this size.
    Scores with bounds are transformed: by the logarithm of the distance from a lower bound, or by the logit between
    two, with as many degrees of freedom as effective clips less one.

    Parameters
    ----------
    rows
        (N, C) numbers of the clips.
    scores
        Gives the scores of rows, such as ``lambda rows: metric.summarise(rows, pool)``.
    n
        How many times scores are computed again, at most.
    level
        Share of sets whose interval is to hold the score of the population.
    seed
        Deals the clips to groups; equal seeds give equal intervals.
    bounds
        Lowest and highest value that the scores can have: of a metric, `Metric.bounds`.

    Returns
    -------
    dict
        By score. A score that no clip changes, or that is at a bound, has no interval.

    Raises
    ------
    Undefined
        "few_clips": fewer than three.
    UsageError
        For n below 3 or a level that is not between 0 and 1.
    """
    if n < MIN_CLIPS or not 0 < level < 1:
        allowed = f"n >= {MIN_CLIPS}, 0 < level < 1"
        raise UsageError("invalid interval", found=f"n={n}, level={level}", allowed=allowed)
    if len(rows) < MIN_CLIPS:
        raise Undefined("few_clips", found=f"{len(rows)} clips", allowed=f"at least {MIN_CLIPS}")
    groups = [np.array([k]) for k in range(len(rows))]
    if len(rows) > n:
        groups = np.array_split(np.random.default_rng(seed).permutation(len(rows)), n)
    without = [scores(np.delete(rows, group, axis=0)) for group in groups]
    intervals = {}
    for name, score in scores(rows).items():
        values = np.array([each.get(name, np.nan) for each in without])
        error = float(values.std() * np.sqrt(len(groups) - 1))
        interval = _interval(float(score), error, len(groups), level, bounds)
        if interval is not None:
            intervals[name] = interval
    return intervals


def _interval(score: float, error: float, n: int, level: float, bounds: tuple[float, float]) -> Interval | None:
    """Return the interval of a score from its standard error, of n clips or groups; None without one."""
    from scipy.special import expit, logit, stdtrit  # Student's quantile; importing scipy.stats takes a second

    low, high = bounds
    if not (np.isfinite(score) and np.isfinite(error) and low < score < high and error > abs(score) * 1e-12):
        return None
    if np.isinf(low):
        reach = error * stdtrit(n - 1, (1 + level) / 2)
        return Interval(float(score - reach), float(score + reach), level, float(n))
    width = high - low
    share = (score - low) / width if np.isfinite(width) else 0.0
    relative = error / (score - low) / (1 - share)
    clips = n / (1 + (n - 1) * relative**2)
    reach = relative * stdtrit(max(clips - 1, 1), (1 + level) / 2)
    with np.errstate(over="ignore"):
        ends = [
            low + (width * expit(logit(share) + sign) if share else (score - low) * np.exp(sign))
            for sign in (-reach, reach)
        ]
    return Interval(float(ends[0]), float(ends[1]), level, float(clips)) if np.isfinite(ends[1]) else None
