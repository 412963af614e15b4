"""Fields, tables and files of an open store; its windows, their rows and segments."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import names
from dancedata.core.clip import Window
from dancedata.core.columns import Columns
from dancedata.core.errors import DanceDataError, StoreError, UsageError, did_you_mean, nearest
from dancedata.core.grid import WindowGrid
from dancedata.core.licence import Licence
from dancedata.core.text import shown
from dancedata.files.strict_json import read_json
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.dataset_json import (
    MAX_BYTES,
    MAX_LINES_BYTES,
    REBUILD,
    Description,
    SplitRows,
    json_rejects,
    json_stats,
)
from dancedata.store.listed_file import ListedFile, read_listed
from dancedata.store.schema import (
    LOCAL_FILE,
    REJECTS_FILE,
    SEGMENTS_FILE,
    STATS_FILE,
    TABLES_FILE,
    Field,
    Kind,
    sort_splits,
)
from dancedata.store.shard_reader import ShardReader, WindowRows
from dancedata.store.table_file import read_tables
from dancedata.store.tables import Tables
from dancedata.store.window_list import Ints, WindowList
from dancedata.store.windowing import locate_window, locate_windows, stored_windows, window_frames

if TYPE_CHECKING:
    from dancedata.core.segments import Layer, Segment
    from dancedata.store.segment_overlay import SegmentOverlay
    from dancedata.store.stored_segments import PlacedRow, PlacedSegment, SegmentTable, StoredSegments

T = TypeVar("T")
#: Clips of which a reader's attributes are remembered.
_REMEMBERED = 1 << 14
#: Largest local.json: a path.
_MAX_LOCAL = 1 << 16


class RowSpan(NamedTuple):
    """Rows [first, first + length) of a field in a shard."""

    shard: ShardReader
    first: int
    length: int


class RowQueries:
    """The part of a `Store` that opens its files when they are first needed, lists windows and reads rows."""

    _mapped = True
    #: The attributes that were asked for last, and their values by row of a clip.
    _remembered: tuple[Sequence[str], dict[int, tuple[Any, ...]]] = ((), {})

    def __init__(self, path: Path, description: Description, files: Mapping[str, ListedFile]) -> None:
        self.path = path
        self._description = description
        self._fields = {f.name: f for f in description.fields}
        self.fields: Mapping[str, Columns] = MappingProxyType({f.name: f.columns for f in description.fields})
        self.splits = sort_splits({s.split for s in description.shards})
        self.fps: int | Fraction = int(description.fps) if description.fps.denominator == 1 else description.fps
        self.skeleton = description.skeleton
        self.info = description.meta
        self.grid = description.grid
        self._files = files
        self._shard_readers = tuple(ShardReader(files[s.file], s, description.fields) for s in description.shards)
        self.overlay: SegmentOverlay | None = None

    def field(self, name: str) -> Field:
        """Return a field by name; UsageError with the closest name if there is none."""
        if not isinstance(name, str) or name not in self._fields:
            fix = did_you_mean(str(name), self._fields)
            raise UsageError(f"no field named {shown(name)!r}", where=str(self.path), fix=fix)
        return self._fields[name]

    def fields_with(self, *groups: str, kind: Kind = "audio") -> tuple[Field, ...]:
        """Return the fields of a kind that have these groups of columns, such as "beat", in the dataset's order."""
        fields = (f for f in self._fields.values() if f.kind == kind)
        return tuple(f for f in fields if set(groups) <= set(f.columns.names))

    @property
    def optional_fields(self) -> tuple[str, ...]:
        """Names of the fields that a clip may not have."""
        return tuple(name for name, field in self._fields.items() if field.optional)

    @property
    def required_fields(self) -> tuple[str, ...]:
        """Names of the fields that every clip has."""
        return tuple(name for name, field in self._fields.items() if not field.optional)

    @property
    def slice_length(self) -> int | None:
        """Frames of the slices, see `ClipRecord.slice_of`; None where clips are whole."""
        tables = self._tables
        return int(tables.n_frames[0]) if "slice_of" in tables.columns else None

    @property
    def group_sizes(self) -> dict[str, int]:
        """Number of dancers that each group has in the source, stored or not."""
        groups = self._tables.groups
        return dict(zip(groups["id"], np.asarray(groups["n_source"]).tolist(), strict=True)) if groups else {}

    @property
    def free_types(self) -> dict[str, str]:
        """Types of the free columns, by name with the prefix: "x/level"."""
        return dict(self._tables.types)

    @property
    def reference(self) -> tuple[str, str]:
        """Arguments of `reopen`: the path, and a hash of dataset.json."""
        return str(self.path), self._description.self_sha256

    @property
    def reader_name(self) -> str:
        """Name of the reader that the dataset was built with; "" where it has no recipe."""
        return str(next(iter(self.info.get("recipe", {}).get("dataset", {})), ""))

    @property
    def source_folder(self) -> Path | None:
        """Folder that the dataset was built from on this machine; None where it is unknown, or has moved."""
        try:
            place = read_json(self.path / LOCAL_FILE, _MAX_LOCAL)["source"]
            folder = Path(os.path.normpath(self.path.absolute() / place))
        except (OSError, ValueError, LookupError, TypeError, DanceDataError):
            return None
        return folder if folder.is_dir() else None

    @property
    def licences(self) -> tuple[Licence, ...]:
        """Terms of clips that differ from the dataset's, numbered as in `ClipRecord.licence`."""
        return tuple(Licence(entry["licence"], entry["citation"]) for entry in self.info.get("licences", ()))

    @cached_property
    def stats(self) -> dict[str, Any]:
        """stats.json: per field, over the rows that train windows cover."""
        return self._side_file(STATS_FILE, json_stats, MAX_BYTES)

    @cached_property
    def rejects(self) -> list[dict[str, Any]]:
        """rejects.jsonl: what the build left out, and why; none if the dataset does not list it."""
        listed = REJECTS_FILE in self._description.files
        return self._side_file(REJECTS_FILE, json_rejects, MAX_LINES_BYTES) if listed else []

    def _side_file(self, name: str, parse: Callable[[str], T], limit: int) -> T:
        try:
            return parse(read_listed(self.path, self._description, name, limit))
        except (OSError, ValueError) as error:
            where = str(self.path / name)
            raise StoreError(f"{name} cannot be read", where=where, found=str(error), fix=REBUILD) from error

    @cached_property
    def _tables(self) -> Tables:
        return read_tables(self._files[TABLES_FILE], self._description)

    @cached_property
    def layers(self) -> tuple[Layer, ...]:
        """Layers of segments, by their numbers; those of laid-over files are the last."""
        return self._description.layers + (() if self.overlay is None else self.overlay.layers)

    @cached_property
    def _segments(self) -> StoredSegments:
        from dancedata.store.stored_segments import StoredSegments, read_segments

        file, tables = self._files.get(SEGMENTS_FILE), self._tables
        table = None if file is None else read_segments(file, tables.n_clips, self._description)
        return StoredSegments(table, self.overlay, self.layers, tables, self.grid)

    @property
    def _segment_table(self) -> SegmentTable | None:
        return self._segments.table

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
        return self._segments.of_clip(self._row(of.id if isinstance(of, ClipRecord) else of), layer)

    def _segment_rows_in(self, window: Window, layer: str | None = None) -> list[PlacedRow]:
        """Return the same as `segments` of a window, except that each segment is read when it is asked for."""
        return self._segments.in_window(self._row_of(window), window, layer)

    def _require_layer(self, layer: str | None) -> None:
        names = sorted({stored.name for stored in self.layers})
        if layer is not None and layer not in names:
            raise UsageError(f"no layer named {layer!r}", where=str(self.path), fix=did_you_mean(layer, names))

    @property
    def quality(self) -> list[dict[str, Any]]:
        """Quality flags: by clip in stored order, and by time; StoreError for damaged ones."""
        try:
            return list(self._segments.flags())
        except (ValueError, IndexError) as error:
            raise StoreError("the quality flags cannot be read", where=str(self.path), found=shown(error)) from error

    def _seconds_of(self, clip_id: str) -> Fraction | None:
        """Return the length of a clip in seconds; None if there is no such clip."""
        row = self._tables.find(clip_id)
        return None if row is None else self.grid.seconds(int(self._tables.n_frames[row]))

    def _rows_of_split(self, split: str) -> SplitRows:
        """Return the rows of a split in the tables, and its shards; UsageError for an unknown one."""
        if split not in self.splits:
            raise UsageError(f"no split named {split!r}", where=str(self.path), fix=did_you_mean(split, self.splits))
        return self._description.splits[split]

    def _shards(self, split: str) -> tuple[ShardReader, ...]:
        return self._shard_readers[self._rows_of_split(split).shards]

    def _row(self, clip_id: str) -> int:
        """Return the row of a clip; UsageError with the closest id if there is none."""
        row = self._tables.find(clip_id) if isinstance(clip_id, str) else None
        if row is None:
            fix = nearest(str(clip_id), list(self._tables.ids), "clip", self.path)
            raise UsageError(f"no clip named {shown(clip_id)!r}", where=str(self.path), fix=fix)
        return row

    def windows(
        self,
        split: str,
        *,
        length_s: float | str | Fraction | None = None,
        length: int | None = None,
        stride_s: float | str | Fraction | None = None,
        stride: int | None = None,
        fields: tuple[str, ...] | None = None,
        trim: bool = False,
        whole: bool = False,
    ) -> WindowList:
        """List the windows of a split, in the store's order: shard by shard.

        `split`: One of `splits`.
        `length_s`, `length`, `stride_s`, `stride`: Length and stride of the windows, at most one of each pair;
            default: as stored.
        `fields`: Fields in which these windows have to begin and end at whole rows, and that their clips have.
            Default: all.
        `trim`: Begin at each clip's trim_start: skip the frames that the source would cut.
        `whole`: One window per clip instead, as long as all of `fields` have whole rows.
        Returns: A Sequence[Window].
        Raises UsageError: for an unknown split, two lengths or strides, or ones that are not a whole number of frames
            and rows.
        """
        self._rows_of_split(split)
        tables = self._tables
        requested = self._window_grid(length_s=length_s, length=length, stride_s=stride_s, stride=stride)
        stored = WindowGrid(self._description.length, self._description.stride)
        window_fields = [self.field(name) for name in names("fields", fields or tuple(self._fields))]
        if requested == stored and not trim and not whole:
            return stored_windows(tables, split, window_fields)
        from dancedata.store.window_cuts import list_windows, whole_clips

        if whole:
            return whole_clips(tables, split, self._description, window_fields, trim)
        return list_windows(tables, split, self._description, requested, window_fields, trim)

    def _window_grid(
        self,
        *,
        length_s: float | str | Fraction | None = None,
        length: int | None = None,
        stride_s: float | str | Fraction | None = None,
        stride: int | None = None,
    ) -> WindowGrid:
        stored = self._description
        return WindowGrid(
            window_frames(self.grid, "length", length_s, length, stored.length),
            window_frames(self.grid, "stride", stride_s, stride, stored.stride),
        )

    def _without(self, clip_id: str, fields: Iterable[str]) -> tuple[str, ...]:
        """Return those of some fields that a clip does not have."""
        spans, row = self._tables.spans, self._row(clip_id)
        return tuple(name for name in fields if self.field(name).optional and not spans[name].available[row])

    def _starts(
        self, clip_id: str, length: int, *, fields: tuple[str, ...] | None = None, trim: bool = False
    ) -> range:
        """Return every first frame that a window of `length` frames can have in a clip."""
        from dancedata.store.window_cuts import whole_period, window_starts

        window_fields = [self.field(name) for name in fields or self._fields]
        tables, row = self._tables, self._row(clip_id)
        window_grid = WindowGrid(length, whole_period(self._description, window_fields))
        return window_starts(tables, row, self._description, window_grid, window_fields, trim)

    def read(self, window: Window, field: str, out: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        """Read a window's rows of a field.

        `window`: One of `windows`, or any one within its clip.
        `out`: Array (length * rate / fps, D) to read into, whose dtype the rows are converted to.
        Returns: `out`, or a new, writable array in the field's dtype.
        """
        span, f = self._locate(window, field), self._fields[field]
        shape = (span.length, f.columns.width)
        if out is None:
            out = np.empty(shape, dtype=f.disk_dtype)
        elif out.shape != shape:
            raise UsageError("the array to read into has the wrong shape", found=out.shape, allowed=shape)
        span.shard.read_rows(field, span.first, out)
        return out

    def _locate(self, window: Window, field: str) -> RowSpan:
        """Return the shard and the rows of a window; UsageError for one that the store does not have."""
        row, f, tables = self._row_of(window), self.field(field), self._tables
        first, length = locate_window(tables, row, window, f, self.grid)
        return RowSpan(self._shard_readers[int(tables.shard_of(row))], first, length)

    def _row_of(self, window: Window) -> int:
        """Return the row of a window's clip; UsageError for anything but whole frames of a clip."""
        if not (
            isinstance(window, Window) and hasattr(window.start, "__index__") and hasattr(window.length, "__index__")
        ):
            raise UsageError("not a window of whole frames", where=str(self.path), found=shown(window),
                             fix='take one of ds.windows("train"); a whole clip is ds[ID].read(FIELD)')  # fmt: skip
        return self._row(window.clip)

    def _window_rows(self, windows: WindowList, field: str) -> WindowRows:
        """Return the reader of a field's rows of many windows of one length; errors as those of `_locate`."""
        f = self.field(field)
        if not len(windows):
            raise UsageError("there are no windows to read", where=str(self.path), found=f"field {field}")
        if (windows.length != windows.length[0]).any():
            lengths = sorted({int(n) for n in windows.length})
            raise StoreError("the windows of a split differ in length", where=str(self.path), found=lengths)
        n_rows = self.grid.rows(int(windows.length[0]), of=f.grid)
        tables, row = self._tables, self._rows_of(windows)
        first, bad = locate_windows(tables, row, windows, f, self.grid)
        if bad.any():
            self._locate(windows[int(np.argmax(bad))], field)
        return WindowRows(field, *self._shards_of(windows), first, n_rows, self._mapped)

    def _clip_values(self, windows: WindowList, names: Sequence[str]) -> dict[str, list[Any]]:
        """Return attributes of `ClipRecord` of the clips of windows, (W,) each by name; reads their columns alone."""
        rows = self._rows_of(windows).tolist()
        key, known = self._remembered
        if key != names or len(known) > _REMEMBERED:
            known = {}  # not emptied: another thread may read it
            self._remembered = names, known
        missing = [row for row in dict.fromkeys(rows) if row not in known]
        if missing:
            values = zip(*(self._tables.values(name, missing) for name in names), strict=True)
            known |= zip(missing, values, strict=True)
        return dict(zip(names, map(list, zip(*[known[row] for row in rows], strict=True)), strict=True))

    def _shards_of(self, windows: WindowList) -> tuple[tuple[ShardReader, ...], npt.NDArray[np.int32]]:
        """Return the shards of the dataset, and the number (W,) of each window's shard among them."""
        of_clip = self._tables.shard_of(np.arange(self._tables.n_clips)).astype(np.int32)
        return self._shard_readers, of_clip[self._rows_of(windows)]

    def _rows_of(self, windows: WindowList) -> Ints:
        """Return the rows (W,) of the clips of windows, which may be those of another opened dataset."""
        if windows.clip_ids is self._tables.ids:
            return windows.clip
        used, number = np.unique(windows.clip, return_inverse=True)
        return np.array([self._row(windows.clip_ids[k]) for k in used.tolist()], dtype=np.int64)[number]
