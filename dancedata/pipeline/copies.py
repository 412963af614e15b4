"""Stage 6, clips to store -> their copies.

Motion that an augmentation changes is encoded as that of clips is. Copies at another speed also go through the stages
that cut windows and extract features.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Reject
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs
from dancedata.pipeline.encode import EncodedClip, encode_sources
from dancedata.pipeline.features import extract_features, stored_clip
from dancedata.pipeline.motion import MotionResult
from dancedata.pipeline.sources import SourceClip
from dancedata.pipeline.windows import cut_windows
from dancedata.recipes.copies import CopySpec, is_copied
from dancedata.recipes.fields import KeyMotionField, MotionField
from dancedata.recipes.recipe import Recipe
from dancedata.store import StoredClip
from dancedata.store.stored_clip import LazyArray


@dataclass(frozen=True)
class CopySource:
    """A clip to store, and its source."""

    clip: StoredClip
    source: SourceClip


@dataclass(frozen=True)
class _Context:
    """Arguments for the copies of one augmentation."""

    cache: Cache
    recipe: Recipe
    spec: CopySpec
    content: Mapping[str, str]
    jobs: Jobs
    progress: Progress


def make_copies(
    cache: Cache,
    recipe: Recipe,
    clips: Sequence[CopySource],
    content: Mapping[str, str],
    *,
    jobs: Jobs,
    progress: Progress,
) -> tuple[list[StoredClip], list[Reject]]:
    """Return the copies that the recipe's augmentations make, and a reject for each that fails.

    `content` is the SHA-256 of the files that the dataset's parameters name.
    """
    clips = [clip for clip in clips if is_copied(clip.clip.split)]
    fields = {field.name: field for field in recipe.clip_fields}
    stored: list[StoredClip] = []
    rejects: list[Reject] = []
    for spec in recipe.augment:
        context = _Context(cache, recipe, spec, content, jobs, progress)
        if spec.augmentation.changes == "rows":
            stored += [_copied(clip.clip, spec, fields) for clip in clips]
        elif spec.augmentation.changes == "motion":
            for clip, result in _encoded(context, clips, rejects):
                arrays = result.stored(recipe, clip.clip.starts)
                stored.append(_copied(replace(clip.clip, height_m=result.height_m), spec, fields, arrays))
        else:
            stored += [_copied(clip, spec, fields) for clip in _retimed(context, clips, rejects)]
    return stored, rejects


def _encoded(
    context: _Context, clips: Sequence[CopySource], rejects: list[Reject]
) -> Iterator[tuple[CopySource, MotionResult]]:
    """Yield clips with the motion of their copies; where it cannot be encoded, a reject is added."""
    c = context
    sources = [clip.source for clip in clips]
    results = encode_sources(c.cache, c.recipe, sources, c.content, c.spec, jobs=c.jobs, progress=c.progress)
    for clip, result in zip(clips, results, strict=True):
        if isinstance(result, Reject):
            rejects.append(replace(result, clip=c.spec.clip_id(clip.clip.id)))
        else:
            yield clip, result


def _retimed(context: _Context, clips: Sequence[CopySource], rejects: list[Reject]) -> list[StoredClip]:
    """Return clips at the speed of their copies, with new windows and music, under the clips' ids."""
    recipe, spec = context.recipe, context.spec
    of_copy = {spec.clip_id(clip.clip.id): clip.clip for clip in clips}
    encoded = [EncodedClip(_faster(spec, clip.source), motion) for clip, motion in _encoded(context, clips, rejects)]
    windowed, without_windows = cut_windows(recipe, encoded)
    extracted, without_features = extract_features(
        context.cache, recipe, windowed, jobs=context.jobs, progress=context.progress
    )
    rejects += [*without_windows, *without_features]
    stored = []
    for clip in sorted(extracted, key=lambda clip: clip.source.ref.id):
        original = of_copy[clip.source.ref.id]
        # Flags and rate are of the source, whose frames the copy has.
        about = {name: getattr(original, name) for name in ("id", "n_flags", "source_rate")}
        stored.append(replace(stored_clip(recipe, clip), **about))
    return stored


def _faster(spec: CopySpec, clip: SourceClip) -> SourceClip:
    """Return the source of a copy: its id, and music and tempo at the copy's speed."""
    ref, speed = clip.ref, spec.speed_of(clip.ref.id)
    bpm = None if ref.tempo_bpm is None else float(Fraction(ref.tempo_bpm) * speed)
    renamed = replace(ref, id=spec.clip_id(ref.id), music=spec.music_of(ref.music, ref.id), tempo_bpm=bpm)
    return replace(clip, ref=renamed, signal=None if clip.signal is None else clip.signal.at_speed(speed))


def _copied(
    clip: StoredClip,
    spec: CopySpec,
    fields: Mapping[str, MotionField | KeyMotionField],
    arrays: Mapping[str, LazyArray] | None = None,
) -> StoredClip:
    """Return the copy of a clip under the id `<id>__<name>`; its `source` is the clip.

    `arrays` are the encoded rows of the copy's motion; None: those of the clip.
    """
    motion = {name: _CopiedArray(a, fields[name], spec, clip.id) for name, a in (arrays or clip.motion).items()}
    return replace(clip, id=spec.clip_id(clip.id), source=clip.id, motion=motion)


@dataclass(frozen=True)
class _CopiedArray:
    """Rows (..., D) of a copy, computed when numpy needs them."""

    array: LazyArray
    field: MotionField | KeyMotionField
    spec: CopySpec
    clip: str

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return tuple(self.array.shape)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        rows = self.spec.rows_of(np.asarray(self.array), self.field.columns, self.field.kind, self.clip)
        return np.array(rows, dtype=dtype)
