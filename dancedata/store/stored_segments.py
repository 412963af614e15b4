"""The segments of an open store: its table /segments, and files that are laid over it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.errors import DataError, StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.segments import MAX_JOINT, TICKS_PER_SECOND, Layer, Segment
from dancedata.core.text import shown
from dancedata.files.strict_json import parse_json
from dancedata.store.columns import MAX_ROWS, broken, require_within
from dancedata.store.dataset_json import Description, checked_flag, json_object
from dancedata.store.listed_file import ListedFile
from dancedata.store.segment_overlay import SegmentOverlay
from dancedata.store.segments import QUALITY
from dancedata.store.table_file import KINDS, SEGMENT_COLUMNS, TableFile
from dancedata.store.tables import Tables

#: Longest time of a segment, seconds: far above `CLIP_END`.
_LONGEST_S = 1e12


@dataclass(frozen=True)
class SegmentTable:
    """Segments of a dataset: columns, and the rows [first[k], first[k + 1]) of clip k."""

    columns: dict[str, Any]
    first: npt.NDArray[np.int64]

    def rows_of(self, clip: int) -> range:
        """Return the rows of a clip."""
        return range(int(self.first[clip]), int(self.first[clip + 1]))

    def overlapping(self, clip: int, start: int, length: int, layers: npt.NDArray[np.bool_]) -> list[int]:
        """Return the rows of a clip, of the layers that are chosen, that cover a frame of [start, start + length)."""
        rows = slice(int(self.first[clip]), int(self.first[clip + 1]))
        begins, ends, layer = (np.asarray(self.columns[name][rows]) for name in ("start", "end", "layer"))
        covers = (begins < start + length) & (ends > start) & layers[layer]
        return (np.flatnonzero(covers) + rows.start).tolist()


def read_segments(listed: ListedFile, n_clips: int, description: Description) -> SegmentTable:
    """Read the segments of a dataset; StoreError for a table that does not fit its clips and layers."""
    bounds: dict[str, tuple[float, float]] = {
        "clip": (0, n_clips - 1), "start": (0, MAX_ROWS), "end": (0, MAX_ROWS), "other": (-1, n_clips - 1),
        "start_s": (-_LONGEST_S, _LONGEST_S), "end_s": (-_LONGEST_S, _LONGEST_S),
        "layer": (0, len(description.layers) - 1), "joint": (-1, MAX_JOINT),
    }  # fmt: skip
    with TableFile.opened(listed) as source:
        columns = source.table("segments", **{name: KINDS[kind] for name, kind in SEGMENT_COLUMNS.items()})
        first = np.asarray(source.column("segments/first", n_clips + 1, "int"), dtype=np.int64)
    if not columns or int(first[0]) != 0 or int(first[-1]) != len(columns["clip"]) or (np.diff(first) < 0).any():
        problem = "rows of clips that do not ascend from 0 to the last"
        raise broken(f"{listed.path}, /segments/first", problem, f"{first[:3]}")
    require_within(f"{listed.path}, /segments", columns, bounds)
    return SegmentTable(columns, first)


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


@dataclass(frozen=True)
class StoredSegments:
    """Segments of the clips of a store, which are named by their rows; `table` is None where none are stored."""

    table: SegmentTable | None
    overlay: SegmentOverlay | None
    layers: Sequence[Layer]
    tables: Tables
    grid: FrameGrid

    def of_clip(self, row: int, layer: str | None) -> list[Segment]:
        """Return the segments of a clip by their first frames, of all layers or those of a name."""
        ids = self.tables.ids
        stored = [] if self.table is None else segments_of(self.table, self.table.rows_of(row), self.layers, ids)
        segments = stored if self.overlay is None else self.overlay.over(ids[row], stored)
        return [segment for segment in segments if layer in (None, segment.layer.name)]

    def in_window(self, row: int, window: Window, layer: str | None) -> list[PlacedRow]:
        """Return the segments that a window overlaps, those of the whole group among them."""
        group = int(self.tables.group_of[row])
        first = int(self.tables.groups["first"][group]) if group >= 0 else row
        segments = self._placed(row, window, layer)
        if first != row:
            segments += [placed for placed in self._placed(first, window, layer) if placed.whole]
        return sorted(segments, key=lambda placed: (placed.start, placed.end))

    def _placed(self, row: int, window: Window, layer: str | None) -> list[PlacedRow]:
        ids, table = self.tables.ids, self.table
        if self.overlay is not None and ids[row] in self.overlay.segments:
            n_frames = int(self.tables.n_frames[row])
            in_window = [
                PlacedRow.of_segment(s, *s.frames(self.grid, n_frames), window) for s in self.of_clip(row, layer)
            ]
            return [placed for placed in in_window if placed.start < placed.end]
        if table is None:
            return []
        chosen = np.array([layer in (None, stored.name) for stored in self.layers], dtype=np.bool_)
        rows = table.overlapping(row, window.start, window.length, chosen)
        return [PlacedRow.of_table(table, k, self.layers, ids, window) for k in rows]

    def flags(self) -> Iterator[dict[str, Any]]:
        """Yield the quality flags; ValueError or IndexError for damaged ones."""
        numbers = [k for k, layer in enumerate(self.layers) if layer.name == QUALITY]
        if self.table is None or not numbers:
            return
        columns, ids = self.table.columns, self.tables.ids
        for k in np.flatnonzero(np.isin(columns["layer"], numbers)).tolist():
            value = float(columns["value"][k])
            flag: dict[str, Any] = {"clip": ids[int(columns["clip"][k])]}
            flag |= {"kind": columns["label"][k]} if columns["label"][k] else {}
            flag |= {} if math.isnan(value) else {"value": value}
            yield {**checked_flag(flag | parse_json(columns["data"][k] or "{}"), f"segment {k}")}
