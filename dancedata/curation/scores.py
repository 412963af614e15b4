"""Scores of faults: what each measures, its limit, and the scores of a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dancedata.core.bodies import has_body
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.sides import MIN_ELBOWS, sides_of, wrong_up
from dancedata.core.text import shown
from dancedata.curation import anatomy, glitches
from dancedata.curation.spans import Span, worst_spans
from dancedata.metrics.body import bone_spread

#: Raised by hand when a score gives other numbers for the same motion.
VERSION = 2
#: Largest limit that a recipe may have.
_MOST = 1e6


@dataclass(frozen=True)
class Measure:
    """What a score measures; larger is worse.

    `limit`: Value above which it is a fault, by default; chosen on real clips, see docs/archive/measured.md.
    `least`: Smallest value of a span that is listed.
    `of`: "spans": a clip's value is that of its worst span. "clip": it belongs to the whole clip.
    """

    what: str
    unit: str
    limit: float
    least: float
    of: Literal["spans", "clip"]
    source: str


#: By name, in the order of tables.
MEASURES: Mapping[str, Measure] = {
    "spikes": Measure(
        "joints that leave their path for a few frames", "m", 0.075, 0.03, "spans",
        "a cubic through neighbouring frames; limits by local medians, Hampel 1974",
    ),
    "frozen": Measure("a pose held while the dancer moves", "s", 0.1, 0.08, "spans", "repeated frames"),
    "jitter": Measure(
        "movement above 10 Hz", "m", 0.006, 0.003, "spans",
        "Winter 2009, Biomechanics and Motor Control of Human Movement: movement lies below 6 to 10 Hz",
    ),
    "sliding": Measure(
        "feet that slide on the floor", "m", 0.4, 0.05, "spans",
        "Li et al. 2024, Lodge: the speed of 0.3 m/s; Tseng et al. 2023, EDGE, 5.2: the slower of ankle and toe",
    ),
    "penetration": Measure("joints below the floor", "m", 0.1, 0.03, "spans", "Yuan et al. 2023, PhysDiff"),
    "floor_drift": Measure("a floor that rises or sinks", "m", 0.05, 0.0, "clip", "Theil-Sen slope, Sen 1968"),
    "bone_spread": Measure("bones that change their length", "m", 0.01, 0.0, "clip", "1 % to 99 % quantile"),
    "joint_limits": Measure(
        "joints beyond their range of motion", "deg", 20.0, 5.0, "spans",
        "American Academy of Orthopaedic Surgeons 1965; Soucie et al. 2011, Haemophilia 17:500",
    ),
    "self_contact": Measure(
        "limbs inside each other", "m", 0.07, 0.02, "spans", "Ericson 2005, Real-Time Collision Detection, 5.1.9",
    ),
    "mirrored": Measure(
        "left and right of the body, its legs or arms exchanged", "1", 0.0, 0.0, "clip", "core.sides: minus a cosine"
    ),
    "up": Measure("a body that stands along another axis than +Y", "1", 0.5, 0.0, "clip", "core.sides: a cosine"),
}  # fmt: skip


@dataclass(frozen=True)
class Score:
    """A score of a motion, and its spans in frames, in order.

    `value`: Of the whole clip, the worst span's; None where the motion has none, such as joint limits of a rig that
        is not SMPL's, or jitter at 24 frames per second.
    """

    value: float | None
    spans: tuple[Span, ...] = ()

    def above(self, limit: float) -> tuple[Span, ...]:
        """Return the spans above a limit."""
        return tuple(span for span in self.spans if span.value > limit)


def score_motion(motion: Motion, names: Iterable[str] = MEASURES) -> dict[str, Score]:
    """Return the scores of a motion, by default all of `MEASURES`; values are rounded to a millionth."""
    cached = motion if motion.is_cached else motion.with_cache(matrices=False)
    return {name: _rounded(_SCORES[name](cached, MEASURES[name].least)) for name in names}


def checked_limit(value: object, where: str, default: float, low: float) -> float | None:
    """Return a limit of a recipe; None for false or None, the default for true."""
    if value is None or isinstance(value, bool):
        return default if value else None
    if not (isinstance(value, int | float) and low <= value <= _MOST):
        raise UsageError(f"{where}: must be true, false or a number", found=shown(repr(value)),
                         allowed=f"{low:g} to {_MOST:,.0f}")  # fmt: skip
    return float(value)


def _rounded(score: Score) -> Score:
    value = None if score.value is None or not np.isfinite(score.value) else round(float(score.value), 6)
    return Score(value, tuple(span._replace(value=round(span.value, 6)) for span in score.spans))


def _worst(spans: tuple[Span, ...]) -> Score:
    return Score(max((span.value for span in spans), default=0.0), spans)


def _frozen(motion: Motion, least: float) -> Score:
    seconds = float(motion.grid.rate)
    return _worst(tuple(Span(start, stop, (stop - start) / seconds) for start, stop in glitches.frozen(motion)))


def _jitter(motion: Motion, least: float) -> Score:
    size = glitches.jitter(motion)
    if size is None:
        return Score(None)
    return Score(float(size.max()), worst_spans(size[:, None], least, ("",)))


def _of_floor(spans_of: Callable[..., tuple[Span, ...]]) -> Callable[[Motion, float], Score]:
    def score(motion: Motion, least: float) -> Score:
        return _worst(spans_of(motion.joints(), float(motion.grid.rate), motion.skeleton, least))

    return score


def _floor_drift(motion: Motion, least: float) -> Score:
    trend = anatomy.floor_trend(motion)
    return Score(None if trend is None else abs(trend[1]))


def _bone_spread(motion: Motion, least: float) -> Score:
    return Score(max(motion.stretch_m, bone_spread(motion.joints(), motion.skeleton)))


def _of_body(score: Callable[[Motion, float], Score]) -> Callable[[Motion, float], Score]:
    return lambda motion, least: score(motion, least) if has_body(motion.skeleton) else Score(None)


def _mirrored(motion: Motion, least: float) -> Score:
    sides = sides_of(motion.joints(), motion)
    # Elbows are less certain: dancers who are made up bend them a little backwards.
    evidence = [sides.legs, sides.chest, sides.elbows - MIN_ELBOWS]
    return Score(-float(np.fmin.reduce(evidence)))


def _up(motion: Motion, least: float) -> Score:
    wrong = wrong_up(motion.joints())
    return Score(0.0 if wrong is None else float(np.abs(wrong[0]).max()))


_SCORES: Mapping[str, Callable[[Motion, float], Score]] = {
    "spikes": lambda motion, least: _worst(glitches.spike_spans(motion, least)),
    "frozen": _frozen,
    "jitter": _jitter,
    "sliding": _of_floor(anatomy.sliding),
    "penetration": _of_floor(anatomy.penetration),
    "floor_drift": _floor_drift,
    "bone_spread": _bone_spread,
    "joint_limits": _of_body(lambda motion, least: _worst(anatomy.joint_limits(motion, least))),
    "self_contact": _of_body(lambda motion, least: _worst(anatomy.self_contact(motion.joints(), least))),
    "mirrored": _of_body(_mirrored),
    "up": _of_body(_up),
}
