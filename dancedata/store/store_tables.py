"""The fields, tables and files of an open store."""

import os
from collections.abc import Mapping
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from dancedata.core.columns import Columns
from dancedata.core.errors import DanceDataError, UsageError, did_you_mean, nearest
from dancedata.core.licence import Licence
from dancedata.core.text import shown
from dancedata.files.strict_json import read_json
from dancedata.store.dataset_json import Description, SplitRows
from dancedata.store.listed_file import ListedFile, SideFiles
from dancedata.store.schema import LOCAL_FILE, SEGMENTS_FILE, TABLES_FILE, Field, Kind, sort_splits
from dancedata.store.segment_overlay import SegmentOverlay
from dancedata.store.shard_reader import ShardReader
from dancedata.store.table_file import SegmentTable, read_segments, read_tables
from dancedata.store.tables import Tables

#: Largest local.json: a path.
_MAX_LOCAL = 1 << 16


class StoreTables:
    """Opens the tables when they are first needed, and finds clips in them."""

    def __init__(self, path: Path, description: Description, files: Mapping[str, ListedFile]) -> None:
        """Use `open_store` instead."""
        self.path = path
        self._description = description
        self._fields = {f.name: f for f in description.fields}
        self.fields: Mapping[str, Columns] = MappingProxyType({f.name: f.columns for f in description.fields})
        self.splits = sort_splits({s.split for s in description.shards})
        self.fps: int | Fraction = int(description.fps) if description.fps.denominator == 1 else description.fps
        self.skeleton = description.skeleton
        self.info = description.meta
        self.grid = description.grid
        self._side_files = SideFiles(path, description)
        self._files = files
        self._shard_readers = tuple(ShardReader(files[s.file], s, description.fields) for s in description.shards)
        self.overlay = SegmentOverlay()

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

    @property
    def rejects(self) -> list[dict[str, Any]]:
        """rejects.jsonl: what the build left out, and why."""
        return self._side_files.rejects

    @cached_property
    def _tables(self) -> Tables:
        """The tables of the dataset, read on first use; StoreError if they do not fit it."""
        return read_tables(self._files[TABLES_FILE], self._description)

    @cached_property
    def _segment_table(self) -> SegmentTable | None:
        """Columns of the segments, read on first use; None without any."""
        file = self._files.get(SEGMENTS_FILE)
        return None if file is None else read_segments(file, self._tables.n_clips, self._description)

    def _rows_of_split(self, split: str) -> SplitRows:
        """Return the rows of a split in the tables, and its shards; UsageError for an unknown one."""
        if split not in self.splits:
            raise UsageError(f"no split named {split!r}", where=str(self.path), fix=did_you_mean(split, self.splits))
        return self._description.splits[split]

    def _shards(self, split: str) -> tuple[ShardReader, ...]:
        """Return the readers of a split's shards."""
        return self._shard_readers[self._rows_of_split(split).shards]

    def _row(self, clip_id: str) -> int:
        """Return the row of a clip; UsageError with the closest id if there is none."""
        row = self._tables.find(clip_id) if isinstance(clip_id, str) else None
        if row is None:
            fix = nearest(str(clip_id), list(self._tables.ids), "clip", self.path)
            raise UsageError(f"no clip named {shown(clip_id)!r}", where=str(self.path), fix=fix)
        return row
