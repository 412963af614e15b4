"""Segments in a store: rows of the table /segments from `Segment`s, and back."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

from dancedata.core.clip import Window
from dancedata.core.errors import DataError, StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import canonical_json
from dancedata.core.segments import TICKS_PER_SECOND, Layer, Segment, ticks
from dancedata.core.text import shown
from dancedata.store.dataset_json import json_object
from dancedata.store.table_file import SegmentTable

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


def _exact_s(seconds: float) -> Fraction:
    """Return the tick that a stored time is the nearest float64 of: exact within 73 days."""
    return Fraction(round(seconds * TICKS_PER_SECOND), TICKS_PER_SECOND)


class PlacedSegment(NamedTuple):
    """A segment that a window overlaps: frames [start, end) of the window, and the share of it that they are."""

    segment: Segment
    start: int
    end: int
    share: float


class PlacedRow(NamedTuple):
    """A segment that a window overlaps, as `PlacedSegment`, which `load` reads: a text needs one of many."""

    start: int
    end: int
    share: float
    whole: bool
    n_texts: int
    load: Callable[[], Segment]

    @classmethod
    def of_segment(cls, segment: Segment, begin: int, end: int, window: Window) -> PlacedRow:
        """Place frames [begin, end) of a clip in a window."""
        return cls._placed(begin, end, window, segment.whole, len(segment.texts), lambda: segment)

    @classmethod
    def of_table(
        cls, table: SegmentTable, k: int, layers: Sequence[Layer], ids: Sequence[str], window: Window
    ) -> PlacedRow:
        """Place row k of a table in a window."""
        columns, texts = table.columns, table.columns["texts"].offset
        begin, end = int(columns["start"][k]), int(columns["end"][k])
        n_texts, whole = int(texts[k + 1]) - int(texts[k]), bool(columns["whole"][k])
        return cls._placed(begin, end, window, whole, n_texts, lambda: segments_of(table, [k], layers, ids)[0])

    @classmethod
    def _placed(
        cls, begin: int, end: int, window: Window, whole: bool, n_texts: int, load: Callable[[], Segment]
    ) -> PlacedRow:
        begin, end = max(begin - window.start, 0), min(end - window.start, window.length)
        return cls(begin, end, (end - begin) / window.length, whole, n_texts, load)

    def loaded(self) -> PlacedSegment:
        """Read the segment."""
        return PlacedSegment(self.load(), self.start, self.end, self.share)


def segments_of(
    table: SegmentTable, rows: Iterable[int], layers: Sequence[Layer], ids: Sequence[str]
) -> list[Segment]:
    """Return the segments of rows of the table."""
    columns = table.columns
    segments = []
    for k in rows:
        start, end = (_exact_s(float(columns[name][k])) for name in ("start_s", "end_s"))
        other, data = int(columns["other"][k]), columns["data"][k]
        texts, mirrored, tokens = (columns[name][k] for name in ("texts", "texts_mirrored", "tokens"))
        layer = layers[int(columns["layer"][k])]
        if layer.sided == "mirrored":
            mirrored = mirrored or texts
        value = float(columns["value"][k])
        try:
            segment = Segment(
                layer, start, end, columns["label"][k], texts, mirrored, tokens,
                value=math.nan if math.isnan(value) else value, other=ids[other] if other >= 0 else "",
                joint=int(columns["joint"][k]), whole=bool(columns["whole"][k]),
                data=json_object(data) if data else {},
            )  # fmt: skip
        except (DataError, ValueError) as error:
            raise StoreError(
                "a segment of the dataset cannot be read", where=f"/segments, row {k}", found=shown(error)
            ) from error
        segments.append(segment)
    return segments


def quality_segments(
    flags: Sequence[Mapping[str, Any]], clips: Mapping[str, int], grid: FrameGrid
) -> dict[str, list[Segment]]:
    """Return quality flags as segments, by clip; `clips` are the numbers of frames."""
    segments: dict[str, list[Segment]] = {}
    for flag in flags:
        clip = flag["clip"]
        if clip not in clips:
            raise StoreError(
                "a quality flag of a clip that is not stored", where=f"clip {clip}", found=flag.get("kind")
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
