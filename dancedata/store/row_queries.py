"""Windows and clips of a store, and their rows."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import names
from dancedata.core.clip import Window
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.grid import WindowGrid
from dancedata.core.text import shown
from dancedata.store.locate import RowSpan, locate_view, locate_windows, require_field
from dancedata.store.shard_reader import ShardReader, WindowRows
from dancedata.store.store_tables import StoreTables
from dancedata.store.window_list import Whole, WindowList
from dancedata.store.windowing import (
    cut_windows,
    requested_grid,
    stored_windows,
    whole_clips,
    whole_period,
    window_starts,
)

#: Clips of which a reader's attributes are remembered.
_REMEMBERED = 1 << 14


class RowQueries(StoreTables):
    """The part of a `Store` that lists windows and reads rows."""

    _mapped = True
    #: The attributes that were asked for last, and their values by row of a clip.
    _remembered: tuple[Sequence[str], dict[int, tuple[Any, ...]]] = ((), {})

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
        if whole:
            return whole_clips(tables, split, self._description, window_fields, trim)
        return cut_windows(tables, split, self._description, requested, window_fields, trim)

    def _window_grid(
        self,
        *,
        length_s: float | str | Fraction | None = None,
        length: int | None = None,
        stride_s: float | str | Fraction | None = None,
        stride: int | None = None,
    ) -> WindowGrid:
        """Return length and stride of windows in frames, as `windows` cuts them; arguments as there."""
        return requested_grid(self._description, length_s, length, stride_s, stride)

    def _has_field(self, clip_id: str, field: str) -> bool:
        """Return whether a clip has rows of a field: fields that a recipe makes optional may be missing.

        UsageError for an unknown clip or field.
        """
        f = self.field(field)
        tables, row = self._tables, self._row(clip_id)
        return not f.optional or bool(tables.has_rows(f)[row])

    def _without(self, clip_id: str, fields: Iterable[str]) -> tuple[str, ...]:
        """Return those of some fields that a clip does not have."""
        return tuple(name for name in fields if self.field(name).optional and not self._has_field(clip_id, name))

    def _windows_of(self, clip_id: str) -> tuple[Window, ...]:
        """Return the stored windows of a clip, by their first frames; UsageError for an unknown clip."""
        tables, row = self._tables, self._row(clip_id)
        starts = tables.window_start[tables.positions_of(row)].tolist()
        return tuple(Window(clip_id, start, tables.window_length) for start in starts)

    def _starts(
        self, clip_id: str, length: int, *, fields: tuple[str, ...] | None = None, trim: bool = False
    ) -> range:
        """Return every first frame that a window of `length` frames can have in a clip.

        `fields` and `trim` are those of `windows`.

        Raises UsageError: for an unknown clip.
        """
        window_fields = [self.field(name) for name in fields or self._fields]
        tables, row = self._tables, self._row(clip_id)
        window_grid = WindowGrid(length, whole_period(self._description, window_fields))
        return window_starts(tables, row, self._description, window_grid, window_fields, trim)

    def _rows_within(self, clip_id: str, field: str) -> tuple[int, npt.NDArray[Any]]:
        """Read the rows of a field that lie within a clip, from its first frame or where its music begins.

        Returns the row at which they begin, counted from frame 0, and the rows.
        """
        tables, row = self._tables, self._row(clip_id)
        lead = tables.spans[field].delay(row) if field in tables.spans else 0
        if not lead:
            return 0, self._read_clip(clip_id, field)
        f, (begin, _) = self.field(field), self.grid.common_period(self._fields[field].grid)
        first = -(-f.grid.rows_up(lead, of=self.grid) // begin) * begin
        length = max(0, (int(tables.n_frames[row]) - first) // begin * begin)
        available = f.grid.rows_down(int(tables.spans[field].available[row]), of=self.grid) // begin * begin
        length = min(length, max(0, available - first))
        rows = self.read(Window(clip_id, first, length), field) if length else np.empty((0, f.columns.width))
        return self.grid.rows_down(first, of=f.grid), rows

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
        """Find the shard and the rows of a window, for readers that map files themselves.

        Raises UsageError: for an unknown clip or field, a window that is not a whole number of rows or extends beyond
            its clip, and anything except a Window.
        """
        row, f, tables = self._row_of(window), self.field(field), self._tables
        first, length = locate_view(tables, row, window, f, self.grid)
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
        """Find a field's rows of many windows of equal length at once, for readers that copy from mapped files.

        Raises UsageError, StoreError: As `_locate`, for the first window that the store does not have; if there are
            no windows.
        """
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

    def _rows_of(self, windows: WindowList) -> Whole:
        """Return the rows (W,) of the clips of windows, which may be those of another opened dataset."""
        if windows.clip_ids is self._tables.ids:
            return windows.clip
        used, number = np.unique(windows.clip, return_inverse=True)
        return np.array([self._row(windows.clip_ids[k]) for k in used.tolist()], dtype=np.int64)[number]

    def _read_clip(self, clip_id: str, field: str) -> npt.NDArray[Any]:
        """Read all rows of a field that belong to a clip; see `Clip.read`."""
        return self._read_rows(clip_id, field, whole_song=False)

    def _read_song(self, clip_id: str, field: str) -> npt.NDArray[Any]:
        """Read an audio field from a clip's first frame to the end of its music; see `Clip.read_song`."""
        if self.field(field).kind != "audio":
            where, fix = str(self.path), "read it with clip.read(FIELD)"
            raise UsageError(f"field {field} is not a field of music", where=where, fix=fix)
        return self._read_rows(clip_id, field, whole_song=True)

    def _music_offset(self, clip_id: str) -> Fraction:
        """Return the time in a clip's music at its frame 0, seconds, exactly; negative where the music begins later.

        Rows of audio fields begin at the next whole row, see `_rows_within`. 0 where no time is stored.
        """
        tables, row = self._tables, self._row(clip_id)
        start = tables.record(row).audio_start
        if start:
            return start  # exact, where rows begin at a fraction of one
        for name, spans in tables.spans.items():
            if spans.offset is not None and self._fields[name].kind == "audio":
                return self._fields[name].grid.seconds(int(spans.offset[row]))
        return Fraction(0)

    def _read_rows(self, clip_id: str, field: str, *, whole_song: bool) -> npt.NDArray[Any]:
        f = self.field(field)
        tables, row = self._tables, self._row(clip_id)
        require_field(tables, row, f)
        spans = tables.spans[field]
        rows, lead = int(spans.available[row]), spans.delay(row)
        if lead:
            raise UsageError(f"the rows of field {field} begin after the clip's first frame", where=f"clip {clip_id}",
                             found=f"row {lead}",
                             fix="read windows, which begin where all their fields do")  # fmt: skip
        if not f.per_clip and not whole_song:
            rows = max(0, min(rows, self.grid.rows_up(int(tables.n_frames[row]), of=f.grid)))
        return self._shard_readers[int(tables.shard_of(row))].rows(field, int(spans.first[row]), rows)
