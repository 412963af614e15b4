"""Scores of a set from the numbers of its clips, with undefined ones, intervals and warnings."""

from dataclasses import dataclass, field

import numpy as np

from dancedata.core.dance import OUTCOMES, Undefined
from dancedata.core.plugins import Metric
from dancedata.core.rotations import Float64Array
from dancedata.core.text import counted, listed
from dancedata.evaluation.pool import MetricRows
from dancedata.metrics.intervals import MIN_CLIPS, Interval, jackknife

#: Intervals of scores that fewer than 1 / HEAVY of the clips carry are known to be too short.
HEAVY = 3
#: Sets and pools with more vectors have no intervals: each draw compares all pairs of vectors.
MAX_VECTORS = 4_000
#: Random divisions of a pool into halves, and least clips of a pool that is divided.
DIVISIONS, MIN_HALVES = 10, 4
_CHANCE, _MEDIAN, _POOL, _VARYING = "_chance", "_median", "_pool", "_varying"
#: Ends of the names of scores that are shown with others, or in warnings.
_BESIDE = (_CHANCE, _MEDIAN, _POOL, _VARYING)
_CONSTANT = "constant_columns"
_NOT_FINITE = "not_finite"


@dataclass(frozen=True)
class Score:
    """One line of a table.

    `name`: Name in the metric: "fid_k".
    `value`: None where it is undefined, see `undefined`.
    `interval`: 95 percent, see `jackknife`; None where there is none.
    `median`, `chance`, `pool`: Where the metric has them: median over pieces, score of beats shifted at random, the
        pool's own diversity.
    `halves`: Of a distance to the pool: that between two random halves of the pool's clips, see `halves_of`. A
        distance near it is as small as the pool can show.
    `n`: Pieces that have a value.
    `undefined`: Ids of clips without a value, by outcome.
    `published`: The figure of the ground truth that was published under the protocol.
    `better`: "higher", "lower" or "closer" to the ground truth.
    """

    name: str
    value: float | None
    n: int
    interval: Interval | None = None
    median: float | None = None
    chance: float | None = None
    pool: float | None = None
    halves: float | None = None
    undefined: dict[str, tuple[str, ...]] = field(default_factory=dict)
    published: float | None = None
    better: str = "closer"

    @property
    def n_undefined(self) -> int:
        """Clips without a value."""
        return len({clip for clips in self.undefined.values() for clip in clips})


def scores_of(
    metric: Metric, rows: MetricRows, pool: Float64Array | None, *, draws: int
) -> tuple[list[Score], list[str]]:
    """Return the scores of a metric, from the numbers (M, C) of the pool if it needs one, and warnings."""
    if metric.needs_pool and pool is None:
        return [], [f"{metric.name} is not computed: it compares with a pool, and none is given (--pool)"]
    try:
        values = _summary(metric, rows.rows, pool)
    except Undefined as error:
        names = [name for name in metric.better if not name.endswith(_BESIDE)] or [metric.name]
        missing = rows.undefined if rows.undefined and not len(rows.rows) else {**rows.undefined, error.reason: ()}
        return [
            Score(name, None, len(rows.rows), undefined=missing, better=metric.better.get(name, "closer"))
            for name in names
        ], []
    intervals, warnings = _intervals(metric, rows, pool, values, draws)
    scores = [
        Score(
            name,
            _finite(value),
            len(rows.rows),
            interval=intervals.get(name),
            median=_finite(values.get(name + _MEDIAN)),
            chance=_finite(values.get(name + _CHANCE)),
            pool=_finite(values.get(name + _POOL)),
            undefined=rows.undefined if np.isfinite(value) else {**rows.undefined, _NOT_FINITE: ()},
            better=metric.better.get(name, "closer"),
        )
        for name, value in values.items()
        if not _is_beside(name)
    ]
    return scores, [*warnings, *_pool_warnings(metric, rows, pool, values)]


