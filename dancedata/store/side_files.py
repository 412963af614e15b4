"""The files beside the shards: stats.json, rejects.jsonl and quality.jsonl, each read when it is first asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.text import shown
from dancedata.store.dataset_json import (
    MAX_BYTES,
    MAX_LINES_BYTES,
    REBUILD,
    Description,
    json_quality,
    json_rejects,
    json_stats,
)
from dancedata.store.listed_file import read_listed
from dancedata.store.normalize import MinMax
from dancedata.store.schema import QUALITY_FILE, REJECTS_FILE, STATS_FILE, Field, sort_splits

T = TypeVar("T")


class SideFiles:
    """The side files of an open store; StoreError for one that cannot be read."""

    def __init__(self, folder: Path, description: Description) -> None:
        self._folder, self._description = folder, description

    @cached_property
    def stats(self) -> dict[str, Any]:
        """stats.json."""
        return self._load(STATS_FILE, json_stats, MAX_BYTES)

    @cached_property
    def rejects(self) -> list[dict[str, Any]]:
        """rejects.jsonl."""
        return self._load(REJECTS_FILE, json_rejects, MAX_LINES_BYTES)

    @cached_property
    def quality(self) -> list[dict[str, Any]]:
        """quality.jsonl."""
        return self._load(QUALITY_FILE, json_quality, MAX_LINES_BYTES)

    def scaler(self, f: Field) -> MinMax:
        """Return the min-max scaler of a field that stats.json holds; StoreError if there is none."""
        if f.name not in self.stats["fields"]:
            raise StoreError(
                "there is no scaler without train windows",
                where=str(self._folder),
                found=f"splits {', '.join(sort_splits({s.split for s in self._description.shards}))}",
                fix="pass normalize=False, or build with a train split",
            )
        try:
            state = self.stats["fields"][f.name]["scaler"]
            scaler = MinMax.from_state(state, dtype=f.dtype, field=f.name, columns=f.columns.labels)
            scaler.dataset = scaler.sha256
            found = f"{scaler.width} columns"
        except (KeyError, TypeError, ValueError, OverflowError, UsageError) as error:
            scaler, found = None, shown(error)
        if scaler is None or scaler.width != f.columns.width:
            raise StoreError(
                f"the scaler of field {f.name} cannot be used",
                where=str(self._folder / STATS_FILE),
                found=found,
                allowed=f"data_min and data_max of {f.columns.width} columns",
                fix=REBUILD,
            )
        return scaler

    def _load(self, name: str, parse: Callable[[str], T], limit: int) -> T:
        try:
            return parse(read_listed(self._folder, self._description, name, limit))
        except (OSError, ValueError) as error:
            where = str(self._folder / name)
            raise StoreError(f"{name} cannot be read", where=where, found=str(error), fix=REBUILD) from error
