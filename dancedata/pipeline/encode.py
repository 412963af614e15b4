"""Stage 2, identified clips -> encoded clips: the motion of all clips, in the columns of all fields."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dancedata.core.clip import Reject
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
from dancedata.pipeline.groups import groups_of, require_places
from dancedata.pipeline.motion import MotionResult, cached_group, cached_motion, encode_group, encode_motion
from dancedata.pipeline.motion_keys import MotionKeys
from dancedata.pipeline.sources import SourceClip, Sources
from dancedata.recipes.copies import CopySpec
from dancedata.recipes.recipe import Recipe


@dataclass(frozen=True)
class EncodedClip:
    """A clip with its encoded motion."""

    source: SourceClip
    motion: MotionResult


def encode_clips(
    cache: Cache, recipe: Recipe, sources: Sources, *, jobs: Jobs, progress: Progress
) -> tuple[list[EncodedClip], list[Reject]]:
    """Encode the motion of all clips; those whose music cannot be used are left out afterwards, without a reject."""
    results = encode_sources(cache, recipe, sources.clips, sources.content, jobs=jobs, progress=progress)
    clips, rejects = [], []
    for clip, result in zip(sources.clips, results, strict=True):
        if isinstance(result, Reject):
            rejects.append(replace(result, clip=clip.ref.id))
        elif clip.music_problem is None:
            clips.append(EncodedClip(clip, result))
    return clips, rejects


def encode_sources(
    cache: Cache,
    recipe: Recipe,
    clips: Sequence[SourceClip],
    content: Mapping[str, str],
    copies: CopySpec | None = None,
    *,
    jobs: Jobs,
    progress: Progress,
) -> list[MotionResult | Reject]:
    """Return the encoded motion of each clip, or of its copy; or a reject."""
    motion_keys = MotionKeys(recipe, content, copies)
    singles = [clip for clip in clips if not clip.ref.group]
    keys = [motion_keys.of(clip.ref, clip.motion_sha256) for clip in singles]
    cached = [cached_motion(cache, recipe, clip_keys) for clip_keys in keys]
    motion_recipe = recipe.without_audio
    calls = [(cache, motion_recipe, c.ref, c.motion_sha256, k, copies) for c, k in zip(singles, keys, strict=True)]
    label = "encoding motion" if copies is None else f"encoding copies ({copies.name})"
    results: dict[str, MotionResult | Reject] = {}
    if singles or not clips:
        encoded = run_units(encode_motion, calls, cached=cached, jobs=jobs, label=label, progress=progress)
        results |= zip((clip.ref.id for clip in singles), encoded, strict=True)
    groups = groups_of(clips, lambda clip: clip.ref)
    if groups:
        require_places(recipe)
        units = [[(c.ref, c.motion_sha256) for c in members] for members in groups.values()]
        of_unit = [[(r, sha, motion_keys.of(r, sha, unit)) for r, sha in unit] for unit in units]
        of_groups = [cached_group(cache, recipe, [k for _, _, k in unit]) for unit in of_unit]
        tasks = [(cache, motion_recipe, unit, copies) for unit in of_unit]
        label = f"{label} of groups"
        encoded_groups = run_units(encode_group, tasks, cached=of_groups, jobs=jobs, label=label, progress=progress)
        for unit, of_members in zip(units, encoded_groups, strict=True):
            results |= zip((ref.id for ref, _ in unit), of_members, strict=True)
    return [results[clip.ref.id] for clip in clips]
