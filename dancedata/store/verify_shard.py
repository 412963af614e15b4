"""Checks of tables and shards whose bytes match dataset.json: layout, bounds, references, values."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import StoreError
from dancedata.core.text import listed, shown
from dancedata.store import hdf5
from dancedata.store.clip_columns import CLIP_COLUMNS
from dancedata.store.columns import Lists, Texts, text_problem
from dancedata.store.dataset import Store
from dancedata.store.dataset_json import Description, ShardEntry
from dancedata.store.schema import ALIGNMENT, FORMAT, TABLES_FILE, Field
from dancedata.store.segments import QUALITY
from dancedata.store.shard_plan import SHARED
from dancedata.store.shard_reader import ShardReader
from dancedata.store.tables import Tables
from dancedata.store.train_rows import train_masks
from dancedata.store.window_list import WindowList
from dancedata.store.windowing import locate_windows

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


#: Values checked at a time: they stay in the processor's cache.
_CHUNK_VALUES = 1 << 16
#: Rows of a table named in one message at most.
_SHOWN = 5
_UNREADABLE = (StoreError, ValueError, IndexError, TypeError, KeyError)


def verify_tables(store: Store, description: Description) -> Iterator[Problem]:
    """Yield the problems of the tables and segments of a dataset."""
    where = str(store.path / TABLES_FILE)
    try:
        tables = store._tables
        messages = [
            *_check_attributes(store, description),
            *_check_clips(tables, description),
            *_check_spans(tables, description),
            *_check_windows(tables, description),
            *_check_columns(tables),
            *_check_references(tables),
            *_check_groups(tables),
            *_check_segments(store, tables, description),
        ]
        yield from (Problem("error", where, message) for message in messages)
    except _UNREADABLE as error:
        yield Problem("error", where, f"it cannot be read: {error}")


def verify_shard(store: Store, description: Description, number: int) -> Iterator[Problem]:
    """Yield the problems of a shard's layout."""
    reader, messages = store._shard_readers[number], list[str]()
    try:
        messages += _check_layout(reader, description, description.shards[number])
    except _UNREADABLE as error:
        messages.append(f"it cannot be read: {error}")
    yield from (Problem("error", str(reader.path), message) for message in messages)


