"""Store: a built dataset, read with numpy only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.columns import Columns
from dancedata.core.errors import StoreError, UsageError, did_you_mean, nearest
from dancedata.core.grid import WindowGrid
from dancedata.core.licence import Licence
from dancedata.core.text import shown
from dancedata.files.regular_file import sha256_file
from dancedata.remote import Origin, RangedFile, Stream, local_folder, origin_of
from dancedata.store.clip_view import Clips, ClipView
from dancedata.store.dataset_json import Description, stated_weights
from dancedata.store.leaves import ranged_shards
from dancedata.store.listed_file import FileHash, ListedFile, SideFiles, open_listed, rebuilt_error
from dancedata.store.locate import RowSpan, locate_stored, locate_view, locate_windows, require_field
from dancedata.store.normalize import MinMax, ZScore
from dancedata.store.schema import Field, Kind, sort_splits
from dancedata.store.segment_overlay import SegmentOverlay
from dancedata.store.segment_queries import SegmentQueries
from dancedata.store.segments import quality_rows
from dancedata.store.shard_reader import ShardReader, WindowRows
from dancedata.store.shard_tables import read_shard_tables
from dancedata.store.table_file import SegmentTable, read_tables
from dancedata.store.tables import Tables
from dancedata.store.window_list import IntArray, Whole, WindowList
from dancedata.store.windowing import (
    cut_windows,
    requested_grid,
    stored_windows,
    whole_clips,
    whole_period,
    window_starts,
)

if TYPE_CHECKING:
    from pandas import DataFrame


def open_store(
    path: str | Path, *, segments: str | Path | Sequence[str | Path] = (), stream: bool | Stream = False
) -> Store:
    """Open a built dataset; reads dataset.json, compares its hash, and checks the sizes of the shards.

    Parameters
    ----------
    path
        Folder that a build wrote, or the address of one, such as ``hf://datasets/ORG/NAME@REVISION``: its files
        are fetched into the cache when they are first read, see `dancedata.remote`.
    segments
        Files of segments, .csv or .jsonl, that are laid over those of the dataset: marks and corrections. A row
        replaces segments of the same layer, start and end.
    stream
        Whether rows of an address are read by ranges instead of fetching shards whole, for shards that are too large
        for the disk: True, or a `dancedata.remote.Stream` with sizes. Shards that were fetched before are read from
        the disk, as everything of a local folder is.

    Returns
    -------
    Store
        Tables, rows and statistics are read on first use.

    Raises
    ------
    StoreError
        If the folder has no finished dataset or one of another format version, dataset.json was changed after the
        build, or a shard is missing or has another size; with `stream`, if the dataset has no hashes of parts of its
        shards.
    SourceError
        For a mistake in a file of segments.

    Examples
    --------
    >>> import dancedata
    >>> ds = dancedata.open("data/aistpp")
    >>> ds.read(ds.windows("train")[3], "edge151").shape
    (150, 151)
    """
    folder = local_folder(path).absolute()
    options = None if stream is False else Stream() if stream is True else stream
    description, listed = open_listed(folder)
    store = Store(folder, description, listed, options)
    files = [segments] if isinstance(segments, str | Path) else segments
    if files:
        store.overlay = SegmentOverlay.read(
            [Path(f).expanduser() for f in files], store.reference[1], store.seconds_of
        )
    return store


class Store(SegmentQueries):
    """A built dataset.

    Safe to pickle, to fork and to read from several threads: tables are read once, rows straight from the
    file by position. Made by `open_store`.

    Attributes
    ----------
    path
        Absolute path of the folder.
    splits
        Names of the splits that have clips: train, val, test, then others.
    fields
        Columns of every field, by name.
    fps
        Frames per second of window starts and lengths: int if whole, else Fraction.
    grid
        The same rate as a `FrameGrid`.
    scope
        "track": windows are views of clips. "window": each window has its own rows.
    skeleton
        The motion's skeleton.
    meta
        dataset.json.
    overlay
        Segments of files that were named when it was opened.
    stream
        How rows are read by ranges; None where they are not.
    """

    def __init__(
        self, path: Path, description: Description, files: Mapping[str, ListedFile], stream: Stream | None = None
    ) -> None:
        """Use `open_store` instead."""
        self.stream = stream
        ranged: Mapping[str, RangedFile] = {} if stream is None else ranged_shards(path, description, stream)
        self.path = path
        self._description = description
        self._fields = {f.name: f for f in description.fields}
        self.fields: Mapping[str, Columns] = MappingProxyType({f.name: f.columns for f in description.fields})
        self.splits = sort_splits({s.split for s in description.shards})
        self.fps: int | Fraction = int(description.fps) if description.fps.denominator == 1 else description.fps
        self.scope = description.scope
        self.skeleton = description.skeleton
        self.meta = description.meta
        self.grid = description.grid
        self._side_files = SideFiles(path, description)
        self._files = files
        self._shards: dict[str, tuple[ShardReader, ...]] = {
            split: tuple(
                ShardReader(files[s.file], s, description.fields, ranged.get(s.file))
                for s in description.shards
                if s.split == split and s.file in files  # `check` opens one split, whose files are not damaged
            )
            for split in self.splits
        }
        self._tables: dict[str, Tables] = {}
        self._segments: dict[str, SegmentTable | None] = {}
        self.overlay = SegmentOverlay()

    def __reduce__(self) -> tuple[Any, ...]:
        return reopen, (*self.reference, self.overlay, self.stream)

    @cached_property
    def reference(self) -> tuple[str, str]:
        """Arguments for `reopen`: the path, and a hash of dataset.json."""
        return str(self.path), self._description.self_sha256

    def _repr_html_(self) -> str:
        """Show the dataset in a notebook: splits, fields, licence and the first clips."""
        # By name: a store is read without what draws it.
        table: str = import_module("dancedata.viewer.tables").store_html(self)
        return table

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, splits={self.splits}, fields={tuple(self.fields)}, fps={self.fps})"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; a later read opens them again."""
        for shards in self._shards.values():
            for shard in shards:
                shard.close()

    def require_intact(self, clips: Iterable[str] | None = None, sha256: FileHash = sha256_file) -> None:
        """Raise StoreError if bytes of shards or tables differ from the build's; reading rows does not compare them.

        Only the files of `clips` are read, by default all; `sha256` gives the hash of a file.
        """
        shards, splits = sum(self._shards.values(), ()), set(self.splits)
        if clips is not None:
            places = [self._place(clip) for clip in clips]
            shards = tuple({self._shards[t.split][int(t.shard_of(row))] for t, row in places})
            splits = {tables.split for tables, _ in places}
        for split in splits:
            entry = self._description.splits.get(split)
            for file in (entry.tables, entry.segments) if entry is not None else ():
                if file is not None:
                    self._files[file.file].require_bytes(sha256)
        for shard in shards:
            shard.require_bytes(sha256)

    def field(self, name: str) -> Field:
        """Return a field by name; UsageError with the closest name if there is none."""
        if name not in self._fields:
            raise UsageError(f"no field named {name!r}", where=str(self.path), fix=did_you_mean(name, self._fields))
        return self._fields[name]

    def tables(self, split: str) -> Tables:
        """Return the tables of a split: columns of its clips and windows, read on first use.

        Raises
        ------
        UsageError
            For an unknown split.
        StoreError
            If the tables do not fit the dataset.
        """
        if split not in self._shards:
            raise UsageError(f"no split named {split!r}", where=str(self.path), fix=did_you_mean(split, self.splits))
        if split not in self._tables:
            self._tables[split] = self._read_tables(split)
        return self._tables[split]

    def shards(self, split: str) -> tuple[ShardReader, ...]:
        """Return the readers of a split's shards."""
        return self._shards[split]

    def _read_tables(self, split: str) -> Tables:
        entry, shards = self._description.splits.get(split), self._shards[split]
        if entry is None:
            return read_shard_tables(shards, self._description, split)
        return read_tables(self._files[entry.tables.file], self._description, split)

    @property
    def clips(self) -> Clips:
        """All clips: split by split, in stored order."""
        return Clips(self, [self.tables(split) for split in self.splits])

    def clip(self, clip_id: str) -> ClipView:
        """Return a clip by id; UsageError with the closest id if there is none."""
        tables, row = self._place(clip_id)
        return ClipView.of(self, tables.record(row))

    def windows(
        self,
        split: str,
        *,
        length_s: float | str | Fraction | None = None,
        length_frames: int | None = None,
        stride_s: float | str | Fraction | None = None,
        stride_frames: int | None = None,
        fields: tuple[str, ...] | None = None,
        trim: bool = False,
        whole: bool = False,
    ) -> WindowList:
        """List the windows of a split, in the store's order: shard by shard.

        Parameters
        ----------
        split
            One of `splits`.
        length_s, length_frames, stride_s, stride_frames
            Length and stride of the windows, at most one of each pair; default: as stored. Other values need a
            store of track scope.
        fields
            Fields in which these windows have to begin and end at whole rows, and that their clips have. Default:
            all.
        trim
            Begin at each clip's trim_start: skip the frames that the source would cut (track scope only).
        whole
            One window per clip instead, as long as all of `fields` have whole rows (track scope only).

        Returns
        -------
        WindowList
            A Sequence[Window].

        Raises
        ------
        UsageError
            For an unknown split, two lengths or strides, or ones that are not a whole number of frames and rows.
        StoreError
            For another length or stride in window scope.
        """
        tables = self.tables(split)
        requested = self.window_grid(
            length_s=length_s, length_frames=length_frames, stride_s=stride_s, stride_frames=stride_frames
        )
        stored = WindowGrid(self._description.length, self._description.stride)
        window_fields = [self.field(name) for name in fields or self._fields]
        if requested == stored and not trim and not whole:
            return stored_windows(tables, window_fields)
        if self.scope == "window":
            request = "whole clips" if whole else f"length {requested.length}, stride {requested.stride} frames"
            raise self._only_built_windows(request + (", trimmed" if trim else ""))
        if whole:
            return whole_clips(tables, self._description, window_fields, trim)
        return cut_windows(tables, self._description, requested, window_fields, trim)

    def _only_built_windows(self, request: str | None = None) -> StoreError:
        stored = f"length {self._description.length}, stride {self._description.stride} frames"
        return StoreError(
            "a store of window scope holds only the windows that were built", where=str(self.path), found=request,
            allowed=stored, fix="build with scope: track",
        )  # fmt: skip

    def window_grid(
        self,
        *,
        length_s: float | str | Fraction | None = None,
        length_frames: int | None = None,
        stride_s: float | str | Fraction | None = None,
        stride_frames: int | None = None,
    ) -> WindowGrid:
        """Return length and stride of windows in frames, as `windows` cuts them; arguments as there."""
        return requested_grid(self._description, length_s, length_frames, stride_s, stride_frames)

    def has_field(self, clip_id: str, field: str) -> bool:
        """Return whether a clip has rows of a field: fields that a recipe makes optional may be missing.

        UsageError for an unknown clip or field.
        """
        f = self.field(field)
        tables, row = self._place(clip_id)
        return not f.optional or bool(tables.having(f)[row])

    @property
    def required_fields(self) -> tuple[str, ...]:
        """Names of the fields that every clip has."""
        return tuple(name for name, f in self._fields.items() if not f.optional)

    @property
    def optional_fields(self) -> tuple[str, ...]:
        """Names of the fields that a clip may not have."""
        return tuple(name for name, f in self._fields.items() if f.optional)

    def without(self, clip_id: str, fields: Iterable[str]) -> tuple[str, ...]:
        """Return those of some fields that a clip does not have; see `has_field`."""
        return tuple(name for name in fields if self.field(name).optional and not self.has_field(clip_id, name))

    def windows_of(self, clip_id: str) -> tuple[Window, ...]:
        """Return the stored windows of a clip, by their first frames; UsageError for an unknown clip."""
        tables, row = self._place(clip_id)
        starts = tables.window_start[tables.positions_of(row)].tolist()
        return tuple(Window(clip_id, start, tables.window_length) for start in starts)

    def fields_with(self, *groups: str, kind: Kind = "audio") -> tuple[Field, ...]:
        """Return the fields of a kind that have these groups of columns, such as "beat", in the dataset's order."""
        return tuple(f for f in self._fields.values() if f.kind == kind and set(groups) <= set(f.columns.names))

    def starts(
        self, clip_id: str, length: int, *, fields: tuple[str, ...] | None = None, trim: bool = False
    ) -> range:
        """Return every first frame that a window of `length` frames can have in a clip (track scope only).

        `fields` and `trim` are those of `windows`.

        Raises
        ------
        UsageError
            For an unknown clip.
        StoreError
            In window scope, which holds only the stored windows.
        """
        if self.scope == "window":
            raise self._only_built_windows()
        window_fields = [self.field(name) for name in fields or self._fields]
        tables, row = self._place(clip_id)
        window_grid = WindowGrid(length, whole_period(self._description, window_fields))
        return window_starts(tables, row, self._description, window_grid, window_fields, trim)

    def rows_within(self, clip_id: str, field: str) -> tuple[int, npt.NDArray[Any]]:
        """Read the rows of a field that lie within a clip, from its first frame or where its music begins.

        Track scope only. Returns the row at which they begin, counted from frame 0, and the rows.
        """
        tables, row = self._place(clip_id)
        lead = tables.spans[field].lead(row) if field in tables.spans else 0
        if not lead:
            return 0, self.read_clip(clip_id, field)
        f, (begin, _) = self.field(field), self.grid.common_period(self._fields[field].grid)
        first = -(-f.grid.rows_up(lead, of=self.grid) // begin) * begin
        length = max(0, (int(tables.n_frames[row]) - first) // begin * begin)
        available = f.grid.rows_down(int(tables.spans[field].available[row]), of=self.grid) // begin * begin
        length = min(length, max(0, available - first))
        rows = self.read(Window(clip_id, first, length), field) if length else np.empty((0, f.columns.width))
        return self.grid.rows_down(first, of=f.grid), rows

    def read(self, window: Window, field: str) -> npt.NDArray[Any]:
        """Read a window's rows of a field.

        Parameters
        ----------
        window
            One of `windows`; in track scope any window within its clip.

        Returns
        -------
        ndarray
            (length * rate / fps, D) in the field's dtype: a new, writable array.
        """
        span = self.locate(window, field)
        f = self._fields[field]
        out = np.empty((span.length, f.columns.width), dtype=f.disk_dtype)
        span.shard.read_rows(field, span.first, out)
        return out

    def read_into(self, window: Window, field: str, out: npt.NDArray[Any]) -> None:
        """Read a window's rows of a field into `out`, (length * rate / fps, D), converting to its dtype."""
        span = self.locate(window, field)
        shape = (span.length, self._fields[field].columns.width)
        if out.shape != shape:
            raise UsageError("the array to read into has the wrong shape", found=out.shape, allowed=shape)
        span.shard.read_rows(field, span.first, out)

    def locate(self, window: Window, field: str) -> RowSpan:
        """Find the shard and the rows of a window, for readers that map files themselves.

        Raises
        ------
        UsageError
            For an unknown clip or field, a window that is not a whole number of rows or extends beyond its clip, and
            anything except a Window.
        StoreError
            In window scope, for a window that is not stored.
        """
        if not isinstance(window, Window):
            raise UsageError(
                "not a window",
                where=str(self.path),
                found=shown(window),
                fix='take one of ds.windows("train"); a whole clip is ds.clip(ID).read(FIELD)',
            )
        f = self.field(field)
        tables, row = self._place(window.clip)
        find = locate_stored if self.scope == "window" else locate_view
        first, length = find(tables, row, window, f, self.grid)
        return RowSpan(self._shards[tables.split][int(tables.shard_of(row))], first, length)

    def window_rows(self, windows: WindowList, field: str, *, mapped: bool = True) -> WindowRows:
        """Find a field's rows of many windows of equal length at once, for readers that copy from mapped files.

        Raises
        ------
        UsageError, StoreError
            As `locate`, for the first window that the store does not have; if there are no windows.
        """
        f = self.field(field)
        if not len(windows):
            raise UsageError("there are no windows to read", where=str(self.path), found=f"field {field}")
        if (windows.length != windows.length[0]).any():
            lengths = sorted({int(n) for n in windows.length})
            raise StoreError("the windows of a split differ in length", where=str(self.path), found=lengths)
        n_rows = self.grid.rows(int(windows.length[0]), of=f.grid)
        shards, shard = self.shards_of(windows)
        first = np.zeros(len(windows), dtype=np.int64)
        for tables, places, row in self._rows_of(windows):
            part = windows if places is None else windows.take(places)
            rows, bad = locate_windows(tables, row, part, f, self.grid, self.scope)
            if bad.any():
                self.locate(part[int(np.argmax(bad))], field)
            first[slice(None) if places is None else places] = rows
        return WindowRows(field, shards, shard, first, n_rows, mapped)

    def shards_of(self, windows: WindowList) -> tuple[list[ShardReader], npt.NDArray[np.int32]]:
        """Return the shards of the splits of windows, and the number (W,) of each window's shard among them."""
        shards: list[ShardReader] = []
        numbers = np.zeros(len(windows), dtype=np.int32)
        for tables, places, row in self._rows_of(windows):
            numbers[slice(None) if places is None else places] = tables.shard_of(row) + len(shards)
            shards += self._shards[tables.split]
        return shards, numbers

    def _rows_of(self, windows: WindowList) -> Iterator[tuple[Tables, IntArray | None, Whole]]:
        """Yield for each split its tables, the places of its windows (None: all), and the rows of their clips."""
        for split in self.splits:
            if split in self._tables and windows.clip_ids is self._tables[split].ids:
                yield self._tables[split], None, windows.clip
                return
        used = np.unique(windows.clip)
        places = [self._place(windows.clip_ids[k]) for k in used.tolist()]
        number = np.searchsorted(used, windows.clip)
        for tables in dict.fromkeys(tables for tables, _ in places):
            of_split = np.array([t is tables for t, _ in places])[number]
            row = np.array([row for _, row in places])[number]
            yield tables, np.flatnonzero(of_split), row[of_split]

    def read_clip(self, clip_id: str, field: str) -> npt.NDArray[Any]:
        """Read all rows of a field that belong to a clip; see `ClipView.read`."""
        return self._read_rows(clip_id, field, whole_song=False)

    def read_song(self, clip_id: str, field: str) -> npt.NDArray[Any]:
        """Read an audio field from a clip's first frame to the end of its music; see `ClipView.read_song`."""
        if self.field(field).kind != "audio":
            raise UsageError(f"field {field} is not a field of music", where=str(self.path), fix="use read_clip")
        return self._read_rows(clip_id, field, whole_song=True)

    def music_offset(self, clip_id: str) -> Fraction:
        """Return the time in a clip's music at its frame 0, seconds, exactly; negative where the music begins later.

        Rows of audio fields begin at the next whole row, see `rows_within`. 0 where no time is stored.
        """
        tables, row = self._place(clip_id)
        start = tables.record(row).audio_start
        if start:
            return start  # exact, where rows begin at a fraction of one
        for name, spans in tables.spans.items():
            if spans.offset is not None and self._fields[name].kind == "audio":
                return self._fields[name].grid.seconds(int(spans.offset[row]))
        return Fraction(0)

    def _read_rows(self, clip_id: str, field: str, *, whole_song: bool) -> npt.NDArray[Any]:
        f = self.field(field)
        tables, row = self._place(clip_id)
        if self.scope == "window":
            raise StoreError(
                "a store of window scope does not hold whole clips",
                where=f"clip {clip_id}",
                fix="read its windows, or build with scope: track",
            )
        require_field(tables, row, f)
        spans = tables.spans[field]
        rows, lead = int(spans.available[row]), spans.lead(row)
        if lead:
            raise UsageError(
                f"the rows of field {field} begin after the clip's first frame",
                where=f"clip {clip_id}",
                found=f"row {lead}",
                fix="read windows, which begin where all their fields do",
            )
        if not f.per_clip and not whole_song:
            rows = max(0, min(rows, self.grid.rows_up(int(tables.n_frames[row]), of=f.grid)))
        out = np.empty((rows, f.columns.width), dtype=f.disk_dtype)
        shard = self._shards[tables.split][int(tables.shard_of(row))]
        shard.read_rows(field, int(spans.first[row]), out)
        return out

    def _place(self, clip_id: str) -> tuple[Tables, int]:
        """Find a clip's tables and row, split by split: training does not read the tables of test."""
        for split in sorted(self.splits, key=lambda split: split not in self._tables):
            row = self.tables(split).find(clip_id)
            if row is not None:
                return self.tables(split), row
        clip_ids = [clip for split in self.splits for clip in self.tables(split).ids]
        fix = nearest(clip_id, clip_ids, "clip", self.path)
        raise UsageError(f"no clip named {clip_id!r}", where=str(self.path), fix=fix)

    @property
    def origin(self) -> Origin | None:
        """Address of a dataset that was fetched, of a hub with its commit; None for one of the local disk."""
        return origin_of(self.path)

    @property
    def weights(self) -> dict[str, str]:
        """By field that a network computed: name, commit and hash of its weights, and their licence."""
        weights = {name: stated_weights(self.meta, name) for name in self._fields}
        return {name: text for name, text in weights.items() if text}

    @property
    def licences(self) -> tuple[Licence, ...]:
        """Terms of clips that differ from the dataset's, numbered as in `ClipRecord.licence`."""
        return tuple(Licence(entry["licence"], entry["citation"]) for entry in self.meta.get("licences", ()))

    @property
    def stats(self) -> dict[str, Any]:
        """stats.json: per field, over the rows that train windows cover."""
        return self._side_files.stats

    @property
    def rejects(self) -> list[dict[str, Any]]:
        """rejects.jsonl: what the build left out, and why."""
        return self._side_files.rejects

    @property
    def quality(self) -> list[dict[str, Any]]:
        """Quality flags: by clip in stored order, and by time."""
        if self._description.format == 1:
            return self._side_files.quality
        return quality_rows(self)

    def __len__(self) -> int:
        """Return the number of clips."""
        return len(self.clips)

    def __bool__(self) -> bool:
        """Return True, also without clips."""
        return True

    def __iter__(self) -> Iterator[ClipView]:
        """Yield the clips, split by split, in stored order."""
        return iter(self.clips)

    def __getitem__(self, clip_id: str) -> ClipView:
        """Return a clip by id: ``ds["clip"]["edge151"]`` are its rows of a field."""
        return self.clip(clip_id)

    def __contains__(self, clip_id: object) -> bool:
        """Return whether there is a clip of this id."""
        return any(self.tables(split).find(str(clip_id)) is not None for split in self.splits)

    def to_pandas(self, table: str = "clips") -> DataFrame:
        """Return a table as a pandas DataFrame, for filters, plots, CSV and parquet (``df.to_parquet``).

        Parameters
        ----------
        table
            "clips": a row a clip, with free columns as "x/NAME", of whole numbers as Int64 where a clip has none;
            where fields are optional, with the names of those that it does not have as "without".
            "windows": clip, split, first frame and length.
            "rejects": what the build left out, and why. "quality": quality flags.

        Raises
        ------
        UsageError
            For another table.
        MissingPackageError
            Without pandas.
        """
        # By name: a store is read without pandas.
        frame: DataFrame = import_module("dancedata.store.tables_out").table(self, table)
        return frame

    def normalizer(self, field: str, mirror: bool = False) -> MinMax:
        """Return EDGE's min-max scaler of a field, fitted on train; with `mirror` it covers mirrored motion too.

        Raises
        ------
        StoreError
            If there are no train windows to fit it on.
        UsageError
            For a field of codes, or if the field has no mirror.
        """
        f = self.field(field)
        scaler = self._side_files.scaler(f)
        if not mirror:
            return scaler
        if f.columns.mirror is None:
            raise UsageError(f"field {field} cannot be mirrored", where=str(self.path))
        return scaler.with_mirror(f.columns.mirror)

    def zscore(self, field: str, *, grouped: bool = False) -> ZScore:
        """Return the scaler that subtracts the mean of train and divides by its standard deviation, for ``scaler=``.

        Parameters
        ----------
        field
            Name of the field.
        grouped
            Whether columns of a group, such as the positions, have one deviation: the mean of theirs, as HumanML3D's
            ``Std.npy`` (Guo et al. 2022, cal_mean_variance.ipynb).

        Raises
        ------
        StoreError
            If there are no train windows to fit it on.
        UsageError
            For a field of codes.
        """
        stored, numbers = self.normalizer(field), self.stats["fields"][field]
        std = np.array(numbers["std"])
        if grouped:
            columns = self._fields[field].columns
            for part in map(columns.slice, columns.names):
                std[part] = std[part].mean()
        return ZScore(
            numbers["mean"], std, dtype=stored.dtype, field=field, columns=stored.columns, dataset=stored.sha256
        )


def reopen(path: str, sha256: str, overlay: SegmentOverlay | None = None, stream: Stream | None = None) -> Store:
    """Open a dataset again, in another process; StoreError if it was replaced in the meantime."""
    store = open_store(path, stream=stream or False)
    store.overlay = overlay or store.overlay
    if store.reference[1] != sha256:
        raise rebuilt_error(store.path, "dataset.json has changed")
    return store
