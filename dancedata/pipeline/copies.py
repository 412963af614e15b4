"""Stage 6, clips to store -> their copies. Motion that an augmentation changes is encoded as that of clips is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import ClipRef, Reject
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
from dancedata.pipeline.motion import MotionKeys, encode_motion, known_motion
from dancedata.recipes.copies import CopySpec, is_copied
from dancedata.recipes.fields import KeyMotionField, MotionField
from dancedata.recipes.recipe import Recipe
from dancedata.store import StoredClip
from dancedata.store.stored_clip import LazyArray


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
            made += [_copied(clip.clip, spec, fields) for clip in clips]
            continue
        every = MotionKeys(recipe, content, spec)
        keys = [every.of(clip.ref, clip.motion_sha256) for clip in clips]
        read = recipe.without_audio
        calls = [(cache, read, c.ref, c.motion_sha256, own, spec) for c, own in zip(clips, keys, strict=True)]
        known = [known_motion(cache, recipe, own) for own in keys]
        label = f"encoding copies ({spec.name})"
        results = run_units(encode_motion, calls, known=known, jobs=jobs, label=label, progress=progress)
        for clip, result in zip(clips, results, strict=True):
            if isinstance(result, Reject):
                rejects.append(replace(result, clip=spec.clip_id(clip.ref.id)))
            else:
                arrays = result.stored(recipe, clip.clip.starts)
                made.append(_copied(replace(clip.clip, height_m=result.height_m), spec, fields, arrays))
    return made, rejects


def _copied(
    clip: StoredClip,
    spec: CopySpec,
    fields: Mapping[str, MotionField | KeyMotionField],
    arrays: Mapping[str, LazyArray] | None = None,
) -> StoredClip:
    """Return the copy of a clip under the id `<id>__<name>`; its `source` is the clip.

    Parameters
    ----------
    fields
        All motion and key motion fields.
    arrays
        Encoded rows of the copy's own motion; None: those of the clip.
    """
    motion = {name: _CopiedArray(a, fields[name], spec, clip.id) for name, a in (arrays or clip.motion).items()}
    return replace(clip, id=spec.clip_id(clip.id), source=clip.id, motion=motion)


@dataclass(frozen=True)
class _CopiedArray:
    """Rows (..., D) of a copy, made when numpy asks for them."""

    array: LazyArray
    field: MotionField | KeyMotionField
    spec: CopySpec
    clip: str

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return tuple(self.array.shape)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Load the clip's rows and change them."""
        rows = self.spec.rows_of(np.asarray(self.array), self.field.columns, self.field.kind, self.clip)
        return np.array(rows, dtype=dtype)
