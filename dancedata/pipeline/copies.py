"""Stage 5, clips to store -> their copies.

Motion that an augmentation changes is encoded as that of clips is. Copies at another speed also go through the stages
that cut windows and extract features.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Reject
from dancedata.core.segments import Segment
from dancedata.core.sided_words import Lexicon, lexicon_of, mirrored_segment, unread_word, with_mirrored_words
from dancedata.core.text import counted, quoted
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs
from dancedata.pipeline.curation import Fault
from dancedata.pipeline.encode import EncodedClip, encode_sources
from dancedata.pipeline.facts import compute_facts
from dancedata.pipeline.features import extract_features, stored_clip
from dancedata.pipeline.groups import require_acts_on
from dancedata.pipeline.motion import MotionResult
from dancedata.pipeline.rejects import without_fields
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
    faults: Mapping[str, Collection[Fault]]
    jobs: Jobs
    progress: Progress


def make_copies(
    cache: Cache,
    recipe: Recipe,
    originals: Sequence[CopySource],
    content: Mapping[str, str],
    faults: Mapping[str, Collection[Fault]] = MappingProxyType({}),
    *,
    jobs: Jobs,
    progress: Progress,
) -> tuple[list[StoredClip], list[Reject]]:
    """Return the copies that the recipe's augmentations make, and a reject for each that fails.

    `content` is the SHA-256 of the files that the dataset's parameters name. `faults` are those of clips, for which
    windows of copies at another speed are left out as well.
    """
    originals = [original for original in originals if is_copied(original.clip.split)]
    fields = {field.name: field for field in recipe.clip_fields}
    joints = recipe.skeleton.other_side
    stored: list[StoredClip] = []
    rejects: list[Reject] = []
    for spec in recipe.augment:
        context = _Context(cache, recipe, spec, content, faults, jobs, progress)
        rejects += _without_words(spec, [original.clip for original in originals], recipe.segments.lexicons)
        if any(original.clip.group for original in originals):
            require_acts_on(spec)
        with_facts = _with_facts(context, originals)
        if spec.augmentation.changes == "rows":
            stored += [_copied(original.clip, spec, fields, joints) for original in originals]
        elif spec.augmentation.changes == "motion":
            for original, result in _encoded(context, with_facts, rejects):
                arrays = result.stored(recipe, original.clip.starts)
                clip = replace(original.clip, height_m=result.height_m)
                stored.append(_copied(clip, spec, fields, joints, arrays))
        else:
            stored += [_copied(clip, spec, fields, joints) for clip in _retimed(context, with_facts, rejects)]
    return stored, rejects


def _with_facts(context: _Context, originals: Sequence[CopySource]) -> list[CopySource]:
    """Return clips with the computed events of their copies' own motion, as if they were the clips'.

    Rows that an augmentation changes are mirrored ones, whose events are those of the clip, mirrored.
    """
    c = context
    if c.recipe.segments.facts is None or c.spec.augmentation.changes == "rows":
        return list(originals)
    sources = [original.source for original in originals]
    facts = compute_facts(c.cache, c.recipe, sources, c.content, c.spec, jobs=c.jobs, progress=c.progress)
    words = with_mirrored_words([facts[source.ref.id] for source in sources], c.recipe.segments.lexicons)
    changed = []
    for original, of_copy in zip(originals, words, strict=True):
        clip = original.clip
        # In the time of the clip, as the other segments, which are then divided by the speed.
        speed = c.spec.speed_of(clip.group or clip.id)
        retimed = [replace(s, start=s.start * speed, end=s.end * speed) for s in of_copy]
        segments = (*(s for s in clip.segments if s.layer.name != "facts"), *retimed)
        changed.append(replace(original, clip=replace(clip, segments=segments)))
    return changed


def _encoded(
    context: _Context, originals: Sequence[CopySource], rejects: list[Reject]
) -> Iterator[tuple[CopySource, MotionResult]]:
    """Yield clips with the motion of their copies; where it cannot be encoded, a reject is added."""
    c = context
    sources = [original.source for original in originals]
    results = encode_sources(c.cache, c.recipe, sources, c.content, c.spec, jobs=c.jobs, progress=c.progress)
    for original, result in zip(originals, results, strict=True):
        if isinstance(result, Reject):
            rejects.append(replace(result, clip=c.spec.clip_id(original.clip.id)))
        else:
            # What the clip lacks, its copy lacks for the same reason.
            more = {name: why for name, why in result.without.items() if original.clip.motion[name].shape[0]}
            rejects += without_fields(replace(original.source.ref, id=c.spec.clip_id(original.clip.id)), more)
            yield original, result


def _retimed(context: _Context, originals: Sequence[CopySource], rejects: list[Reject]) -> list[StoredClip]:
    """Return clips at the speed of their copies, with new windows and music, under the clips' ids."""
    recipe, spec = context.recipe, context.spec
    of_copy = {spec.clip_id(original.clip.id): original.clip for original in originals}
    encoded = [
        EncodedClip(_faster(spec, original.source), motion)
        for original, motion in _encoded(context, originals, rejects)
    ]
    faults = {
        spec.clip_id(clip): [fault._replace(clip=spec.clip_id(fault.clip)) for fault in of_clip]
        for clip, of_clip in context.faults.items()
    }
    windowed, without_windows = cut_windows(recipe, encoded, faults)
    extracted, without_features = extract_features(
        context.cache, recipe, windowed, jobs=context.jobs, progress=context.progress
    )
    rejects += [*without_windows, *without_features]
    stored = []
    for clip in sorted(extracted, key=lambda clip: clip.source.ref.id):
        original_clip = of_copy[clip.source.ref.id]
        # Flags and rate are of the source, whose frames the copy has.
        names = ("id", "n_flags", "source_rate", "segments", "group_size")
        about = {name: getattr(original_clip, name) for name in names}
        # The song is that of the original: stretched music is not a decoded file.
        stored.append(replace(stored_clip(recipe, clip), song="", signal=None, **about))
    return stored


