"""Segments of takes: those that annotators find, or for copies their parents' changed; then words, over all clips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from dancedata.building.plugins import Annotator
from dancedata.building.result import Result
from dancedata.core.clip import Reject
from dancedata.core.grid import FrameGrid
from dancedata.core.segments import Layer, Segment
from dancedata.core.text import counted, quoted

if TYPE_CHECKING:
    from dancedata.core.sided_words import Lexicon

#: Layer of quality flags, which are of the source and its frames.
_QUALITY = "quality"


def annotated(results: Sequence[Result], annotators: Sequence[Annotator], grid: FrameGrid) -> list[Result]:
    """Return results with the segments of each dancer that stays, by annotator."""
    done: dict[tuple[str, str], Result] = {}
    for of_copies in (False, True):  # those of copies follow from completed ones
        of_round = [r for r in results if (r.take.parent is not None) is of_copies]
        for annotator in annotators:
            segments = [
                _of_copy(r, k, annotator, done[r.take.origin.id].segments[annotator.name][k], grid)
                if of_copies
                else _own(r, k, annotator, grid)
                for r in of_round
                for k in r.stay
            ]
            words = iter(_with_words(segments, annotator.lexicons))
            of_round = [_with(r, annotator, {k: next(words) for k in r.stay}) for r in of_round]
        done |= {r.take.id: r for r in of_round}
    return list(done.values())


def _with_words(
    of_dancers: Sequence[Sequence[Segment]], lexicons: Sequence[Lexicon]
) -> Sequence[tuple[Segment, ...]]:
    """Return the segments of dancers with mirrored words, see `with_mirrored_words`."""
    if not any(of_dancers):
        return [()] * len(of_dancers)
    from dancedata.core.sided_words import with_mirrored_words  # many sources state no segments

    return with_mirrored_words(of_dancers, lexicons)


def all_segments(
    result: Result, annotators: Sequence[Annotator], parent: Result | None, grid: FrameGrid
) -> list[list[Segment]]:
    """Return the segments of each dancer of a take, of all annotators, before words are completed."""
    return [
        [
            segment
            for annotator in annotators
            for segment in (
                _own(result, k, annotator, grid)
                if parent is None
                else _of_copy(result, k, annotator, _own(parent, k, annotator, grid), grid)
            )
        ]
        for k in range(len(result.take.dancers))
    ]


def unmirrored(results: Sequence[Result], annotators: Sequence[Annotator]) -> list[Reject]:
    """Return a reject for each layer of which copies of a kind go without segments."""
    by_name = {r.take.id: r for r in results}
    by_step: dict[str, list[Result]] = {}
    for result in (r for r in results if r.take.parent is not None):
        by_step.setdefault(result.take.steps[-1].sha256, []).append(result)
    rejects = []
    for copies in by_step.values():
        of_parents = [
            (result.take, k, segment, annotator.lexicons)
            for result in copies
            for annotator in annotators
            if annotator.stored and annotator.copies != "none"
            for k in result.stay
            for segment in by_name[result.take.origin.id].segments[annotator.name][k]
        ]
        lost = [
            (take.dancers[k].id, s, words)
            for take, k, s, words in of_parents
            if s.layer.name != _QUALITY and take.steps[-1].segment(s, take) is None
        ]
        for layer, lexicons in sorted({s.layer: words for _, s, words in lost}.items(), key=repr):
            said = [s for _, _, s, _ in of_parents if s.layer == layer]
            rejects.append(_unmirrored(layer, [clip for clip, s, _ in lost if s.layer == layer], said, lexicons))
    return rejects


def _unmirrored(layer: Layer, clips: Sequence[str], said: Sequence[Segment], lexicons: Sequence[Lexicon]) -> Reject:
    """Return the reject of a layer of which segments of these clips have no mirrored words."""
    from dancedata.core.sided_words import lexicon_of, unread_word

    lost = f"{counted(len(clips), 'segment')} of {counted(len(set(clips)), 'clip')}"
    language = f"language {layer.language}" if layer.language else "without a language"
    detail = f"mirrored copies go without {lost}: layer {layer.name}, {language}, has no mirrored words for them"
    fix = "state the language of the layer, its texts_mirrored, or sided: no; or give a lexicon, annotators.captions"
    lexicon = lexicon_of(layer.language, lexicons)
    if lexicon is not None and (word := unread_word(layer, said, lexicon)):
        detail += f"; whether {quoted(word)} names a side cannot be told"
        fix = "write sides as words of their own (left_kick, LeftKick), or state texts_mirrored or label_mirrored"
    return Reject("unmirrored_words", clip=min(clips), detail=detail, fix=fix)


def _own(result: Result, k: int, annotator: Annotator, grid: FrameGrid) -> list[Segment]:
    """Return the segments that an annotator finds of a dancer; of a slice those of the whole, moved."""
    take = result.take
    seconds = grid.seconds(take.time.whole.frames_on(grid))
    segments = [s.within(seconds) for s in annotator.segments(result.made[annotator.id][k], take, k)]
    for step in (step for step in take.steps if step.is_part):
        segments = [moved for s in segments if (moved := step.segment(s, take)) is not None]
    return segments


def _of_copy(
    result: Result, k: int, annotator: Annotator, of_parent: Sequence[Segment], grid: FrameGrid
) -> list[Segment]:
    """Return the segments of a dancer of a copy: those of its own motion, or its parent's, changed."""
    step = result.take.steps[-1]
    if annotator.copies == "own" and step.moves:
        return _own(result, k, annotator, grid)
    if annotator.copies == "none":
        return []
    of_source = (s for s in of_parent if s.layer.name != _QUALITY)
    return [changed for s in of_source if (changed := step.segment(s, result.take)) is not None]


def _with(result: Result, annotator: Annotator, by_dancer: Mapping[int, tuple[Segment, ...]]) -> Result:
    of_all = [by_dancer.get(k, ()) for k in range(len(result.take.dancers))]
    return replace(result, segments={**result.segments, annotator.name: of_all})
