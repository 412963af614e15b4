"""The key `curate`: clips and windows with faults are left out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, NamedTuple

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.curation.scores import MEASURES, VERSION, Score, score_motion
from dancedata.curation.spans import Span
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
from dancedata.files.regular_file import sha256_file
from dancedata.pipeline.encode import EncodedClip
from dancedata.pipeline.facts import motions_of
from dancedata.pipeline.groups import groups_of
from dancedata.pipeline.motion_keys import MotionKeys
from dancedata.pipeline.rejects import BUILD_AGAIN, CHANGED
from dancedata.recipes.curation import CurateRule
from dancedata.recipes.recipe import Recipe

Scores = Mapping[str, Score]


class Fault(NamedTuple):
    """A span of a clip above the limit of a rule; `clip` is the dancer whose fault it is."""

    rule: CurateRule
    span: Span
    clip: str


@dataclass(frozen=True)
class Curated:
    """Clips that stay, the spans of each that windows must not touch, and rejects.

    `faults`: By clip, in frames of its source.
    """

    clips: tuple[EncodedClip, ...]
    faults: Mapping[str, tuple[Fault, ...]]
    rejects: tuple[Reject, ...]


def curate(
    cache: Cache,
    recipe: Recipe,
    clips: Sequence[EncodedClip],
    content: Mapping[str, str],
    *,
    jobs: Jobs,
    progress: Progress,
) -> Curated:
    """Leave out the clips that the recipe's rules name, and find the spans whose windows are left out.

    The spans of a dancer of a group are those of all its dancers, as they have the same windows.
    """
    rules = recipe.curation.rules
    if not rules:
        return Curated(tuple(clips), {}, ())
    scores = score_clips(cache, recipe, clips, content, jobs=jobs, progress=progress)
    kept, rejects = [], []
    for clip in clips:
        ref = clip.source.ref
        problems = [p for rule in rules if (p := _unfit(rule, ref, scores[ref.id], clip)) is not None]
        rejects += problems[:1]
        kept += [] if problems else [clip]
    faults = {clip.source.ref.id: _faults(rules, clip.source.ref, scores[clip.source.ref.id]) for clip in kept}
    for members in groups_of(kept, lambda clip: clip.source.ref).values():
        ids = [clip.source.ref.id for clip in members]
        of_all = tuple(fault for clip in ids for fault in faults[clip])
        faults |= dict.fromkeys(ids, of_all)
    return Curated(tuple(kept), faults, tuple(rejects))


def score_clips(
    cache: Cache,
    recipe: Recipe,
    clips: Sequence[EncodedClip],
    content: Mapping[str, str],
    *,
    jobs: Jobs,
    progress: Progress,
) -> dict[str, Scores]:
    """Return the scores of clips by id: of their motion as it is encoded, repaired and on the recipe's skeleton."""
    units: dict[str, list[EncodedClip]] = {}
    for clip in clips:
        units.setdefault(clip.source.ref.group or f"\0{clip.source.ref.id}", []).append(clip)
    members = [sorted(unit, key=lambda clip: clip.source.ref.member) for unit in units.values()]
    motion_keys, keys, calls = MotionKeys(recipe, content), [], []
    for unit in members:
        files = [(clip.source.ref, clip.source.motion_sha256) for clip in unit]
        group = files if unit[0].source.ref.group else []
        infos = [motion_keys.of(*file, group).info for file in files]
        keys.append(Cache.key("quality", version=VERSION, clips=infos))
        calls.append((cache, recipe.without_audio, files, keys[-1]))
    cached = [cache.json("quality", key) for key in keys]
    computed = run_units(find_scores, calls, cached=cached, jobs=jobs, label="scoring motion", progress=progress)
    return {
        clip.source.ref.id: {name: Score.from_json(score) for name, score in of_clip.items()}
        for unit, of_unit in zip(members, computed, strict=True)
        for clip, of_clip in zip(unit, of_unit, strict=True)
    }