def _faster(spec: CopySpec, clip: SourceClip) -> SourceClip:
    """Return the source of a copy: its id, and music and tempo at the copy's speed."""
    ref, speed = clip.ref, spec.speed_of(clip.ref.group or clip.ref.id)
    bpm = None if ref.tempo_bpm is None else float(Fraction(ref.tempo_bpm) * speed)
    music = spec.music_of(ref.music, ref.group or ref.id)
    renamed = replace(ref, id=spec.clip_id(ref.id), music=music, tempo_bpm=bpm, audio_start=ref.audio_start / speed)
    return replace(clip, ref=renamed, signal=None if clip.signal is None else clip.signal.at_speed(speed))


def _copied(
    clip: StoredClip,
    spec: CopySpec,
    fields: Mapping[str, MotionField | KeyMotionField],
    joints: Mapping[int, int],
    arrays: Mapping[str, LazyArray] | None = None,
) -> StoredClip:
    """Return the copy of a clip under the id `<id>__<name>`; its `source` is the clip.

    `joints` are the left and right ones. `arrays` are the encoded rows of the copy's motion; None: the clip's.
    """
    # What changes a world draws by the group.
    drawn_by = clip.group if clip.group and spec.augmentation.acts_on == "world" else clip.id
    motion = {name: _CopiedArray(a, fields[name], spec, drawn_by) for name, a in (arrays or clip.motion).items()}
    group = spec.clip_id(clip.group) if clip.group else ""
    segments = segments_of_copy(clip.id, clip.group, clip.segments, spec, joints)
    return replace(
        clip, id=spec.clip_id(clip.id), group=group, source=clip.id, motion=motion, segments=segments, made_of=""
    )


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
        if not self.array.shape[0]:
            return np.asarray(self.array, dtype=dtype)  # without an optional field
        rows = self.spec.rows_of(np.asarray(self.array), self.field.columns, self.field.kind, self.clip)
        return np.array(rows, dtype=dtype)


def segments_of_copy(
    clip: str, group: str, stated: Sequence[Segment], spec: CopySpec, joints: Mapping[int, int]
) -> tuple[Segment, ...]:
    """Return the segments of a clip's copy: at its speed, and in the words of a mirrored dancer.

    Words that may name a side, and have no mirrored ones, are left out of mirrored copies. Quality flags are those of
    the source.
    """
    segments = [segment for segment in stated if segment.layer.name != "quality"]
    if spec.augmentation.changes == "time":
        speed = spec.speed_of(group or clip)
        segments = [replace(segment, start=segment.start / speed, end=segment.end / speed) for segment in segments]
    if spec.augmentation.name == "mirror":
        segments = [mirrored_segment(segment, joints) for segment in segments if segment.can_be_mirrored]
    return tuple(replace(segment, other=spec.clip_id(segment.other) if segment.other else "") for segment in segments)


def _without_words(spec: CopySpec, clips: Sequence[StoredClip], lexicons: Sequence[Lexicon]) -> list[Reject]:
    """Return a reject for each layer with segments that mirrored copies cannot have."""
    if spec.augmentation.name != "mirror":
        return []
    lost = [(s.layer, c.id) for c in clips for s in c.segments if not s.can_be_mirrored]
    rejects = []
    for layer in sorted({layer for layer, _ in lost}, key=repr):
        of_layer = [clip for other, clip in lost if other == layer]
        found = f"{counted(len(of_layer), 'segment')} of {counted(len(set(of_layer)), 'clip')}"
        language = f"language {layer.language}" if layer.language else "without a language"
        detail = f"mirrored copies go without {found}: layer {layer.name}, {language}, has no mirrored words for them"
        fix = "state the language of the layer, its texts_mirrored, or sided: no; or give a lexicon: segments.lexicon"
        lexicon = lexicon_of(layer.language, lexicons)
        segments = (s for c in clips for s in c.segments if s.layer == layer)
        if lexicon is not None and (word := unread_word(layer, segments, lexicon)):
            detail += f"; whether {quoted(word)} names a side cannot be told"
            fix = "write sides as words of their own (left_kick, LeftKick), or state texts_mirrored or label_mirrored"
        rejects.append(Reject("unmirrored_words", clip=spec.clip_id(of_layer[0]), detail=detail, fix=fix))
    return rejects
