"""Reads the tables /clips and /windows of format 1, which every shard holds for itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.store import hdf5
from dancedata.store.dataset_json import Description
from dancedata.store.shard_reader import ShardReader
from dancedata.store.table_columns import TextColumn
from dancedata.store.tables import FieldSpans, Tables, broken, check_frames, check_spans
from dancedata.store.window_list import IntArray

#: Columns of format 1, with their kinds of numpy types; texts have a fixed length.
_TEXTS = ("id", "genre", "music", "dancer", "source", "source_rate", "lists")
_NUMBERS = {"tempo_bpm": "f", "height_m": "f", "n_frames": "iu", "n_flags": "iu", "trim_start": "iu"}
COLUMNS: Mapping[str, str] = {**dict.fromkeys(_TEXTS, "S"), **_NUMBERS}
#: Columns that the first version of dancedata did not write, with the value of its clips.
LATER_COLUMNS: Mapping[str, Any] = {"source_rate": "", "height_m": np.nan}
#: Between the entries of /clips/lists.
_SEPARATOR = "\n"


def read_shard_tables(readers: Sequence[ShardReader], description: Description, split: str) -> Tables:
    """Read the tables of all shards of a split, and join them.

    StoreError for columns that are missing or of another type, windows of clips that do not exist, and clips whose
    rows lie outside their field.
    """
    parts = [_ShardTable(reader, description) for reader in readers]
    begin = np.cumsum([0, *(part.n_clips for part in parts)], dtype=np.int64)
    columns: dict[str, Any] = {name: np.concatenate([part.columns[name] for part in parts]) for name in _NUMBERS}
    for name in _TEXTS:
        columns[name] = [text for part in parts for text in part.columns[name]]
    columns["id"] = TextColumn.of(columns["id"])
    columns["lists"] = [tuple(filter(None, text.split(_SEPARATOR))) for text in columns["lists"]]
    made_of = _made_of(description)
    if made_of:
        columns["made_of"] = [made_of.get(clip, bytes(18)) for clip in columns["id"]]
    spans = {
        name: FieldSpans(
            np.concatenate([part.spans[name].first for part in parts]),
            np.concatenate([part.spans[name].available for part in parts]),
            _joined([part.spans[name].offset for part in parts]),
        )
        for name in parts[0].spans
    }
    windows = {name: np.concatenate([part.windows[name] for part in parts]) for name in parts[0].windows}
    clip = np.concatenate([part.windows["clip"] + first for part, first in zip(parts, begin[:-1], strict=True)])
    rows = {f.name: windows[f"rows/{f.name}"] for f in description.fields} if description.scope == "window" else {}
    return Tables(split, columns, {}, spans, begin, clip, windows["start"], description.length, rows)


def _made_of(description: Description) -> dict[str, bytes]:
    """Return the hashes of each clip's source, which format 1 has in dataset.json."""
    source = description.meta.get("source")
    clips = source.get("clips") if isinstance(source, Mapping) else None
    hashes = {}
    for clip, text in clips.items() if isinstance(clips, Mapping) else ():
        parts = str(text).replace("-", "0" * 12).split()
        if [len(part) for part in parts] == [12, 12, 12] and set("".join(parts)) <= set("0123456789abcdef"):
            hashes[str(clip)] = bytes.fromhex("".join(parts))
    return hashes


def _joined(offsets: Sequence[IntArray | None]) -> IntArray | None:
    present = [offset for offset in offsets if offset is not None]
    return np.concatenate(present) if present else None


class _ShardTable:
    """The tables of one shard. All columns of a table hold equally many values."""

    def __init__(self, reader: ShardReader, description: Description) -> None:
        self._path: Path = reader.path
        self._n_rows: dict[str, int] = {}
        n_rows = {f.name: reader.layout(f.name).n_rows for f in description.fields}
        with reader.opened() as file:
            self._file = file
            self.columns = {
                name: self._column(f"clips/{name}", COLUMNS[name]) for name in COLUMNS if name not in LATER_COLUMNS
            }
            self.n_clips = self._n_rows["clips"]
            clips = file["clips"]  # a group of this file, as columns have been read
            for name, missing in LATER_COLUMNS.items():
                exists = clips.id.links.exists(name.encode())
                filled = [missing] * self.n_clips
                self.columns[name] = self._column(f"clips/{name}", COLUMNS[name]) if exists else filled
            check_frames(self.columns, str(self._path))
            self.spans = {}
            for f in description.fields:
                if f.per_clip or description.scope == "track":
                    names = [f"clips/{f.path}/{name}" for name in f.span_columns]
                    start, length, *offset = (self._whole(name) for name in names)
                    rows = np.full(self.n_clips, n_rows[f.name])
                    where = str(self._path)
                    self.spans[f.name] = check_spans(f, start, length, offset[0] if offset else None, rows, where)
            names = ["clip", "start", "length", "index", *(f"rows/{f.name}" for f in description.fields)]
            self.windows = {name: self._whole(f"windows/{name}") for name in names}
        del self._file
        clip = self.windows["clip"]
        if len(clip) and (int(clip.min()) < 0 or int(clip.max()) >= self.n_clips):
            actual, where = f"{clip.min()} to {clip.max()}", f"{self._path}, /windows/clip"
            raise broken(where, "windows of clips that do not exist", actual, f"0 to {self.n_clips - 1}")
        other = self.windows["length"] != description.length
        if other.any():
            lengths = sorted({int(n) for n in self.windows["length"]})
            raise broken(str(self._path), "the windows of a split differ in length", lengths, description.length)

    def _whole(self, name: str) -> IntArray:
        return np.asarray(self._column(name, "iu"), dtype=np.int64)

    def _column(self, name: str, kinds: str) -> Any:
        column = hdf5.find_dataset(self._file, name)
        table = name.partition("/")[0]
        n_rows = self._n_rows.setdefault(table, column.shape[0] if column.ndim else 0)
        if column.shape != (n_rows,) or column.dtype.kind not in kinds:
            problem = "a column of a shard's table has another shape or type"
            actual, allowed = f"{column.shape} {column.dtype}", f"({n_rows},), one value per row"
            raise broken(f"{self._path}, /{name}", problem, actual, allowed)
        return hdf5.read_strings(column) if kinds == "S" else column[...]
