"""Stage 2, identified clips -> encoded clips: the motion of all clips, in the columns of all fields."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dancedata.core.clip import Reject
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
from dancedata.pipeline.motion import MotionKeys, MotionResult, encode_motion, known_motion
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
    keys = [motion_keys.of(clip.ref, clip.motion_sha256) for clip in clips]
    cached = [known_motion(cache, recipe, clip_keys) for clip_keys in keys]
    read = recipe.without_audio
    calls = [(cache, read, c.ref, c.motion_sha256, k, copies) for c, k in zip(clips, keys, strict=True)]
    label = "encoding motion" if copies is None else f"encoding copies ({copies.name})"
    return run_units(encode_motion, calls, known=cached, jobs=jobs, label=label, progress=progress)