def find_scores(cache: Cache, recipe: Recipe, unit: Sequence[tuple[ClipRef, str]], key: str) -> list[dict[str, Any]]:
    """Score a single dancer or a group, and publish the scores."""
    motions = motions_of(recipe, [ref for ref, _ in unit])
    for ref, sha256 in unit:
        if sha256_file(ref.motion_path) != sha256:
            raise DataError(CHANGED, reason="changed", where=ref.motion_path, fix=BUILD_AGAIN)
    rows = [{name: score.to_json() for name, score in score_motion(motion).items()} for motion in motions]
    cache.put_json("quality", key, rows)
    return rows


def _unfit(rule: CurateRule, ref: ClipRef, scores: Scores, clip: EncodedClip) -> Reject | None:
    """Return why a rule leaves out a whole clip."""
    score = scores[rule.score]
    if rule.leave_out != "clip" or not rule.applies_to(ref.split) or score.value is None or score.value <= rule.limit:
        return None
    worst = max(score.spans, key=lambda span: span.value, default=None)
    at = "" if worst is None else _place(worst, FrameGrid(clip.motion.source_rate))
    numbers: dict[str, float | int] = {rule.score: score.value, "limit": rule.limit}
    return Reject("curated", ref.id, str(ref.motion_path), detail=_above(rule, score.value) + at, numbers=numbers)


def _faults(rules: Sequence[CurateRule], ref: ClipRef, scores: Scores) -> tuple[Fault, ...]:
    of_windows = [rule for rule in rules if rule.leave_out == "windows" and rule.applies_to(ref.split)]
    return tuple(Fault(rule, span, ref.id) for rule in of_windows for span in scores[rule.score].above(rule.limit))


def without_faults(
    recipe: Recipe, ref: ClipRef, faults: Collection[Fault], starts: tuple[int, ...], rate: Fraction
) -> tuple[tuple[int, ...], list[Reject]]:
    """Split the window starts of a clip into those that touch no fault and a reject for each of the others.

    `rate` is that of the frames of faults. If no window is left, the last reject is that of the clip.
    """
    if not faults or not starts:
        return starts, []
    grid = FrameGrid(rate)
    kept, rejects = [], []
    for start in starts:
        touched = [fault for fault in faults if _touches(recipe, start, fault.span, rate)]
        if not touched:
            kept.append(start)
            continue
        worst = max(touched, key=lambda fault: fault.span.value / (abs(fault.rule.limit) or 1.0))
        partner = "" if worst.clip == ref.id else f" of partner {worst.clip}"
        numbers: dict[str, float | int] = {worst.rule.score: worst.span.value, "limit": worst.rule.limit}
        detail = _above(worst.rule, worst.span.value) + partner + _place(worst.span, grid)
        rejects.append(Reject("curated", ref.id, "", start, detail, numbers))
    if not kept:
        detail = f"each of the {len(starts)} windows of clip {ref.id} has a fault: {rejects[0].detail}"
        rejects.append(replace(rejects[0], file=str(ref.motion_path), window=None, detail=detail))
    return tuple(kept), rejects


def _touches(recipe: Recipe, start: int, span: Span, rate: Fraction) -> bool:
    """Whether a window covers the instant of a frame of a span, or has a row that is interpolated from one.

    Rows between two frames are made of both, at the rate of each field.
    """
    stop = recipe.grid.seconds(start + recipe.windows.length)
    last = stop - 1 / max([recipe.grid.rate, *(field.grid.rate for field in recipe.clip_fields)])
    return bool(recipe.grid.seconds(start) < span.end / rate and span.start / rate < max(stop, last + 1 / rate))


def _above(rule: CurateRule, value: float) -> str:
    measure = MEASURES[rule.score]
    unit = "" if measure.unit == "1" else f" {measure.unit}"
    return f"{rule.score} ({measure.what}): {value:.4g}{unit} is above the limit of {rule.limit:g}{unit}"


def _place(span: Span, grid: FrameGrid) -> str:
    joint = f"{span.joint}, " if span.joint else ""
    return f" ({joint}{float(grid.seconds(span.start)):.2f} s to {float(grid.seconds(span.end)):.2f} s)"
