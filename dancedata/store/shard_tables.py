"""The tables of a shard: /clips and /windows, read through h5py."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.errors import StoreError
from dancedata.store import hdf5
from dancedata.store.clip_columns import CLIP_COLUMNS, ClipColumn, ClipRecord
from dancedata.store.schema import Field
from dancedata.store.window_list import IntArray


@dataclass(frozen=True)
class ClipTable:
    """The table /clips of a shard.

    Attributes
    ----------
    records
        One per clip, in stored order.
    first, available
        Per field: row in the shard of each clip's frame 0, and rows from there to the end of the clip or
        timeline. Audio fields of window scope have none.
    offset
        Per audio field of track scope: rows of its timeline before each clip's frame 0.
    """

    records: tuple[ClipRecord, ...]
    first: dict[str, IntArray]
    available: dict[str, IntArray]
    offset: dict[str, IntArray] = field(default_factory=dict)


@dataclass(frozen=True)
class StoredWindows:
    """The table /windows of a shard, and a lookup by clip and start. Arrays (W,)."""

    clip: IntArray
    start: IntArray
    length: IntArray
    index: IntArray
    rows: dict[str, IntArray]
    by_start: IntArray
    clip_begin: IntArray

    def positions_of(self, clip: int) -> IntArray:
        """Return the positions in the table of a clip's windows, by their first frames."""
        begin, end = self.clip_begin[clip : clip + 2]
        return self.by_start[begin:end]

    def find(self, clip: int, start: int) -> int | None:
        """Return the position in the table of the window of a clip that begins at a frame, or None."""
        positions = self.positions_of(clip)
        place = int(np.searchsorted(self.start[positions], start))
        if place == len(positions) or self.start[positions[place]] != start:
            return None
        return int(positions[place])


class ShardTables:
    """The tables of a shard that h5py has opened. All columns of a table hold equally many values."""

    def __init__(self, file: Any, path: Path) -> None:
        self._file, self._path = file, path
        self._n_rows: dict[str, int] = {}

    def clips(self, split: str, fields: tuple[Field, ...], scope: str, n_rows: Mapping[str, int]) -> ClipTable:
        """Read the table /clips; `n_rows` are the rows of each field in the shard.

        StoreError for columns that are missing or of another type, and clips whose rows lie outside their field.
        """
        columns = {column.name: self._values(column) for column in CLIP_COLUMNS}
        for name in ("n_frames", "trim_start"):
            least = min(columns[name], default=0)
            if least < 0:
                raise self._broken(f"clips/{name}", "a clip has a negative number of frames", least)
        records = tuple(
            ClipRecord(split=split, **dict(zip(columns, values, strict=True)))
            for values in zip(*columns.values(), strict=True)
        )
        first: dict[str, IntArray] = {}
        available: dict[str, IntArray] = {}
        offsets: dict[str, IntArray] = {}
        for f in fields:
            if f.per_clip or scope == "track":
                span = {name: self._whole(f"clips/{f.path}/{name}") for name in f.span_columns}
                offset = span.get("offset", 0)
                first[f.name], available[f.name] = span["start"] + offset, span["length"] - offset
                offsets |= {f.name: span["offset"]} if "offset" in span else {}
                self._check_spans(f, first[f.name], available[f.name], n_rows[f.name])
        return ClipTable(records, first, available, offsets)

    def windows(self, fields: tuple[Field, ...], n_clips: int) -> StoredWindows:
        """Read the table /windows; StoreError where it does not fit the clips."""
        names = ("clip", "start", "length", "index")
        clip, start, length, index = (self._whole(f"windows/{name}") for name in names)
        if ((clip < 0) | (clip >= n_clips)).any():
            actual = f"{clip.min()} to {clip.max()}"
            raise self._broken("windows/clip", "windows of clips that do not exist", actual, f"0 to {n_clips - 1}")
        by_start = np.lexsort((start, clip))
        clip_begin = np.searchsorted(clip[by_start], np.arange(n_clips + 1))
        rows = {f.name: self._whole(f"windows/rows/{f.name}") for f in fields}
        return StoredWindows(clip, start, length, index, rows, by_start, clip_begin)

    def _values(self, column: ClipColumn) -> list[Any]:
        name, dtype = f"clips/{column.name}", column.type.dtype
        if dtype is None:
            stored = hdf5.read_strings(self._column(name, "S"))
        else:
            stored = (self._whole(name) if dtype.kind == "i" else self._column(name, "f")[...]).tolist()
        return [column.type.decode(value) for value in stored]

    def _whole(self, name: str) -> IntArray:
        return np.asarray(self._column(name, "iu")[...], dtype=np.int64)

    def _column(self, name: str, kinds: str) -> Any:
        column = hdf5.find_dataset(self._file, name)
        table = name.partition("/")[0]
        n_rows = self._n_rows.setdefault(table, column.shape[0] if column.ndim else 0)
        if column.shape != (n_rows,) or column.dtype.kind not in kinds:
            problem = "a column of a shard's table has another shape or type"
            raise self._broken(name, problem, f"{column.shape} {column.dtype}", f"({n_rows},), one value per row")
        return column

    def _check_spans(self, f: Field, first: IntArray, available: IntArray, n_rows: int) -> None:
        """Check that clips lie within the rows of a field: readers allocate as many rows as a clip has."""
        bad = (first < 0) | (available < 0) | (first > n_rows)
        bad |= available > n_rows - np.where(bad, 0, first)
        if bad.any():
            k = int(np.argmax(bad))
            actual = f"clip {k} from row {first[k]} on, {available[k]} rows"
            raise self._broken(f"clips/{f.path}", "spans outside the rows of a field", actual, f"{n_rows} rows")

    def _broken(self, name: str, problem: str, actual: object, allowed: str | None = None) -> StoreError:
        fix = "run dancedata check on the dataset"
        return StoreError(problem, where=f"{self._path}, /{name}", found=actual, allowed=allowed, fix=fix)
