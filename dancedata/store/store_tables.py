"""The fields, tables and files of an open store."""

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any

from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError, did_you_mean, nearest
from dancedata.core.licence import Licence
from dancedata.store.dataset_json import Description
from dancedata.store.listed_file import ListedFile, SideFiles
from dancedata.store.schema import Field, Kind, sort_splits
from dancedata.store.segment_overlay import SegmentOverlay
from dancedata.store.shard_reader import ShardReader
from dancedata.store.table_file import SegmentTable, read_tables
from dancedata.store.tables import Tables


class StoreTables:
    """Opens the tables of splits when they are first needed, and finds clips in them."""

    def __init__(self, path: Path, description: Description, files: Mapping[str, ListedFile]) -> None:
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
        self.grid = description.grid
        self._side_files = SideFiles(path, description)
        self._files = files
        self._shards: dict[str, tuple[ShardReader, ...]] = {
            split: tuple(
                ShardReader(files[s.file], s, description.fields)
                for s in description.shards
                if s.split == split and s.file in files  # `check` opens one split, whose files are not damaged
            )
            for split in self.splits
        }
        self._tables: dict[str, Tables] = {}
        self._segments: dict[str, SegmentTable | None] = {}
        self.overlay = SegmentOverlay()

    def field(self, name: str) -> Field:
        """Return a field by name; UsageError with the closest name if there is none."""
        if name not in self._fields:
            raise UsageError(f"no field named {name!r}", where=str(self.path), fix=did_you_mean(name, self._fields))
        return self._fields[name]

    @property
    def required_fields(self) -> tuple[str, ...]:
        """Names of the fields that every clip has."""
        return tuple(name for name, f in self._fields.items() if not f.optional)

    @property
    def optional_fields(self) -> tuple[str, ...]:
        """Names of the fields that a clip may not have."""
        return tuple(name for name, f in self._fields.items() if f.optional)

    def fields_with(self, *groups: str, kind: Kind = "audio") -> tuple[Field, ...]:
        """Return the fields of a kind that have these groups of columns, such as "beat", in the dataset's order."""
        return tuple(f for f in self._fields.values() if f.kind == kind and set(groups) <= set(f.columns.names))

    @property
    def licences(self) -> tuple[Licence, ...]:
        """Terms of clips that differ from the dataset's, numbered as in `ClipRecord.licence`."""
        return tuple(Licence(entry["licence"], entry["citation"]) for entry in self.meta.get("licences", ()))

    @property
    def rejects(self) -> list[dict[str, Any]]:
        """rejects.jsonl: what the build left out, and why."""
        return self._side_files.rejects

    def tables(self, split: str) -> Tables:
        """Return the tables of a split: columns of its clips and windows, read on first use.

        Raises UsageError: for an unknown split.
        Raises StoreError: if the tables do not fit the dataset.
        """
        if split not in self._shards:
            raise UsageError(f"no split named {split!r}", where=str(self.path), fix=did_you_mean(split, self.splits))
        if split not in self._tables:
            entry = self._description.splits[split]
            self._tables[split] = read_tables(self._files[entry.tables.file], self._description, split)
        return self._tables[split]

    def shards(self, split: str) -> tuple[ShardReader, ...]:
        """Return the readers of a split's shards."""
        return self._shards[split]

    def _place(self, clip_id: str) -> tuple[Tables, int]:
        """Find a clip's tables and row, split by split: training does not read the tables of test."""
        for split in sorted(self.splits, key=lambda split: split not in self._tables):
            row = self.tables(split).find(clip_id)
            if row is not None:
                return self.tables(split), row
        clip_ids = [clip for split in self.splits for clip in self.tables(split).ids]
        fix = nearest(clip_id, clip_ids, "clip", self.path)
        raise UsageError(f"no clip named {clip_id!r}", where=str(self.path), fix=fix)
