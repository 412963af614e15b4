"""Rows of the table /segments from `Segment`s."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

from dancedata.core.errors import StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import canonical_json
from dancedata.core.segments import TICKS_PER_SECOND, Layer, Segment, ticks

#: Layers of the quality flags: of places, and of whole clips.
QUALITY = "quality"
_FLAGS = Layer(QUALITY, kind="instant", by="quality_flags", sided="no")
_CLIP_FLAGS = Layer(QUALITY, kind="span", by="quality_flags", sided="no")


class SegmentRow(NamedTuple):
    """A row of the table: one value for each of SEGMENT_COLUMNS, in this order."""

    clip: int
    whole: bool
    start: int
    end: int
    start_s: float
    end_s: float
    layer: int
    label: str
    texts: tuple[str, ...]
    texts_mirrored: tuple[str, ...]
    tokens: tuple[str, ...]
    value: float
    other: int
    joint: int
    data: str


class SegmentedClip(NamedTuple):
    """A clip with its segments."""

    id: str
    n_frames: int
    segments: Sequence[Segment]


def segment_rows(
    clips: Sequence[SegmentedClip], first: int, numbers: Mapping[Layer, int], grid: FrameGrid
) -> tuple[list[SegmentRow], Counter[int]]:
    """Return the sorted rows of a split's clips, from row `first` on, and how many cover no frame, by layer."""
    row_of = {clip.id: row for row, clip in enumerate(clips, start=first)}
    rows, empty = [], Counter[int]()
    for number, clip in enumerate(clips, start=first):
        for segment in clip.segments:
            begin, end = segment.frames(grid, clip.n_frames)
            if begin == end:
                empty[numbers[segment.layer]] += 1
                continue
            if segment.other and segment.other not in row_of:
                raise StoreError("a segment names a partner that the split does not have",
                                 where=f"clip {clip.id}, segment {segment.label!r}", found=segment.other)  # fmt: skip
            rows.append(
                SegmentRow(
                    number, segment.whole, begin, end, _stored_s(segment.start), _stored_s(segment.end),
                    numbers[segment.layer], segment.label, segment.texts,
                    segment.texts_mirrored if segment.texts_mirrored != segment.texts else (),
                    segment.tokens, float(segment.value),
                    row_of[segment.other] if segment.other else -1, segment.joint,
                    canonical_json(segment.data) if segment.data else "",
                )
            )  # fmt: skip
    return sorted(rows, key=lambda r: (r.clip, r.start, r.end, r.layer, r.label, r.texts, r.start_s, r.data)), empty


def _stored_s(seconds: Fraction) -> float:
    return ticks(seconds) / TICKS_PER_SECOND


def quality_segments(
    flags: Sequence[Mapping[str, Any]], clips: Mapping[str, int], grid: FrameGrid
) -> dict[str, list[Segment]]:
    """Return quality flags as segments, by clip; `clips` has the number of frames of each."""
    segments: dict[str, list[Segment]] = {}
    for flag in flags:
        clip = flag["clip"]
        if clip not in clips:
            raise StoreError(
                "a quality flag names a clip that is not stored", where=f"clip {clip}", found=flag.get("kind")
            )
        data = {key: value for key, value in flag.items() if key not in ("clip", "kind", "value")}
        if "frame" in flag:
            layer, start = _FLAGS, Fraction(flag["frame"]) / Fraction(str(flag.get("rate", grid.rate)))
            start = end = min(start, grid.seconds(clips[clip] - 1))
        else:
            layer, start, end = _CLIP_FLAGS, Fraction(0), grid.seconds(clips[clip])
        value = float(flag["value"]) if "value" in flag else math.nan
        segment = Segment(layer, start, end, str(flag.get("kind", "")), value=value, data=data)
        segments.setdefault(clip, []).append(segment)
    return segments
