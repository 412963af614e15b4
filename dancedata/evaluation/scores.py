"""Scores of a set from the numbers of its clips, with undefined ones, intervals and warnings."""

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from dancedata.core.dance import OUTCOMES, Undefined
from dancedata.core.errors import DanceDataError
from dancedata.core.plugins import Metric
from dancedata.core.rotations import Float64Array
from dancedata.core.text import counted, listed
from dancedata.evaluation.pool import MetricRows
from dancedata.metrics.intervals import MIN_CLIPS, Interval, jackknife

#: How many times scores are computed again for intervals, at most.
DRAWS = 200
#: Sets and pools with more vectors have no intervals: each draw compares all pairs of vectors.
MAX_VECTORS = 4_000
_CHANCE, _MEDIAN, _POOL, _VARYING = "_chance", "_median", "_pool", "_varying"
#: Ends of the names of scores that are shown with others, or in warnings.
_BESIDE = (_CHANCE, _MEDIAN, _POOL, _VARYING)
_CONSTANT = "constant_columns"
_NOT_FINITE = "not_finite"


Verdict = Literal["ok", "weak", "void"]


class MeaninglessScore(DanceDataError):  # noqa: N818
    """Raised where a score that means nothing is taken for a number."""


@dataclass(frozen=True)
class Why:
    """A reason of a verdict, by the name of a rule; the verdict "ok" is a remark.

    `found`, `needed`: Numbers that were compared; None without any.
    """

    code: str
    verdict: Verdict
    text: str
    found: float | None = None
    needed: float | None = None


@dataclass(frozen=True)
class SameN:
    """Distances of as many real dances from the pool: least, median and greatest."""

    low: float
    median: float
    high: float


@dataclass(frozen=True)
class Score:
    """One line of a table.

    `value`: None where it is undefined, see `undefined`.
    `interval`: 95 percent, see `jackknife`; None where there is none.
    `median`, `chance`, `pool`: Where the metric has them: median over pieces, score of beats shifted at random, the
        pool's own diversity.
    `n`: Pieces that have a value.
    `undefined`: Ids of clips without a value, by outcome.
    `published`: The figure of the ground truth that was published under the protocol.
    `recordings`, `samples`: Independent clips, and samples, that have a value.
    `truth`, `truth_interval`: Value and interval of the real dances that samples are of.
    `same_n`: Of a distance, that of as many real dances.
    `why`: Reasons of the verdict, the gravest first.
    """

    name: str
    value: float | None
    n: int
    interval: Interval | None = None
    median: float | None = None
    chance: float | None = None
    pool: float | None = None
    undefined: dict[str, tuple[str, ...]] = field(default_factory=dict)
    published: float | None = None
    better: str = "closer"
    recordings: int = 0
    samples: int = 0
    truth: float | None = None
    truth_interval: Interval | None = None
    same_n: SameN | None = None
    why: tuple[Why, ...] = ()

    @property
    def n_undefined(self) -> int:
        """Clips without a value."""
        return len({clip for clips in self.undefined.values() for clip in clips})

    @property
    def verdict(self) -> Verdict:
        """Whether it means something: "ok"; "weak", of this set alone; "void", nothing."""
        return self.why[0].verdict if self.why else "ok"

    @property
    def reason(self) -> str:
        """The gravest reason of the verdict, or a remark; "" without any."""
        return self.why[0].text if self.why else ""

    def __float__(self) -> float:
        if self.verdict == "void" or self.value is None:
            raise MeaninglessScore(f"the score {self.name} means nothing", found=self.reason,
                                   fix=".value is the number all the same")  # fmt: skip
        return self.value

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        ends = None if self.interval is None or self.verdict != "ok" else [self.interval.low, self.interval.high]
        return {
            "value": self.value, "verdict": self.verdict, "interval_95": ends,
            "n": {"recordings": self.recordings, "samples": self.samples, "vectors": self.n},
            "why": [asdict(reason) for reason in self.why], "truth": self.truth,
            "same_n": None if self.same_n is None else asdict(self.same_n), "median": self.median,
            "chance": self.chance, "pool": self.pool,
            "undefined": {outcome: list(ids) for outcome, ids in self.undefined.items()},
            "published": self.published, "better": self.better,
        }  # fmt: skip


