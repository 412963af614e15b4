"""Stage 6, clips to store -> their copies. Motion that an augmentation changes is encoded as that of clips is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dancedata.augment.copies import copied, is_copied
from dancedata.core.clip import ClipRef, Reject
from dancedata.execution.cache import Cache
from dancedata.execution.execute import Progress, run_units
from dancedata.execution.workers import Jobs
from dancedata.pipeline.motion import MotionKeys, encode_motion, known_motion
from dancedata.recipes.recipe import Recipe
from dancedata.store import StoredClip


@dataclass(frozen=True)
class CopySource:
    """A clip to store, and the motion file that it was read from, by its SHA-256."""

    clip: StoredClip
    ref: ClipRef
    motion_sha256: str


def make_copies(
    cache: Cache,
    recipe: Recipe,
    clips: Sequence[CopySource],
    content: Mapping[str, str],
    *,
    jobs: Jobs,
    progress: Progress,
) -> tuple[list[StoredClip], list[Reject]]:
    """Return the copies that the recipe asks for, and a reject for each whose motion cannot be encoded.

    Parameters
    ----------
    content
        SHA-256 of the files that the dataset's parameters name.
    """
    clips = [clip for clip in clips if is_copied(clip.clip.split)]
    fields = {field.name: field for field in recipe.clip_fields}
    made: list[StoredClip] = []
    rejects: list[Reject] = []
    for spec in recipe.augment:
        if not spec.augmentation.changes_motion:
            made += [copied(clip.clip, spec, fields) for clip in clips]
            continue
        keys = [MotionKeys(recipe, content, spec).of(clip.ref, clip.motion_sha256) for clip in clips]
        calls = [(cache, recipe, c.ref, c.motion_sha256, own, spec) for c, own in zip(clips, keys, strict=True)]
        known = [known_motion(cache, recipe, own) for own in keys]
        label = f"encoding copies ({spec.name})"
        results = run_units(encode_motion, calls, known=known, jobs=jobs, label=label, progress=progress)
        for clip, result in zip(clips, results, strict=True):
            if isinstance(result, Reject):
                rejects.append(replace(result, clip=spec.clip_id(clip.ref.id)))
            else:
                arrays = result.arrays
                if recipe.scope == "window":
                    numbers = recipe.windows.numbers(clip.clip.starts)
                    arrays = {name: array.take(numbers) for name, array in arrays.items()}
                made.append(copied(replace(clip.clip, height_m=result.height_m), spec, fields, arrays))
    return made, rejects
