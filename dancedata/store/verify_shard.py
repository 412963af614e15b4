"""Checks of one shard whose bytes match dataset.json: layout, bounds, finiteness."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dancedata.core.errors import StoreError
from dancedata.core.text import listed, shown
from dancedata.store import hdf5
from dancedata.store.clip_columns import CLIP_COLUMNS, ClipRecord
from dancedata.store.dataset_json import Description, ShardEntry
from dancedata.store.listed_file import ListedFile
from dancedata.store.schema import ALIGNMENT, FORMAT, Field
from dancedata.store.shard_reader import ShardReader
from dancedata.store.shard_tables import ClipTable, StoredWindows

#: Most characters of a path and of a message.
_MAX_WHERE, _MAX_MESSAGE = 4400, 3000


@dataclass(frozen=True)
class Problem:
    """An error or a note, and the file or place it is about.

    Its texts come from foreign files: they are cut, and characters that do not print become backslash sequences.
    """

    severity: Literal["error", "note"]
    where: str
    message: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "where", shown(self.where, _MAX_WHERE))
        object.__setattr__(self, "message", shown(self.message, _MAX_MESSAGE))

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.message}"

    def to_json(self) -> dict[str, str]:
        """Return it as JSON."""
        return {"severity": self.severity, "where": self.where, "message": self.message}


#: Values checked at a time.
_CHUNK_VALUES = 1 << 20
#: Rows of a table named in one message at most.
_SHOWN = 5


def verify_shard(
    path: Path, description: Description, entry: ShardEntry
) -> tuple[list[Problem], Sequence[ClipRecord]]:
    """Return the problems of a shard, and its clips as far as they can be read."""
    try:
        with hdf5.open_file(path) as file:
            messages = list(_check_layout(file, description, entry))
        # Before the tables are read: the reader stops at the first wrong span, with a less detailed message.
        messages = messages or list(_check_spans(path, description))
        if messages:
            return [Problem("error", str(path), m) for m in messages], ()
        file = ListedFile(path, entry.size, entry.sha256, os.stat(path))
        reader = ShardReader(file, entry.split, description.fields, description.scope)
        clips, windows = reader.clips, reader.windows
        messages = [*_check_clips(clips)]
        messages += _check_windows(reader, clips, windows, description)
        for f in description.fields:
            messages += _check_values(reader, clips, f)
    except (StoreError, UnicodeDecodeError, ValueError, IndexError, TypeError) as error:
        return [Problem("error", str(path), f"it cannot be read: {error}")], ()
    return [Problem("error", str(path), m) for m in messages], clips.records


def _check_layout(file: Any, description: Description, entry: ShardEntry) -> Iterator[str]:
    """Check names, dtypes, shapes, contiguity and alignment of every dataset."""
    if int(file.attrs.get("format", -1)) != FORMAT:
        yield f"attribute format is {file.attrs.get('format')}, not {FORMAT}"
    for path, (dtype, rows) in _expected(description, entry).items():
        dataset = file.get(path)
        if dataset is None or not getattr(dataset, "shape", None):
            yield f"/{path} is missing"
            continue
        wrong = dataset.dtype.kind != "S" if dtype is None else dataset.dtype != dtype
        if wrong:
            yield f"/{path} is of type {dataset.dtype}, not {dtype or 'fixed-length text'}"
        if dataset.shape[:1] != (rows,) and rows is not None:
            yield f"/{path} has shape {dataset.shape}, not {rows} rows"
        offset = dataset.id.get_offset()
        if dataset.size and offset is None:
            yield f"/{path} is not contiguous"
        elif dataset.size and offset % ALIGNMENT:
            yield f"/{path} begins at byte {offset}, not a multiple of {ALIGNMENT}"
        elif not wrong:
            hdf5.find_dataset(file, path)


def _expected(description: Description, entry: ShardEntry) -> dict[str, tuple[Any, int | None]]:
    """Return for each dataset its dtype (None: text) and number of rows (None: any)."""
    whole = np.dtype("<i8")
    shapes: dict[str, tuple[Any, int | None]] = {
        f"clips/{column.name}": (column.type.dtype, entry.clips) for column in CLIP_COLUMNS
    }
    shapes |= {f"windows/{n}": (whole, entry.windows) for n in ("clip", "start", "length", "index")}
    for f in description.fields:
        shapes[f.path] = (f.disk_dtype, None)
        shapes[f"windows/rows/{f.name}"] = (whole, entry.windows)
        if f.per_clip or description.scope == "track":
            shapes |= {f"clips/{f.path}/{name}": (whole, entry.clips) for name in f.span_columns}
    return shapes


def _check_clips(clips: ClipTable) -> Iterator[str]:
    for column in CLIP_COLUMNS:
        for record in clips.records:
            problem = column.type.problem(getattr(record, column.name))
            if problem:
                yield f"/clips/{column.name} of clip {record.id!r}: {problem}"


def _check_spans(path: Path, description: Description) -> Iterator[str]:
    """Check that motion spans follow one another and fill the field, and audio spans are within it."""
    with hdf5.open_file(path) as file:
        for f in description.fields:
            if f.kind == "audio" and description.scope == "window":
                continue
            name = f"/clips/{f.path}"
            start, length = (file[f"{name}/{c}"][...] for c in ("start", "length"))
            n_rows = file[f.path].shape[0]
            if f.per_clip:
                ends = np.cumsum(length)
                if (length < 0).any() or (start != ends - length).any() or ends[-1] != n_rows:
                    yield f"{name}: clips do not follow one another, or do not fill the {n_rows} rows"
                continue
            offset = file[f"{name}/offset"][...]
            bad = (start < 0) | (length < 0) | (start + length > n_rows) | (offset < 0) | (offset > length)
            if bad.any():
                yield f"{name}: spans outside the {n_rows} rows, for clips {_places(bad)}"


def _check_windows(
    reader: ShardReader, clips: ClipTable, windows: StoredWindows, description: Description
) -> Iterator[str]:
    n_frames = np.asarray([r.n_frames for r in clips.records], dtype=np.int64)[windows.clip]
    bad = (windows.start < 0) | (windows.start + windows.length > n_frames)
    bad |= windows.length != description.length
    if bad.any():
        yield f"/windows: of another length, or outside their clip: windows {_places(bad)}"
    clip, start = windows.clip[windows.by_start], windows.start[windows.by_start]
    if ((clip[1:] == clip[:-1]) & (start[1:] == start[:-1])).any():
        yield "/windows: a clip has two windows that begin at one frame"
    rank = np.arange(len(clip)) - windows.clip_begin[clip]
    bad = windows.index[windows.by_start] != rank
    if bad.any():
        yield f"/windows/index: not the window's number in its clip, in {int(bad.sum())} windows"
    for f in description.fields:
        message = _check_rows(reader, clips, windows, f, description)
        if message:
            yield message


def _check_rows(
    reader: ShardReader, clips: ClipTable, windows: StoredWindows, f: Field, description: Description
) -> str:
    """Check the first rows of all windows: inside the clip's span and the field."""
    length = description.grid.rows_down(description.length, of=f.grid)
    rows = windows.rows[f.name]
    if f.name not in clips.first:
        bad = (rows < 0) | (rows + length > reader.layout(f.name).n_rows)
    elif description.scope == "track":
        inside, whole = description.grid.rows_of_all(windows.start, of=f.grid)
        bad = ~whole | (rows != clips.first[f.name][windows.clip] + inside)
        bad |= inside + length > clips.available[f.name][windows.clip]
    else:
        bad = rows != clips.first[f.name][windows.clip] + windows.index * length
        bad |= (windows.index + 1) * length > clips.available[f.name][windows.clip]
    return f"/windows/rows/{f.name}: wrong or outside the field, in windows {_places(bad)}" if bad.any() else ""


def _check_values(reader: ShardReader, clips: ClipTable, f: Field) -> Iterator[str]:
    """Check that all values are finite; read by position, a piece at a time."""
    layout = reader.layout(f.name)
    step = max(1, _CHUNK_VALUES // layout.width)
    for begin in range(0, layout.n_rows, step):
        rows = np.empty((min(step, layout.n_rows - begin), layout.width), dtype=layout.dtype)
        reader.read_rows(f.name, begin, rows)
        finite = np.isfinite(rows)
        if not finite.all():
            row, column = (int(i) for i in np.argwhere(~finite)[0])
            clip = ""
            if f.per_clip:
                number = int(np.searchsorted(clips.first[f.name], begin + row, side="right")) - 1
                clip = f" (clip {clips.records[number].id})"
            yield (
                f"/{f.path}: {int((~finite).sum())} values are not finite, first row {begin + row}"
                f"{clip}, column {f.columns.labels[column]}"
            )
            return


def _places(bad: Any) -> str:
    return listed(np.flatnonzero(bad), _SHOWN)
