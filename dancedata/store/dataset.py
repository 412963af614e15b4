"""Store: a built dataset, read with numpy only."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.columns import Columns
from dancedata.core.errors import StoreError, UsageError, did_you_mean
from dancedata.core.normalize import MinMax
from dancedata.core.text import shown
from dancedata.store.clip_view import Clips, ClipView
from dancedata.store.dataset_json import (
    MAX_BYTES,
    MAX_LINES_BYTES,
    REBUILD,
    Description,
    json_quality,
    json_rejects,
    json_stats,
    self_hash,
)
from dancedata.store.described import DescribedFile, built_again, open_described, read_described
from dancedata.store.locate import RowSpan, locate_stored, locate_view
from dancedata.store.mapped import WindowRows, locate_windows
from dancedata.store.rewindow import Cut, cut_windows, stored_windows, wanted_cut
from dancedata.store.schema import (
    QUALITY_FILE,
    REJECTS_FILE,
    STATS_FILE,
    ClipRecord,
    Field,
    RowRate,
    sort_splits,
)
from dancedata.store.shard_reader import ShardReader
from dancedata.store.window_list import WindowList


def open_store(path: str | Path) -> Store:
    """Open a built dataset; reads dataset.json and looks at the sizes of the shards.

    Parameters
    ----------
    path
        Folder that a build wrote.

    Returns
    -------
    Store
        Everything else is read when asked for.

    Raises
    ------
    StoreError
        If there is no finished dataset, it has another format version, or a shard is missing or of
        another size.

    Examples
    --------
    >>> import dancedata
    >>> ds = dancedata.open("data/aistpp")
    >>> ds.read(ds.windows("train")[3], "edge151").shape
    (150, 151)
    """
    folder = Path(path).expanduser().absolute()
    return Store(folder, *open_described(folder))


class Store:
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
        Frames a second of window starts and lengths: int if whole, else Fraction.
    scope
        "track": windows are views of clips. "window": each window has rows of its own.
    skeleton
        The motion's skeleton.
    meta
        dataset.json.
    """

    def __init__(self, path: Path, description: Description, files: Mapping[str, DescribedFile]) -> None:
        """Use `open_store` instead."""
        self.path = path
        self._description = description
        self._fields = {f.name: f for f in description.fields}
        self.fields: Mapping[str, Columns] = MappingProxyType({f.name: f.columns for f in description.fields})
        self.splits = sort_splits({s.split for s in description.shards})
        self.fps: int | Fraction = int(description.fps) if description.fps.denominator == 1 else description.fps
        self.scope = description.scope
        self.skeleton = description.skeleton
        self.meta = description.meta
        self._rates: dict[str, RowRate] = {f.name: f.row_rate(description.fps) for f in description.fields}
        self._shards: dict[str, tuple[ShardReader, ...]] = {
            split: tuple(
                ShardReader(files[s.file], s.split, description.fields, description.scope)
                for s in description.shards
                if s.split == split
            )
            for split in self.splits
        }
        self._places: dict[str, dict[str, tuple[ShardReader, int]]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a path: the other process opens the dataset again, and refuses one rebuilt meanwhile."""
        return reopen, self.reference

    @cached_property
    def reference(self) -> tuple[str, str]:
        """What `reopen` takes: the path, and a hash of dataset.json."""
        return str(self.path), self_hash(self.meta)

    def __repr__(self) -> str:
        """Say where it is and what it holds."""
        return f"Store({str(self.path)!r}, splits={self.splits}, fields={tuple(self.fields)}, fps={self.fps})"

    def __enter__(self) -> Self:
        """Use as a context manager to give files back at the end."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the files."""
        self.close()

    def close(self) -> None:
        """Give file descriptors back; a later read opens them again."""
        for shards in self._shards.values():
            for shard in shards:
                shard.close()

    def field(self, name: str) -> Field:
        """Return a field by name; UsageError with the closest name if there is none."""
        if name not in self._fields:
            raise UsageError(f"no field named {name!r}", where=str(self.path), fix=did_you_mean(name, self._fields))
        return self._fields[name]

    @property
    def clips(self) -> Clips:
        """All clips: split by split, in stored order. They are those that `clip` gives."""
        return Clips(self, self._records)

    @cached_property
    def _records(self) -> tuple[ClipRecord, ...]:
        return tuple(r for split in self.splits for shard in self._shards[split] for r in shard.clips.records)

    def clip(self, clip_id: str) -> ClipView:
        """Return a clip by id; UsageError with the closest id if there is none."""
        shard, number = self._place(clip_id)
        return ClipView(self, shard.clips.records[number])

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
    ) -> WindowList:
        """List the windows of a split, in the store's order: shard by shard.

        Parameters
        ----------
        split
            One of `splits`.
        length_s, length_frames, stride_s, stride_frames
            Other windows than the stored ones (track scope only): one of each; what is left out is as stored.
            The stored length and stride give the stored windows.
        fields
            Fields that the other windows must be whole rows of and lie within. Default: all.
        trim
            Begin at every clip's trim_start: leave out what the source says should be cut (track scope only).

        Returns
        -------
        WindowList
            A Sequence[Window].

        Raises
        ------
        UsageError
            For an unknown split, two lengths or strides, or ones that are no whole number of frames and rows.
        StoreError
            For another length or stride in window scope.
        """
        if split not in self._shards:
            raise UsageError(f"no split named {split!r}", where=str(self.path), fix=did_you_mean(split, self.splits))
        cut = wanted_cut(self._description, length_s, length_frames, stride_s, stride_frames)
        shards = self._shards[split]
        if cut is None and not trim:
            return stored_windows(split, shards)
        cut = cut or Cut(self._description.length, self._description.stride)
        if self.scope == "window":
            raise StoreError(
                "a store of window scope has no other windows than the stored ones",
                where=str(self.path),
                found=f"length {cut.length}, stride {cut.stride} frames" + (", trimmed" if trim else ""),
                allowed=f"length {self._description.length}, stride {self._description.stride} frames",
                fix="build with scope: track",
            )
        rates = {self.field(name).name: self._rates[name] for name in (fields or self._fields)}
        return cut_windows(split, shards, self._description, cut, rates, trim)

    def read(self, window: Window, field: str) -> npt.NDArray[Any]:
        """Read a window's rows of a field.

        Parameters
        ----------
        window
            Of `windows`; in track scope any that lies within its clip.
        field
            Name of a field.

        Returns
        -------
        ndarray
            (length * rate / fps, D) in the field's dtype: fresh, writable.
        """
        span = self.locate(window, field)
        f = self._fields[field]
        out = np.empty((span.length, f.columns.width), dtype=f.disk_dtype)
        span.shard.read_rows(field, span.first, out)
        return out

    def read_into(self, window: Window, field: str, out: npt.NDArray[Any]) -> None:
        """Read a window's rows of a field into `out`, (length * rate / fps, D), converting to its dtype."""
        span = self.locate(window, field)
        wanted = (span.length, self._fields[field].columns.width)
        if out.shape != wanted:
            raise UsageError("the array to read into has the wrong shape", found=out.shape, allowed=wanted)
        span.shard.read_rows(field, span.first, out)

    def locate(self, window: Window, field: str) -> RowSpan:
        """Find the shard and the rows of a window, for readers that map files themselves.

        Raises
        ------
        UsageError
            For an unknown clip or field, or a window that is no whole number of rows or leaves its clip; for
            anything but a Window.
        StoreError
            In window scope, for a window that is not stored.
        """
        if not isinstance(window, Window):
            raise UsageError(
                "a window is asked for",
                where=str(self.path),
                found=shown(window),
                fix='take one of ds.windows("train"); a whole clip is ds.clip(ID).read(FIELD)',
            )
        f, rate = self.field(field), self._rates[field]
        shard, number = self._place(window.clip)
        if self.scope == "window":
            return locate_stored(shard, number, window, f, rate)
        return locate_view(shard, number, window, f, rate)

    def window_rows(self, windows: WindowList, field: str, *, mapped: bool = True) -> WindowRows:
        """Find a field's rows of many windows of equal length at once, for readers that copy from mapped files.

        Raises
        ------
        UsageError, StoreError
            As `locate`, for the first window that the store does not have; if there are no windows.
        """
        f, rate = self.field(field), self._rates[field]
        if not len(windows):
            raise UsageError("there are no windows to find rows of", where=str(self.path), found=f"field {field}")
        places = [self._place(clip) for clip in windows.clip_ids]
        shards, shard, first, bad = locate_windows(windows, places, f, rate, self.scope)
        if bad.any():
            self.locate(windows[int(np.argmax(bad))], field)
        return WindowRows(field, shards, shard, first, rate.rows(int(windows.length[0])), mapped)

    def read_clip(self, clip_id: str, field: str) -> npt.NDArray[Any]:
        """Read all rows of a field that belong to a clip; see `ClipView.read`."""
        f = self.field(field)
        shard, number = self._place(clip_id)
        if self.scope == "window":
            raise StoreError(
                "a store of window scope does not hold whole clips",
                where=f"clip {clip_id}",
                fix="read its windows, or build with scope: track",
            )
        table = shard.clips
        rows = int(table.available[field][number])
        if f.kind == "audio":
            rows = max(0, min(rows, self._rates[field].rows_up(table.records[number].n_frames)))
        out = np.empty((rows, f.columns.width), dtype=f.disk_dtype)
        shard.read_rows(field, int(table.first[field][number]), out)
        return out

    def _place(self, clip_id: str) -> tuple[ShardReader, int]:
        """Find a clip's shard and row, split by split: a train job never reads the tables of test."""
        for split in self.splits:
            if split in self._places and clip_id in self._places[split]:
                return self._places[split][clip_id]
        for split in self.splits:
            if split not in self._places:
                self._places[split] = {
                    record.id: (shard, number)
                    for shard in self._shards[split]
                    for number, record in enumerate(shard.clips.records)
                }
                if clip_id in self._places[split]:
                    return self._places[split][clip_id]
        known = [clip for split in self.splits for clip in self._places[split]]
        raise UsageError(f"no clip named {clip_id!r}", where=str(self.path), fix=did_you_mean(clip_id, known))

    @cached_property
    def stats(self) -> dict[str, Any]:
        """stats.json: per field, over the rows that train windows cover."""
        loaded: dict[str, Any] = self._load(STATS_FILE, json_stats, MAX_BYTES)
        return loaded

    @cached_property
    def rejects(self) -> list[dict[str, Any]]:
        """What was left out, and why: rejects.jsonl."""
        return list(self._load(REJECTS_FILE, json_rejects, MAX_LINES_BYTES))

    @cached_property
    def quality(self) -> list[dict[str, Any]]:
        """Quality flags: quality.jsonl."""
        return list(self._load(QUALITY_FILE, json_quality, MAX_LINES_BYTES))

    def normalizer(self, field: str, mirror: bool = False) -> MinMax:
        """Make EDGE's min-max scaler of a field, fitted on train.

        Parameters
        ----------
        field
            Name of a field.
        mirror
            Whether its range covers mirrored motion too.

        Raises
        ------
        StoreError
            If there are no train windows to fit it on.
        UsageError
            If the field has no mirror.
        """
        f = self.field(field)
        if field not in self.stats["fields"]:
            raise StoreError(
                "there is no scaler without train windows",
                where=str(self.path),
                found=f"splits {', '.join(self.splits)}",
                fix="pass normalize=False, or build with a train split",
            )
        try:
            plain = MinMax.from_state(self.stats["fields"][field]["scaler"])
            found = f"{plain.width} columns"
        except (KeyError, TypeError, ValueError, OverflowError, UsageError) as error:
            plain, found = None, shown(error)
        if plain is None or plain.width != f.columns.width:
            raise StoreError(
                f"the scaler of field {field} cannot be used",
                where=str(self.path / STATS_FILE),
                found=found,
                allowed=f"data_min and data_max of {f.columns.width} columns",
                fix=REBUILD,
            )
        if not mirror:
            return plain
        if f.columns.mirror is None:
            raise UsageError(f"field {field} cannot be mirrored", where=str(self.path))
        return plain.with_mirror(f.columns.mirror)

    def _load(self, name: str, parse: Any, limit: int) -> Any:
        path = self.path / name
        try:
            return parse(read_described(self.path, self._description, name, limit))
        except (OSError, ValueError) as error:
            raise StoreError(f"{name} cannot be read", where=str(path), found=str(error), fix=REBUILD) from error


def reopen(path: str, sha256: str) -> Store:
    """Open a dataset again, in another process; StoreError if another one is there by now."""
    store = open_store(path)
    if store.reference[1] != sha256:
        raise built_again(store.path, "another dataset.json than then")
    return store
