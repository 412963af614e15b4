"""Verdicts: whether a score means something, and if not, why."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from dancedata.core.dance import Undefined
from dancedata.core.errors import StoreError
from dancedata.core.hashing import sha256_bytes
from dancedata.core.plugins import Metric
from dancedata.core.rotations import Float64Array
from dancedata.core.text import counted
from dancedata.evaluation.measuring import STAGE, MeasuredClip, metric_key
from dancedata.evaluation.pool import MetricRows, Pool, rows_of
from dancedata.evaluation.protocol import Protocol
from dancedata.evaluation.scores import (
    MAX_VECTORS,
    SameN,
    Score,
    Why,
    describe_outcome,
    number_text,
    scores_of,
    summary_of,
)
from dancedata.kernel import Cache
from dancedata.metrics.intervals import MIN_CLIPS

#: Fewest recordings that a distance or diversity needs: AIST++'s test split, the smallest that tables are made of.
LEAST_OF_SETS = 20
#: A score that depends on fewer than 1 / HEAVY of the clips is not a mean of all.
HEAVY = 3
#: An interval whose ends differ by more than this factor says nothing.
WIDE = 10
#: Shares of pieces without a value that make a score weak, and void.
SOME, MOST = 0.1, 0.5
#: Draws of real dances, and fewest recordings of a pool that is divided.
DRAWS, LEAST_OF_POOL = 20, 4


@dataclass(frozen=True, eq=False)
class Circumstances:
    """What a verdict depends on besides the score."""

    metric: Metric
    # `rows`, `pool`: numbers of the set, and (M, C) of the pool; None without one
    rows: MetricRows
    pool: Float64Array | None
    generated: bool
    truth: Mapping[str, Score]  # scores of the real dances, by name
    same_n: Mapping[str, SameN]  # distances of as many real dances, by the name of the score
    in_pool: int  # how many clips of the set are in the pool
    pool_of_all: bool  # whether the protocol wants them there
    doubt: str  # why the scaling of columns is doubtful; "" where it is not
    draws: int  # how many times scores were computed again for intervals, at most


def judged_scores(
    protocol: Protocol,
    measured: Sequence[MeasuredClip],
    truth: Sequence[MeasuredClip],
    pool: Pool | None,
    *,
    generated: bool,
    draws: int,
    numbers: Sequence[int] | None = None,
    in_pool: int = 0,
    dataset: str = "",
    cache: Cache | None = None,
) -> tuple[tuple[Score, ...], list[str]]:
    """Return the scores of clips with their verdicts, and warnings; for the arguments see `report.report_of`."""
    figures = [p.values for p in protocol.published if p.what == "ground truth" and p.dataset in ("", dataset)]
    published = {name: value for values in figures for name, value in values.items()}
    doubt = next((m.doubt for m in measured if m.doubt), "")
    scores: list[Score] = []
    warnings: list[str] = []
    for number in range(len(protocol.measures)) if numbers is None else numbers:
        metric = protocol.measures[number].metric
        rows, of_truth = (rows_of(clips, number, metric) for clips in (measured, truth))
        of_pool = None if pool is None else pool.rows.get(number)
        of_metric, messages = scores_of(metric, rows, of_pool, draws=draws)
        real: list[Score] = []
        if truth:
            alone = 0 if metric.needs_pool else draws  # of real dances, a distance is shown without an interval
            real, _ = scores_of(metric, of_truth, of_pool, draws=alone)
        same_n = {}
        if pool is not None and metric.needs_pool and number in pool.rows:
            same_n = same_n_of(pool, number, metric, len(np.unique(rows.clips)), len(rows.rows), cache)
        circumstances = Circumstances(
            metric=metric, rows=rows, pool=of_pool, generated=generated, truth={score.name: score for score in real},
            same_n=same_n, in_pool=in_pool, pool_of_all=protocol.pool_split == "all", doubt=doubt, draws=draws,
        )  # fmt: skip
        scores += [judged(replace(s, published=published.get(s.name)), circumstances) for s in of_metric]
        warnings += messages
    return tuple(scores), list(dict.fromkeys(warnings))


def judged(score: Score, of: Circumstances) -> Score:
    """Return a score with its reasons, the gravest first, and the real dances beside it."""
    recordings = len(np.unique(of.rows.clips))
    truth, same = of.truth.get(score.name), of.same_n.get(score.name)
    score = replace(
        score, recordings=recordings, samples=len({name.partition("#")[0] for name in of.rows.ids}),
        truth=None if truth is None else truth.value, truth_interval=None if truth is None else truth.interval,
        same_n=same if of.generated else None,
    )  # fmt: skip
    why = [*_beside_real(score, of), *_of_set(score, of), *_of_interval(score, of)]
    return replace(score, why=tuple(sorted(why, key=lambda one: ("void", "weak", "ok").index(one.verdict))))


def _of_set(score: Score, of: Circumstances) -> list[Why]:
    """Return the reasons that lie in the clips, their number and their columns."""
    why = [Why("scaler", "void", of.doubt)] if of.doubt else []
    n, needed = score.recordings, LEAST_OF_SETS if of.metric.needs_pool else MIN_CLIPS
    if n < needed and score.value is not None:
        why.append(Why("few_clips", "void", f"{counted(n, 'clip')}; needs {needed}", n, needed))
    total = score.n + score.n_undefined
    share = 1.0 if score.value is None else score.n_undefined / max(total, 1)
    if share > SOME:
        outcome = max(score.undefined, key=lambda name: len(score.undefined[name]), default="short")
        text = f"{score.n_undefined} of {total} have no value: {describe_outcome(outcome)}"
        why.append(Why("undefined", "void" if share >= MOST else "weak", text, score.n_undefined, total))
    is_distance = of.metric.needs_pool and score.better == "lower"
    if is_distance and of.in_pool:
        text = f"{counted(of.in_pool, 'clip')} of the pool are these dances"
        why.append(Why("in_pool", "weak" if of.pool_of_all else "void", text, of.in_pool, 0))
    if is_distance and of.pool is not None:
        vectors, width = min(score.n, len(of.pool)), of.pool.shape[1]
        if vectors <= width:
            whose = "vectors" if vectors == score.n else "vectors of the pool"
            text = f"{vectors} {whose}, {width} dimensions: compare only at n = {vectors}"
            why.append(Why("rank", "weak", text, vectors, width + 1))
    return why


def _of_interval(score: Score, of: Circumstances) -> list[Why]:
    """Return the reasons that lie in the interval, and in the chance level."""
    value, interval, n, why = score.value, score.interval, score.recordings, []
    if value is None:
        return []
    if score.chance is not None and score.chance >= (value if interval is None else interval.low):
        is_below = interval is None or score.chance > interval.high
        text = f"below chance, {score.chance:.2f}" if is_below else f"as good as chance ({score.chance:.2f})"
        why.append(Why("chance", "void", text, value, score.chance))
    if not of.draws or n < MIN_CLIPS:
        return why
    if interval is None:
        most = of.metric.needs_pool and max(score.n, 0 if of.pool is None else len(of.pool)) > MAX_VECTORS
        text = "no clip changes it, or too few carry it" if not most else f"more than {MAX_VECTORS:,} vectors"
        return [*why, Why("no_interval", "ok" if most else "weak", f"no interval: {text}")]
    if interval.clips < min(n, of.draws) / HEAVY:
        median = "" if score.median is None else f"; the median is {number_text(score.median)}"
        text = f"{interval.clips:.0f} of {n} clips carry the mean{median}"
        why.append(Why("few_carry", "weak", text, interval.clips, n / HEAVY))
    if of.metric.bounds[0] == 0 and interval.high > WIDE * interval.low:
        ends = f"{interval.low:.3g} .. {interval.high:.3g}"
        why.append(Why("no_interval", "weak", f"interval {ends}: too few clips", interval.high, interval.low))
    return why


def _beside_real(score: Score, of: Circumstances) -> list[Why]:
    """Return what real dances say about the score of generated ones."""
    value, same, truth, why = score.value, score.same_n, score.truth_interval, []
    if value is None or not of.generated:
        return []
    if same is not None and value <= same.high:
        if value < same.low:
            text = "better than real dances at this n: look for copies of train"
            return [Why("below_truth", "weak", text, value, same.low)]
        text = f"as real dances at this n: {same.low:.3g} .. {same.high:.3g}"
        why.append(Why("same_n", "weak", text, value, same.high))
    is_lower = score.better == "lower" and truth is not None and value < truth.low
    is_nearer = score.chance is not None and truth is not None and value > truth.high
    if of.metric.needs_pool:
        is_lower, is_nearer = score.better == "lower" and score.truth is not None and value < score.truth, False
    if is_lower or is_nearer:
        text = "better than the real dances: look for copies of train, still dancers, too few samples"
        why.append(Why("below_truth", "ok", text, value, score.truth))
    return why


def same_n_of(
    pool: Pool, number: int, metric: Metric, recordings: int, vectors: int, cache: Cache | None = None
) -> dict[str, SameN]:
    """Return the distances of as many real dances from the others of a pool, by the names of the scores.

    From 20 draws of `recordings` recordings, at most half of the pool's, with `vectors` vectors. A cache keeps them.
    """
    if not recordings or not any(better == "lower" for better in metric.better.values()):
        return {}
    rows, clips = pool.rows[number], pool.clips[number]
    content = sha256_bytes(rows.tobytes() + clips.tobytes())
    limits = [DRAWS, LEAST_OF_POOL, MAX_VECTORS]
    key = metric_key(metric, same_n=limits, pool=content, recordings=recordings, vectors=vectors)
    stored = None if cache is None else cache.json(STAGE, key)
    if stored is None:
        stored = _same_n(rows, clips, metric, recordings, vectors)
        if cache is not None:
            with suppress(StoreError):  # they are drawn again where the cache cannot be written
                cache.put_json(STAGE, key, stored)
    return {name: SameN(*ends) for name, ends in stored.items()}


def _same_n(
    rows: Float64Array, clips: Float64Array, metric: Metric, recordings: int, vectors: int
) -> dict[str, list[float]]:
    """Return least, median and greatest distance, by the name of the score."""
    ids = np.unique(clips)
    if len(ids) < LEAST_OF_POOL:
        return {}
    random = np.random.default_rng(0)
    distances: dict[str, list[float]] = {}
    for _ in range(DRAWS if len(rows) <= MAX_VECTORS else 3):
        drawn = np.isin(clips, random.permutation(ids)[: min(recordings, len(ids) // 2)])
        chosen = np.sort(random.permutation(np.flatnonzero(drawn))[:vectors])
        try:
            values = summary_of(metric, rows[chosen], rows[~drawn])
        except Undefined:
            return {}
        for name in (name for name, better in metric.better.items() if better == "lower" and name in values):
            distances.setdefault(name, []).append(values[name])
    finite = {name: values for name, values in distances.items() if np.isfinite(values).all()}
    return {name: [min(of), float(np.median(of)), max(of)] for name, of in finite.items()}