def halves_of(metric: Metric, pool: Float64Array, clips: Float64Array) -> dict[str, float]:
    """Return the distances between two halves of a pool, by the names of the scores for which lower is better.

    Clips are divided at random, all pieces of one into the same half; the median over 10 divisions (of a pool of more
    than MAX_VECTORS: one). Halves have fewer vectors than the pool, which makes the distance larger.

    `pool`: (M, C) numbers of the pool.
    `clips`: (M,) number of the clip of each row.
    """
    ids = np.unique(clips)
    if not metric.needs_pool or len(ids) < MIN_HALVES:
        return {}
    random = np.random.default_rng(0)
    found: dict[str, list[float]] = {}
    for _ in range(DIVISIONS if len(pool) <= MAX_VECTORS else 1):
        first = np.isin(clips, random.permutation(ids)[: len(ids) // 2])
        try:
            values = _summary(metric, pool[first], pool[~first])
        except Undefined:
            return {}
        for name in (name for name, better in metric.better.items() if better == "lower" and name in values):
            found.setdefault(name, []).append(values[name])
    return {name: float(np.median(values)) for name, values in found.items() if np.isfinite(values).all()}


def _summary(metric: Metric, rows: Float64Array, pool: Float64Array | None) -> dict[str, float]:
    """Return the scores of rows; numbers that overflow on the way are not warned of, but are not finite."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            return metric.summarise(rows, pool)
        except np.linalg.LinAlgError:  # of infinite numbers
            return {name: np.nan for name in metric.better if not name.endswith(_BESIDE)}


def _is_beside(name: str) -> bool:
    return name.endswith(_BESIDE) or name.startswith(_CONSTANT)


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def _intervals(
    metric: Metric, rows: MetricRows, pool: Float64Array | None, values: dict[str, float], draws: int
) -> tuple[dict[str, Interval], list[str]]:
    clips = np.unique(rows.clips)
    if not draws:
        return {}, []
    if len(clips) < MIN_CLIPS:
        return {}, [f"{counted(len(clips), 'clip')}: too few for intervals, which need {MIN_CLIPS}"]
    if metric.needs_pool and max(len(rows.rows), 0 if pool is None else len(pool)) > MAX_VECTORS:
        return {}, [f"{metric.name}: no intervals for sets of more than {MAX_VECTORS:,} vectors"]
    of_clip = {clip: np.flatnonzero(rows.clips == clip) for clip in clips}

    def scores(kept: Float64Array) -> dict[str, float]:
        return _summary(metric, rows.rows[np.concatenate([of_clip[clip] for clip in kept[:, 0]])], pool)

    try:
        with np.errstate(over="ignore", invalid="ignore"):
            intervals = jackknife(clips[:, None], scores, n=draws, bounds=metric.bounds)
    except Undefined:
        return {}, [f"{metric.name}: too few clips for intervals"]
    warnings = []
    for name in (name for name in values if not _is_beside(name)):
        interval = intervals.get(name)
        if interval is None and np.isfinite(values[name]):
            warnings.append(
                f"{name}: no interval: no clip changes the score, too few carry it, or it is at an end of its range"
            )
        elif interval is not None and interval.clips < min(len(clips), draws) / HEAVY:
            warnings.append(
                f"{name}: {interval.clips:.1f} of {min(len(clips), draws)} clips carry the score, so its interval is "
                "too short"
            )
    return intervals, warnings


def _pool_warnings(
    metric: Metric, rows: MetricRows, pool: Float64Array | None, values: dict[str, float]
) -> list[str]:
    if not metric.needs_pool or pool is None:
        return []
    warnings = []
    n, m, width = len(rows.rows), len(pool), pool.shape[1]
    if min(n, m) <= width:
        warnings.append(
            f"{metric.name}: {counted(n, 'vector')} and a pool of {m:,} for {width} dimensions: the covariance has "
            f"not full rank, and the distance depends on the number of clips"
        )
    constant = next((v for name, v in values.items() if name.startswith(_CONSTANT)), 0)
    if constant:
        varying = next((v for name, v in values.items() if name.endswith(_VARYING)), None)
        names = [name for name, column in zip(metric.columns, pool.T, strict=True) if np.ptp(column) == 0]
        fid = next((v for name, v in values.items() if name.startswith("fid")), None)
        effect = "have no effect on the distance"
        if varying is not None and fid is not None and abs(varying - fid) > 1e-9 * abs(fid):
            effect = f"are divided by about 0; without them the distance is {varying:.6g}"
        warnings.append(
            f"{metric.name}: {counted(int(constant), 'column')} of the pool ({listed(names)}), all clips of which "
            f"are equal there, {effect}"
        )
    return warnings


def describe_outcome(outcome: str) -> str:
    """Return an outcome in words."""
    of_sets = {"no_music": "there are no beats of music for the clip", _NOT_FINITE: "the numbers overflow"}
    return OUTCOMES.get(outcome) or of_sets.get(outcome, outcome)