def number_text(value: float | None) -> str:
    """Return a number as tables show it."""
    if value is None:
        return "undefined"
    return f"{value:.4g}" if value and (abs(value) < 0.01 or abs(value) >= 1e5) else f"{value:.4f}"


def scores_of(
    metric: Metric, rows: MetricRows, pool: Float64Array | None, *, draws: int
) -> tuple[list[Score], list[str]]:
    """Return the scores of a metric, from the numbers (M, C) of the pool if it needs one, and warnings."""
    if metric.needs_pool and pool is None:
        return [], [f"{metric.name} is not computed: it compares with a pool, and none is given (--pool)"]
    try:
        values = summary_of(metric, rows.rows, pool)
    except Undefined as error:
        names = [name for name in metric.better if not name.endswith(_BESIDE)] or [metric.name]
        missing = rows.undefined if rows.undefined and not len(rows.rows) else {**rows.undefined, error.reason: ()}
        return [
            Score(name, None, len(rows.rows), undefined=missing, better=metric.better.get(name, "closer"))
            for name in names
        ], []
    warnings = _pool_warnings(metric, pool, values)
    intervals = _intervals(metric, rows, pool, draws)
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
    return scores, warnings


def summary_of(metric: Metric, rows: Float64Array, pool: Float64Array | None) -> dict[str, float]:
    """Return the scores of rows; an overflow on the way gives no warning, but a score that is not finite."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            return metric.summarise(rows, pool)
        except np.linalg.LinAlgError:  # of infinite numbers
            return {name: np.nan for name in metric.better if not name.endswith(_BESIDE)}


def _is_beside(name: str) -> bool:
    return name.endswith(_BESIDE) or name.startswith(_CONSTANT)


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def _intervals(metric: Metric, rows: MetricRows, pool: Float64Array | None, draws: int) -> dict[str, Interval]:
    clips = np.unique(rows.clips)
    n_vectors = max(len(rows.rows), 0 if pool is None else len(pool)) if metric.needs_pool else 0
    if not draws or len(clips) < MIN_CLIPS or n_vectors > MAX_VECTORS:
        return {}
    of_clip = {clip: np.flatnonzero(rows.clips == clip) for clip in clips}

    def scores(kept: Float64Array) -> dict[str, float]:
        return summary_of(metric, rows.rows[np.concatenate([of_clip[clip] for clip in kept[:, 0]])], pool)

    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return jackknife(clips[:, None], scores, n=draws, bounds=metric.bounds)
    except Undefined:
        return {}


def _pool_warnings(metric: Metric, pool: Float64Array | None, values: dict[str, float]) -> list[str]:
    if not metric.needs_pool or pool is None:
        return []
    warnings = []
    constant = next((v for name, v in values.items() if name.startswith(_CONSTANT)), 0)
    if constant:
        varying = next((v for name, v in values.items() if name.endswith(_VARYING)), None)
        names = [name for name, column in zip(metric.columns, pool.T, strict=True) if np.ptp(column) == 0]
        fid = next((v for name, v in values.items() if name.startswith("fid")), None)
        effect = "have no effect on the distance"
        if varying is not None and fid is not None and abs(varying - fid) > 1e-9 * abs(fid):
            effect = f"are divided by about 0; without them the distance is {varying:.6g}"
        warnings.append(
            f"{metric.name}: {counted(int(constant), 'column')} with one value in the whole pool ({listed(names)}) "
            f"{effect}"
        )
    return warnings


def describe_outcome(outcome: str) -> str:
    """Return an outcome in words."""
    of_sets = {"no_music": "there are no beats of music for the clip", _NOT_FINITE: "the numbers overflow"}
    return OUTCOMES.get(outcome) or of_sets.get(outcome, outcome)
