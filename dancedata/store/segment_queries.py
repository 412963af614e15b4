"""Segments of a store, of clips and of windows: words and events in time."""

import math
from collections.abc import Iterator
from fractions import Fraction
from functools import cached_property
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.errors import StoreError, UsageError, did_you_mean
from dancedata.core.segments import Layer, Segment
from dancedata.core.text import shown
from dancedata.files.strict_json import parse_json
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.dataset_json import checked_flag
from dancedata.store.row_queries import RowQueries
from dancedata.store.segments import QUALITY, PlacedRow, PlacedSegment, segments_of


class SegmentQueries(RowQueries):
    """The part of a `Store` that reads segments."""

    @cached_property
    def layers(self) -> tuple[Layer, ...]:
        """Layers of segments, by their numbers; those of laid-over files are the last."""
        return self._description.layers + self.overlay.layers

    @overload
    def segments(self, of: str | ClipRecord, layer: str | None = None) -> list[Segment]: ...

    @overload
    def segments(self, of: Window, layer: str | None = None) -> list[PlacedSegment]: ...

    def segments(
        self, of: str | ClipRecord | Window, layer: str | None = None
    ) -> list[Segment] | list[PlacedSegment]:
        """Return the segments of a clip by their first frames, or those that a window overlaps.

        Of a window they are placed: with the frames of the window that they cover. Segments of the whole group are
        among those of each of its dancers. With `layer` those of the layers of this name.

        Raises UsageError: for an unknown clip or layer.
        """
        self._require_layer(layer)
        if isinstance(of, Window):
            return [placed.loaded() for placed in self._segment_rows_in(of, layer)]
        clip_id = of.id if isinstance(of, ClipRecord) else of
        table, row = self._segment_table, self._row(clip_id)
        stored = [] if table is None else segments_of(table, table.rows_of(row), self.layers, self._tables.ids)
        segments = self.overlay.over(clip_id, stored)
        return [segment for segment in segments if layer in (None, segment.layer.name)]

    def _segment_rows_in(self, window: Window, layer: str | None = None) -> list[PlacedRow]:
        """Return the same as `segments` of a window, except that each segment is read when it is asked for."""
        row = self._row_of(window)
        group = int(self._tables.group_of[row])
        first = int(self._tables.groups["first"][group]) if group >= 0 else row
        segments = self._placed(row, window, layer)
        if first != row:
            segments += [placed for placed in self._placed(first, window, layer) if placed.whole]
        return sorted(segments, key=lambda placed: (placed.start, placed.end))

    def mask(self, window: Window, layer: str) -> npt.NDArray[np.bool_]:
        """Return which frames of a window segments of a layer cover, (length,).

        Raises UsageError: for an unknown clip or layer.
        """
        self._require_layer(layer)
        segments = self._segment_rows_in(window, layer)
        mask = np.zeros(window.length, dtype=np.bool_)
        for placed in segments:
            mask[placed.start : placed.end] = True
        return mask

    def _seconds_of(self, clip_id: str) -> Fraction | None:
        """Return the length of a clip in seconds; None if there is no such clip."""
        row = self._tables.find(clip_id)
        return None if row is None else self.grid.seconds(int(self._tables.n_frames[row]))

    def _placed(self, row: int, window: Window, layer: str | None) -> list[PlacedRow]:
        tables, table = self._tables, self._segment_table
        clip = tables.ids[row]
        if clip in self.overlay.segments:
            n_frames = int(tables.n_frames[row])
            in_window = [
                PlacedRow.of_segment(s, *s.frames(self.grid, n_frames), window) for s in self.segments(clip, layer)
            ]
            return [placed for placed in in_window if placed.start < placed.end]
        if table is None:
            return []
        chosen = np.array([layer in (None, stored.name) for stored in self.layers], dtype=np.bool_)
        rows = table.overlapping(row, window.start, window.length, chosen)
        return [PlacedRow.of_table(table, k, self.layers, tables.ids, window) for k in rows]

    def _require_layer(self, layer: str | None) -> None:
        names = sorted({stored.name for stored in self.layers})
        if layer is not None and layer not in names:
            raise UsageError(f"no layer named {layer!r}", where=str(self.path), fix=did_you_mean(layer, names))

    @property
    def quality(self) -> list[dict[str, Any]]:
        """Quality flags: by clip in stored order, and by time; StoreError for damaged ones."""
        try:
            return list(self._flags())
        except (ValueError, IndexError) as error:
            raise StoreError("the quality flags cannot be read", where=str(self.path), found=shown(error)) from error

    def _flags(self) -> Iterator[dict[str, Any]]:
        table, layers = self._segment_table, self.layers
        numbers = [k for k, layer in enumerate(layers) if layer.name == QUALITY]
        if table is None or not numbers:
            return
        columns, ids = table.columns, self._tables.ids
        for k in np.flatnonzero(np.isin(columns["layer"], numbers)).tolist():
            value = float(columns["value"][k])
            flag: dict[str, Any] = {"clip": ids[int(columns["clip"][k])]}
            flag |= {"kind": columns["label"][k]} if columns["label"][k] else {}
            flag |= {} if math.isnan(value) else {"value": value}
            yield {**checked_flag(flag | parse_json(columns["data"][k] or "{}"), f"segment {k}")}
