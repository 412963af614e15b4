"""The stages in their order, and stage 5, extracted clips -> clips to store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dancedata.augment.mirror import SUFFIX, mirrored_copy
from dancedata.core.clip import Reject
from dancedata.core.errors import SourceError
from dancedata.execution.cache import Cache
from dancedata.execution.execute import Progress
from dancedata.execution.workers import Jobs
from dancedata.pipeline.encode import encode_clips
from dancedata.pipeline.features import ExtractedClip, extract_features
from dancedata.pipeline.sources import Sources
from dancedata.pipeline.windows import cut_windows
from dancedata.recipes.recipe import Recipe
from dancedata.store import StoredClip


@dataclass(frozen=True)
class ComputedClips:
    """What a build stores.

    Attributes
    ----------
    clips
        Sorted by id; copies, such as mirrored ones, after all others.
    rejects
        All that was left out.
    quality
        Rows of quality.jsonl.
    """

    clips: tuple[StoredClip, ...]
    rejects: tuple[Reject, ...]
    quality: tuple[dict[str, Any], ...]


def compute_clips(cache: Cache, recipe: Recipe, sources: Sources, *, jobs: Jobs, progress: Progress) -> ComputedClips:
    """Encode all motion, cut windows, extract all features."""
    _check_mirrored_ids(recipe, sources)
    encoded, unreadable = encode_clips(cache, recipe, sources, jobs=jobs, progress=progress)
    windowed, without_windows = cut_windows(recipe, encoded)
    extracted, without_features = extract_features(cache, recipe, windowed, jobs=jobs, progress=progress)
    extracted = sorted(extracted, key=lambda clip: clip.source.ref.id)
    clips = [_stored(recipe, clip) for clip in extracted]
    return ComputedClips(
        clips=(*clips, *_mirrored(recipe, clips)),
        rejects=(*sources.rejects, *unreadable, *without_windows, *without_features),
        quality=tuple({"clip": c.source.ref.id, **flag} for c in extracted for flag in c.motion.flags),
    )


def _mirrored(recipe: Recipe, clips: Sequence[StoredClip]) -> list[StoredClip]:
    """Return mirrored copies of the train clips, if the recipe asks for them."""
    if not recipe.mirror:
        return []
    mirrors = {own.name: own.columns.mirror for own in recipe.clip_fields if own.columns.mirror is not None}
    return [mirrored_copy(clip, mirrors) for clip in clips if clip.split == "train"]


def _check_mirrored_ids(recipe: Recipe, sources: Sources) -> None:
    ids = {clip.ref.id for clip in sources.clips}
    both = [clip for clip in ids if recipe.mirror and clip + SUFFIX in ids]
    if both:
        raise SourceError(
            "a clip has the id that its neighbour's mirrored copy would get",
            where=f"clip {min(both)}{SUFFIX}",
            fix="rename it, or build without augment.mirror",
        )


def _stored(recipe: Recipe, clip: ExtractedClip) -> StoredClip:
    ref, motion, arrays = clip.source.ref, clip.motion, clip.motion.arrays
    if recipe.scope == "window":
        numbers = recipe.windows.numbers(clip.starts)
        arrays = {name: array.take(numbers) for name, array in arrays.items()}
    return StoredClip(
        id=ref.id,
        split=ref.split,
        genre=ref.genre,
        music=ref.music,
        dancer=ref.dancer,
        tempo_bpm=ref.tempo_bpm,
        n_flags=len(motion.flags),
        trim_start=motion.trim_start,
        height_m=motion.height_m,
        source_rate=str(motion.source_rate),
        lists=ref.lists,
        n_frames=motion.n_frames,
        starts=clip.starts,
        motion=arrays,
        audio=dict(clip.audio),
    )
