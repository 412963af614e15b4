"""The layer `facts`: computed events of clips, as a stage of a build."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError
from dancedata.core.motion import Motion
from dancedata.core.segments import Layer, Segment
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
from dancedata.files.regular_file import sha256_file
from dancedata.metrics.events import Event, events
from dancedata.pipeline.groups import group_motions
from dancedata.pipeline.motion import prepared
from dancedata.pipeline.motion_keys import MotionKeys
from dancedata.pipeline.rejects import BUILD_AGAIN, CHANGED
from dancedata.pipeline.sources import SourceClip
from dancedata.recipes.copies import CopySpec
from dancedata.recipes.recipe import Recipe
from dancedata.recipes.segments import VERSION, FactsSpec

#: A row of the cache: label, frames, number, text, member and joint, data, and the rate of the frames.
Row = list[Any]


def compute_facts(
    cache: Cache,
    recipe: Recipe,
    clips: Sequence[SourceClip],
    content: Mapping[str, str],
    copies: CopySpec | None = None,
    *,
    jobs: Jobs,
    progress: Progress,
) -> dict[str, list[Segment]]:
    """Return the computed events of clips, or of their copies, by the clips' ids; none if a recipe wants none."""
    spec = recipe.segments.facts
    if spec is None:
        return {}
    units: dict[str, list[SourceClip]] = {}
    for clip in clips:
        units.setdefault(clip.ref.group or f"\0{clip.ref.id}", []).append(clip)
    members = [sorted(unit, key=lambda clip: clip.ref.member) for unit in units.values()]
    motion_keys = MotionKeys(recipe, content, copies)
    keys = []
    for unit in members:
        group = [(c.ref, c.motion_sha256) for c in unit] if unit[0].ref.group else []
        infos = [motion_keys.of(c.ref, c.motion_sha256, group).info for c in unit]
        keys.append(Cache.key("facts", version=VERSION, clips=infos, facts=spec.document()))
    calls = [
        (cache, recipe.without_audio, [(c.ref, c.motion_sha256) for c in unit], key, copies)
        for unit, key in zip(members, keys, strict=True)
    ]
    cached = [cache.json("facts", key) for key in keys]
    label = "finding facts" if copies is None else f"finding facts ({copies.name})"
    computed = run_units(find_facts, calls, cached=cached, jobs=jobs, label=label, progress=progress)
    facts: dict[str, list[Segment]] = {}
    for unit, of_members in zip(members, computed, strict=True):
        ids = [clip.ref.id for clip in unit]
        for name, rows in zip(ids, of_members, strict=True):
            facts[name] = [_segment(row, spec.layer, ids) for row in rows]
    return facts


def find_facts(
    cache: Cache, recipe: Recipe, unit: Sequence[tuple[ClipRef, str]], key: str, copies: CopySpec | None
) -> list[list[Row]]:
    """Compute the events of a single dancer or a group, or of their copies, and publish them."""
    spec, refs = recipe.segments.facts or FactsSpec(), [ref for ref, _ in unit]
    motions = motions_of(recipe, refs, copies)
    for ref, sha256 in unit:
        if sha256_file(ref.motion_path) != sha256:
            raise DataError(CHANGED, reason="changed", where=ref.motion_path, fix=BUILD_AGAIN)
    grid = motions[0].grid
    joints = [motion.joints() for motion in motions]
    of_dancers = events(joints, float(grid.rate), motions[0].skeleton, spec.kinds, spec.document())
    rows = [[_row(event, str(grid.rate)) for event in of_dancer] for of_dancer in of_dancers]
    cache.put_json("facts", key, rows)
    return rows


def motions_of(recipe: Recipe, refs: Sequence[ClipRef], copies: CopySpec | None = None) -> list[Motion]:
    """Return the motion of a single dancer or of those of a group, as it is encoded."""
    if refs[0].group:
        return group_motions(recipe, refs, copies)
    return [prepared(recipe, refs[0], recipe.dataset.load(refs[0]), copies)[0]]


def _row(event: Event, rate: str) -> Row:
    numbers = [event.label, event.start, event.end, event.value, event.text, event.other, event.joint]
    return [*numbers, dict(event.data), rate]


def _segment(row: Row, layer: Layer, ids: Sequence[str]) -> Segment:
    label, start, end, value, text, other, joint, data, rate = row
    first, last = (Fraction(frame) / Fraction(rate) for frame in (start, end))
    partner = ids[other] if other >= 0 else ""
    return Segment(layer, first, last, label, (text,), value=value, other=partner, joint=joint, data=data)
