"""Windows and clips with faults are left out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, ClassVar, Literal

from dancedata.core.clip import Reject
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.registry import RULES
from dancedata.core.segments import Segment
from dancedata.core.text import listed, shown
from dancedata.core.typing import override
from dancedata.curation.annotators import LAYER, Faults
from dancedata.curation.scores import MEASURES, VERSION, checked_limit
from dancedata.kernel import Annotator, Seen, WindowRule

_KEYS = ("limit", "leave_out", "splits")


@dataclass(frozen=True)
class Limit:
    """What is left out for one score: windows that touch a span above the limit, or clips; `splits` None for all."""

    limit: float
    leave_out: Literal["windows", "clip"]
    splits: tuple[str, ...] | None = None


@RULES.register("curate")
@dataclass(frozen=True)
class Curate(WindowRule):
    """Leaves out windows that touch a fault of the motion, or clips that have one.

    Each score is None, not judged; True, with the limit of `curation.scores.MEASURES`; a limit; or a mapping of
    `limit`, `leave_out` ("windows" that touch such a span, or the "clip") and `splits`, default all.

    Attributes
    ----------
    spikes
        Joints that leave their path, metres.
    frozen
        Poses that are held, seconds.
    jitter
        Movement above 10 Hz, metres.
    sliding
        Feet that slide, metres.
    penetration
        Joints below the floor, metres.
    floor_drift
        A floor that rises or sinks, metres; one value per clip.
    bone_spread
        Bones that change their length, metres; one value per clip.
    joint_limits
        Joints beyond their range, degrees.
    self_contact
        Limbs inside each other, metres.
    mirrored
        Left and right exchanged: minus a cosine; one value per clip.
    up
        Another axis up: a cosine; one value per clip.
    """

    version: ClassVar[int] = VERSION

    spikes: Any = None
    frozen: Any = None
    jitter: Any = None
    sliding: Any = None
    penetration: Any = None
    floor_drift: Any = None
    bone_spread: Any = None
    joint_limits: Any = None
    self_contact: Any = None
    mirrored: Any = None
    up: Any = None

    def __post_init__(self) -> None:
        for score in MEASURES:
            object.__setattr__(self, score, _limit(score, getattr(self, score)))

    @property
    def limits(self) -> dict[str, Limit]:
        """The scores that are judged, with their limits."""
        return {score: getattr(self, score) for score in MEASURES if getattr(self, score) is not None}

    @property
    def annotators(self) -> tuple[Annotator, ...]:  # type: ignore[override]
        """The scores."""
        return (Faults(),) if self.limits else ()

    @override
    def judge(self, seen: Seen, dancer: int, starts: Sequence[int]) -> list[Reject]:
        split = seen.result.take.split
        limits = {score: of for score, of in self.limits.items() if of.splits is None or split in of.splits}
        scored = [s for s in seen.segments[dancer] if s.layer == LAYER and s.label in limits]
        above = [s for s in scored if s.value > limits[s.label].limit]
        of_clip = [s for s in above if s.data["of"] == "clip" and limits[s.label].leave_out == "clip"]
        if of_clip:
            spans = [s for s in scored if s.data["of"] == "spans" and s.label == of_clip[0].label]
            reject = _reject(of_clip[0], limits, max(spans, key=lambda s: s.value, default=None))
            return [replace(reject, file=str(seen.result.take.dancers[dancer].ref.motion_path))]
        spans = [s for s in above if s.data["of"] == "spans" and limits[s.label].leave_out == "windows"]
        rejects = []
        for start in starts:
            touched = [s for s in spans if _touches(seen, start, s)]
            if touched:
                worst = max(touched, key=lambda s: s.value / (abs(limits[s.label].limit) or 1.0))
                rejects.append(replace(_reject(worst, limits, worst), window=start))
        return rejects

    @override
    def notes(self, splits: Collection[str]) -> list[str]:
        notes = []
        for score, of in self.limits.items():
            what = "clips" if of.leave_out == "clip" else "windows"
            where = "" if of.splits is None else f" of {', '.join(of.splits)}"
            unit = "" if MEASURES[score].unit == "1" else f" {MEASURES[score].unit}"
            notes.append(f"left out{where}: {what} with {score} above {of.limit:g}{unit}")
            absent = sorted(set(of.splits or ()) - set(splits))
            if absent:
                present = listed(sorted(splits))
                notes.append(f"rules.curate.{score}.splits: no clip is in {listed(absent)}, of {present}")
        return notes


def _limit(score: str, value: Any) -> Limit | None:
    if value is None or value is False or isinstance(value, Limit):
        return value or None
    measure = MEASURES[score]
    keys = value if isinstance(value, Mapping) else {"limit": value}
    for key in keys:
        if key not in _KEYS:
            raise UsageError(f"{score}.{shown(str(key))}: unknown key", fix=did_you_mean(str(key), _KEYS))
    low = -1 if measure.unit == "1" else measure.least
    limit = checked_limit(keys.get("limit", True), f"{score}.limit", measure.limit, low)
    allowed = ("windows", "clip") if measure.of == "spans" else ("clip",)
    leave_out = keys.get("leave_out", allowed[0])
    if limit is None or leave_out not in allowed:
        key, wrong = ("leave_out", leave_out) if limit is not None else ("limit", keys["limit"])
        raise UsageError(f"{score}.{key}: not possible for this score", found=shown(repr(wrong)),
                         allowed=" or ".join(allowed) if limit is not None else "a number")  # fmt: skip
    splits = keys.get("splits")
    splits = [splits] if isinstance(splits, str) else splits
    valid = isinstance(splits, list | tuple) and splits and all(isinstance(s, str) for s in splits)
    if splits is not None and not valid:
        raise UsageError(f"{score}.splits: must be a list of splits", found=shown(repr(splits)),
                         allowed="such as [train]")  # fmt: skip
    return Limit(limit, leave_out, None if splits is None else tuple(sorted(set(splits))))


def _reject(segment: Segment, limits: Mapping[str, Limit], place: Segment | None) -> Reject:
    score, limit, measure = segment.label, limits[segment.label].limit, MEASURES[segment.label]
    unit, at = "" if measure.unit == "1" else f" {measure.unit}", ""
    if place is not None:
        joint = f"{place.data['joint']}, " if place.data["joint"] else ""
        at = f" ({joint}{float(place.start):.2f} s to {float(place.end):.2f} s)"
    detail = f"{score} ({measure.what}): {segment.value:.4g}{unit} is above the limit of {limit:g}{unit}{at}"
    return Reject("curated", detail=detail, numbers={score: segment.value, "limit": limit})


def _touches(seen: Seen, start: int, segment: Segment) -> bool:
    """Return whether a window overlaps a segment, or has a row that is interpolated from a frame of it."""
    stop = seen.grid.seconds(start + seen.length)
    rates = [f.grid.rate for f in seen.fields if f.kind != "audio" and not f.from_files]
    last = stop - 1 / max([seen.grid.rate, *rates])
    period = segment.data.get("period", Fraction(0))
    return bool(seen.grid.seconds(start) < segment.end and segment.start < max(stop, last + period))