def verify_values(
    store: Store, f: Field, shards: Sequence[int], problems: list[Problem]
) -> Iterator[npt.NDArray[Any]]:
    """Yield the rows of a field that train windows cover; add values that are wrong to `problems`."""
    masks = train_masks(store, f)
    for number in shards:
        reader, is_train = store._shard_readers[number], store._description.shards[number].split == "train"
        try:
            mask = next((mask for k, mask in masks if k == number), None) if is_train else None
            layout = reader.layout(f.name)
            step = max(1, _CHUNK_VALUES // layout.width)
            for begin in range(0, layout.n_rows, step):
                rows = reader.rows(f.name, begin, min(step, layout.n_rows - begin))
                message = _value_problem(store._tables, number, f, begin, rows)
                if message:
                    problems.append(Problem("error", str(reader.path), message))
                    break
                if mask is not None and (chosen := mask[begin : begin + step]).any():
                    yield rows if chosen.all() else rows[chosen]
        except _UNREADABLE as error:
            problems.append(Problem("error", str(reader.path), f"it cannot be read: {error}"))


def _check_layout(reader: ShardReader, description: Description, entry: ShardEntry) -> Iterator[str]:
    with reader.opened() as file:
        yield from hdf5.wrong_attributes(
            file, ("format",), format=FORMAT, split=entry.split, fps=str(description.fps)
        )
        for f in description.fields:
            dataset = hdf5.find_dataset(file, f.path)
            yield from hdf5.wrong_attributes(dataset, ("rate",), rate=str(f.rate))
            if dataset.size and dataset.id.get_offset() % ALIGNMENT:
                yield f"/{f.path} begins at byte {dataset.id.get_offset()}, not a multiple of {ALIGNMENT}"
    reader.require_layout()


def _check_attributes(store: Store, description: Description) -> Iterator[str]:
    with hdf5.open_file(store.path / TABLES_FILE) as file:
        yield from hdf5.wrong_attributes(file, ("format", "fps"), format=FORMAT, fps=str(description.fps))
        yield from hdf5.wrong_attributes(file["windows"], ("length",), length=description.length)


def _check_clips(tables: Tables, description: Description) -> Iterator[str]:
    for column in CLIP_COLUMNS:
        for row in range(tables.n_clips) if column.name in tables.columns else ():
            problem = column.problem(tables.value(column, row))
            if problem:
                yield f"/clips/{column.name} of clip {tables.ids[row]!r}: {problem}"
                break
    for name in ("split", "file"):
        stated = [getattr(shard, name).encode() for shard in description.shards]
        bad = np.repeat(np.array(stated), np.diff(tables.shard_begin)) != tables.columns[name].values
        if bad.any():
            yield f"/clips/{name}: not that of the clip in dataset.json, in rows {_places(bad, tables)}"


def _check_references(tables: Tables) -> Iterator[str]:
    """Check that songs and clips that clips name exist; readers check numbers of clips, layers and licences."""
    songs, source = tables.songs.get("id", ()), tables.columns.get("source")
    originals = tables.ids.values[source.values == b""].tolist() if source is not None else []
    for name, what, allowed in (
        ("song", "songs that do not exist", songs),
        ("source", "clips that do not exist, or are copies", [text.decode() for text in originals]),
    ):
        bad = ~tables.columns[name].isin(["", *allowed]) if name in tables.columns else np.zeros(0, dtype=np.bool_)
        if bad.any():
            yield f"/clips/{name}: {what}, in rows {_places(bad, tables)}"


def _check_columns(tables: Tables) -> Iterator[str]:
    for table, columns in (("clips", tables.columns), ("groups", tables.groups), ("songs", tables.songs)):
        for name, column in columns.items():
            yield from _check_column(f"/{table}/{name}", column)


def _check_column(name: str, column: Any) -> Iterator[str]:
    if isinstance(column, Lists):
        if (np.diff(column.offset) < 0).any():
            yield f"{name}/offset: offsets do not ascend"
        column = column.values
    for row, text in enumerate(column) if isinstance(column, Texts) else ():
        problem = text_problem(text)
        if problem:
            yield f"{name}, row {row}: {problem}"
            return


def _check_groups(tables: Tables) -> Iterator[str]:
    """Check that dancers of a group are neighbours, in one shard, in their order, and share what groups share."""
    ids = tables.groups["id"].values if tables.groups else np.empty(0, dtype="S1")
    stated = tables.columns["group"].values if "group" in tables.columns else np.zeros(tables.n_clips, dtype="S1")
    bad = stated != np.append(ids, [b""])[tables.group_of]
    if bad.any() or len(set(ids.tolist())) < len(ids):
        places = f", in rows {_places(bad, tables)} of /clips" if bad.any() else ""
        yield f"/groups: not the groups that clips name, once each, as neighbours{places}"
        return
    both = sorted(set(tables.ids.values[stated == b""].tolist()) & set(ids.tolist())) if len(ids) else []
    if both:
        yield f"/groups: names that clips have which are no dancers: {listed([n.decode() for n in both], _SHOWN)}"
    for group, first in enumerate(np.asarray(tables.groups.get("first", ())).tolist()):
        name, count = f"group {ids[group].decode()}", int(tables.groups["count"][group])
        rows = list(range(first, first + count))
        if len(set(tables.shard_of(rows).tolist())) != 1:
            yield f"{name}: its clips are not in one shard"
            continue
        records = [tables.record(row) for row in rows]
        members = [record.member for record in records]
        if sorted(set(members)) != members or members[0] < 0 or int(tables.groups["n_source"][group]) < count:
            yield f"{name}: dancers {listed(members, _SHOWN)} of {int(tables.groups['n_source'][group])}"
        starts = [tables.window_start[tables.positions_of(row)].tolist() for row in rows]
        for what in SHARED:
            if len({getattr(record, what) for record in records}) > 1:
                yield f"{name}: dancers differ in {what}"
        if any(of_member != starts[0] for of_member in starts):
            yield f"{name}: dancers differ in their windows"
        for field, spans in tables.spans.items():
            if spans.offset is not None and len({int(spans.first[row]) for row in rows}) > 1:
                yield f"{name}: dancers do not share the rows of {field}"


def _check_segments(store: Store, tables: Tables, description: Description) -> Iterator[str]:
    """Check that segments are inside their clips, sorted, and their frames those of their times."""
    table = store._segment_table
    if table is None:
        return
    columns = table.columns
    for name, column in columns.items():
        yield from _check_column(f"/segments/{name}", column)
    clip, start, end = (np.asarray(columns[name], dtype=np.int64) for name in ("clip", "start", "end"))
    if (clip != np.repeat(np.arange(tables.n_clips), np.diff(table.first))).any():
        yield "/segments/first: not the rows of the clips"
    bad = (start >= end) | (end > tables.n_frames[clip])
    if bad.any():
        yield f"/segments: outside their clips, in rows {_places(bad, tables, clip)}"
    unusable = list(_check_contents(columns, tables, description))
    yield from unusable
    if unusable:
        return
    for row in range(tables.n_clips):
        for k, segment in zip(table.rows_of(row), store.segments(tables.ids[row]), strict=True):
            if segment.frames(description.grid, int(tables.n_frames[row])) != (start[k], end[k]):
                yield f"/segments: frames are not those of the times, in row {k}"
                return


def _check_contents(columns: Mapping[str, Any], tables: Tables, description: Description) -> Iterator[str]:
    """Check what a segment cannot be made of, and values and labels that say nothing."""
    n_texts, clip = np.diff(columns["texts"].offset), columns["clip"]
    flags = [number for number, layer in enumerate(description.layers) if layer.name == QUALITY]
    n_values = {name: np.diff(columns[name].offset) for name in ("texts_mirrored", "tokens")}
    checks = {name: ((n != 0) & (n != n_texts), "not as many as the texts") for name, n in n_values.items()} | {
        "end_s": (np.asarray(columns["end_s"]) < np.asarray(columns["start_s"]), "before start_s"),
        "value": (np.isinf(columns["value"]), "infinite"),
        "label": (np.isin(columns["layer"], flags) & columns["label"].isin([""]), "a quality flag without its kind"),
    }
    for name, (bad, problem) in checks.items():
        if bad.any():
            yield f"/segments/{name}: {problem}, in rows {_places(bad, tables, clip)}"


def _check_spans(tables: Tables, description: Description) -> Iterator[str]:
    """Check that motion spans follow one another, fill their shards, and have as many rows as their clips frames."""
    for f in description.fields:
        if not f.per_clip:
            continue
        spans = tables.spans[f.name]
        for number, shard in enumerate(description.shards):
            rows = slice(int(tables.shard_begin[number]), int(tables.shard_begin[number + 1]))
            start, length = spans.first[rows], spans.available[rows]
            ends = np.cumsum(length)
            n_rows = shard.fields[f.name][1]
            if (start != ends - length).any() or int(ends[-1]) != n_rows:
                problem = f"do not follow one another, or do not fill the {n_rows} rows"
                yield f"/clips/{f.path}: clips of {shard.file} {problem}"
        frames, rows_ = description.grid.common_period(f.grid)
        apart = np.abs(spans.available * frames - tables.n_frames.astype(np.int64) * rows_)
        bad = (apart >= max(frames, rows_)) & tables.has_rows(f)
        if bad.any():
            yield f"/clips/{f.path}: rows and frames do not match, in rows {_places(bad, tables)}"


def _check_windows(tables: Tables, description: Description) -> Iterator[str]:
    clip, start = (np.asarray(column, dtype=np.int64) for column in (tables.window_clip, tables.window_start))
    bad = (start < 0) | (start > np.asarray(tables.n_frames, dtype=np.int64)[clip] - description.length)
    if bad.any():
        yield f"/windows: outside their clip: windows {_places(bad, tables, clip)}"
    bad = start % description.stride != 0
    if bad.any():
        multiple = f"at a multiple of the stride, {description.stride} frames"
        yield f"/windows: not {multiple}: windows {_places(bad, tables, clip)}"
    later = (clip[1:] > clip[:-1]) | ((clip[1:] == clip[:-1]) & (start[1:] > start[:-1]))
    if not later.all():
        yield f"/windows: not by clip and start: windows {_places(np.append(False, ~later), tables, clip)}"
    windows = WindowList.equally_long("", tables.ids, clip, start, description.length)
    for f in description.fields if len(clip) else ():
        bad = locate_windows(tables, clip, windows, f, description.grid)[1] & tables.has_rows(f)[clip]
        if bad.any():
            yield f"/windows: rows of {f.name} are outside the field, in windows {_places(bad, tables, clip)}"


def _value_problem(tables: Tables, number: int, f: Field, begin: int, rows: npt.NDArray[Any]) -> str:
    """Return which rows, from row `begin` of a shard on, have values that are not finite, or no codes; "" if none."""
    good = np.isfinite(rows)
    if f.codebook is not None:
        good = ((rows >= 0) & (rows < np.array(f.codebook.sizes))) | (rows == f.codebook.pad)
    if good.all():
        return ""
    row, column = (int(i) for i in np.argwhere(~good)[0])
    clip = ""
    if f.per_clip:
        first, stop = (int(k) for k in tables.shard_begin[number : number + 2])
        starts = tables.spans[f.name].first[first:stop]
        clip = f" (clip {tables.ids[first + int(np.searchsorted(starts, begin + row, side='right')) - 1]})"
    problem = "not finite" if f.codebook is None else "not codes of their codebook"
    place = f"first row {begin + row}{clip}, column {f.columns.labels[column]}"
    return f"/{f.path}: {int((~good).sum())} values are {problem}, {place}"


def _places(bad: Any, tables: Tables, clip: Any = None) -> str:
    """Name rows of a table, and the clip of the first; `clip` are the rows of their clips, where it is no /clips."""
    rows = np.flatnonzero(bad)
    first = int(rows[0] if clip is None else clip[rows[0]])
    return f"{listed(rows, _SHOWN)} (clip {tables.ids[first]})"
