"""The stages in their order."""

import os
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

from dancedata.building.recipe import parts_of
from dancedata.building.source import takes_of
from dancedata.building.spine import Groups, build_clips
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.segments import CLIP_END, Segment
from dancedata.core.sided_words import with_mirrored_words
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs
from dancedata.pipeline.copies import CopySource, make_copies
from dancedata.pipeline.curation import curate
from dancedata.pipeline.encode import encode_clips
from dancedata.pipeline.facts import compute_facts
from dancedata.pipeline.features import extract_features, stored_clip
from dancedata.pipeline.groups import members_of, require_places, sizes_of, whole_groups
from dancedata.pipeline.rejects import without_fields
from dancedata.pipeline.sources import Sources
from dancedata.pipeline.windows import cut_windows
from dancedata.recipes.copies import check_ids
from dancedata.recipes.recipe import Recipe
from dancedata.recipes.segments import GENRE
from dancedata.store import StoredClip

#: Set, builds of scope track go through `building`: both exist until one does all.
BUILDING = "DANCEDATA_BUILDING"


@dataclass(frozen=True)
class ComputedClips:
    """The content of a dataset.

    `clips`: Sorted by id; copies, such as mirrored ones, after all others.
    `rejects`: Everything that was left out.
    `quality`: Rows of quality.jsonl.
    """

    clips: tuple[StoredClip, ...]
    rejects: tuple[Reject, ...]
    quality: tuple[dict[str, Any], ...]


def compute_clips(cache: Cache, recipe: Recipe, sources: Sources, *, jobs: Jobs, progress: Progress) -> ComputedClips:
    """Encode all motion, cut windows, extract all features."""
    if recipe.scope == "window" or os.environ.get(BUILDING):
        return _built(cache, recipe, sources, jobs=jobs, progress=progress)
    check_ids([(clip.ref.id, clip.ref.split) for clip in sources.clips], recipe.augment)
    encoded, unreadable = encode_clips(cache, recipe, sources, jobs=jobs, progress=progress)
    curated = curate(cache, recipe, encoded, sources.content, jobs=jobs, progress=progress)
    windowed, without_windows = cut_windows(recipe, curated.clips, curated.faults)
    extracted, without_features = extract_features(cache, recipe, windowed, jobs=jobs, progress=progress)
    extracted, incomplete = whole_groups(recipe, extracted, sources.scan.clips, lambda clip: clip.source.ref)
    sizes = sizes_of(sources.scan.clips)
    extracted = sorted(extracted, key=lambda clip: clip.source.ref.id)
    facts = compute_facts(
        cache, recipe, [clip.source for clip in extracted], sources.content, jobs=jobs, progress=progress
    )
    segments_of = [
        [
            *(s.within(recipe.grid.seconds(clip.motion.n_frames)) for s in _stated(recipe, clip.source.ref)),
            *facts.get(clip.source.ref.id, ()),
        ]
        for clip in extracted
    ]
    clips = [
        replace(
            stored_clip(recipe, clip),
            segments=segments,
            group_size=sizes.get(clip.source.ref.group, 0),
        )
        for clip, segments in zip(extracted, with_mirrored_words(segments_of, recipe.segments.lexicons), strict=True)
    ]
    originals = [CopySource(c, e.source) for c, e in zip(clips, extracted, strict=True)]
    copies, not_copied = make_copies(
        cache, recipe, originals, sources.content, curated.faults, jobs=jobs, progress=progress
    )
    return ComputedClips(
        clips=(*clips, *copies),
        rejects=(
            *sources.rejects,
            *unreadable,
            *curated.rejects,
            *without_windows,
            *without_features,
            *incomplete,
            *(r for c in extracted for r in without_fields(c.source.ref, c.motion.without)),
            *not_copied,
        ),
        quality=tuple({"clip": c.source.ref.id, **flag} for c in extracted for flag in c.flags),
    )


def _built(cache: Cache, recipe: Recipe, sources: Sources, *, jobs: Jobs, progress: Progress) -> ComputedClips:
    """Compute the clips with `building`."""
    scanned = sources.scan.clips
    members, sizes = members_of(scanned), sizes_of(scanned)
    if sizes:
        require_places(recipe)
    unlisted = {group: sizes[group] - len(ids) for group, ids in members.items()}
    named = {
        group: [*ids, *([f"{unlisted[group]} that the source lacks"] if unlisted[group] else [])]
        for group, ids in members.items()
    }
    groups = Groups(named, sizes, recipe.incomplete_groups == "keep")
    takes, unusable = takes_of(cache, recipe.dataset, sources, jobs=jobs, progress=progress)
    clips, rejects, quality = build_clips(cache, takes, parts_of(recipe), groups, jobs=jobs, progress=progress)
    return ComputedClips(tuple(clips), (*sources.rejects, *unusable, *rejects), tuple(quality))


def _stated(recipe: Recipe, ref: ClipRef) -> list[Segment]:
    """Return the segments that a source states, and its genre if the recipe asks for it."""
    genre = [Segment(GENRE, Fraction(0), CLIP_END, ref.genre)] if recipe.segments.genre and ref.genre else []
    return [*recipe.dataset.segments(ref), *genre]
