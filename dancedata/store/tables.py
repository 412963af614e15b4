"""Tables: the tables of a dataset as arrays of columns. Above this file nothing knows the format on disk."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.grid import FrameGrid
from dancedata.store.clip_columns import CLIP_COLUMNS, FREE, ClipColumn, ClipRecord
from dancedata.store.columns import MAX_ROWS, MISSING, Texts, broken, require_within
from dancedata.store.dataset_json import SplitRows
from dancedata.store.schema import Field
from dancedata.store.window_list import IntArray

#: Rows that a timeline may begin after its clip: frames of them fit into 64 bits at any rate.
_FARTHEST = 1 << 32
#: Found rows of clips that are remembered.
_REMEMBERED = 1 << 17
_COLUMNS = {column.name: column for column in CLIP_COLUMNS}


@dataclass(frozen=True)
class FieldSpans:
    """Rows of a field by clip, (N,) each.

    `first`: Row in the shard that belongs to frame 0; of audio that begins later, no row of the clip lies there.
    `offset`: Row of the timeline that belongs to frame 0, negative where it begins later; None for rows of one clip.
    """

    first: IntArray
    available: IntArray  # rows from there to the end of the clip or its timeline
    offset: IntArray | None = None

    @cached_property
    def leads(self) -> bool:
        """Whether a timeline begins after frame 0 of its clip."""
        return self.offset is not None and bool((self.offset < 0).any())

    def delay(self, row: int) -> int:
        """Return the number of rows from a clip's frame 0 to the begin of its timeline."""
        return max(0, -int(self.offset[row])) if self.offset is not None else 0


@dataclass(eq=False)
class Tables:
    """The tables of a dataset. Rows of clips count over all splits; rows of fields count in the clip's shard.

    `columns`, `types`: Columns of the table of clips, by name, "x/<name>" of free ones, and types of these.
    `window_clip`, `window_start`: (W,) clip and first frame of every stored window, in stored order.
    """

    splits: Mapping[str, SplitRows]
    columns: Mapping[str, Any]
    types: Mapping[str, str]
    spans: Mapping[str, FieldSpans]
    shard_begin: IntArray  # (S + 1,) first clip of every shard, and the number of clips
    window_clip: npt.NDArray[np.integer[Any]]
    window_start: npt.NDArray[np.integer[Any]]
    window_length: int
    groups: Mapping[str, Any] = field(default_factory=dict)
    songs: Mapping[str, Any] = field(default_factory=dict)
    _records: dict[int, ClipRecord] = field(default_factory=dict)
    _found: dict[str, int] = field(default_factory=dict)

    @property
    def n_clips(self) -> int:
        """Number of clips."""
        return len(self.ids)

    @property
    def ids(self) -> Texts:
        """Ids of the clips."""
        ids: Texts = self.columns["id"]
        return ids

    @property
    def n_frames(self) -> npt.NDArray[np.integer[Any]]:
        """Frames of every clip, (N,)."""
        return np.asarray(self.columns["n_frames"])

    def find(self, clip_id: str) -> int | None:
        """Return the row of a clip, None if there is none of this id."""
        row = self._found.get(clip_id)
        if row is None:
            key = clip_id.encode(errors="surrogatepass")
            row = next((row for row in self._places(key) if row < self.n_clips and self._id_values[row] == key), None)
            if row is None:
                return None
            if len(self._found) >= _REMEMBERED:
                self._found.clear()
            self._found[clip_id] = row
        return row

    def _places(self, key: bytes) -> Iterator[int]:
        """Yield where an id may be: splits are sorted but for groups, so that rarely all ids have to be."""
        for rows in self.splits.values():
            yield rows.clips.start + int(np.searchsorted(self._id_values[rows.clips], key))
        yield from self._by_id[np.searchsorted(self._id_values, key, sorter=self._by_id) :][:1].tolist()

    @cached_property
    def _id_values(self) -> npt.NDArray[Any]:
        return self.ids.values

    @cached_property
    def _by_id(self) -> IntArray:
        return np.argsort(self._id_values, kind="stable")

    def split_of(self, row: int) -> str:
        """Return the split of a clip."""
        return next(split for split, rows in self.splits.items() if rows.clips.start <= row < rows.clips.stop)

    def in_split(self, split: str) -> npt.NDArray[np.bool_]:
        """Return which clips (N,) are of a split."""
        mask = np.zeros(self.n_clips, dtype=np.bool_)
        mask[self.splits[split].clips] = True
        return mask

    def shard_of(self, clip: npt.ArrayLike) -> IntArray:
        """Return the numbers of the shards of clips."""
        return np.asarray(np.searchsorted(self.shard_begin, clip, side="right") - 1, dtype=np.int64)

    def values(self, name: str, rows: Sequence[int]) -> list[Any]:
        """Return an attribute of `ClipRecord` of some clips; reads its column alone."""
        if name == "columns":
            return [self.free(row) for row in rows]
        column, values = _COLUMNS[name], self.columns.get(name)
        if isinstance(values, Texts):
            return list(map(column.decode, values[rows]))
        return [self.value(column, row) for row in rows]

    def value(self, column: ClipColumn, row: int) -> Any:
        """Return the attribute of a clip that a column holds."""
        values = self.columns.get(column.name)
        return column.decode(column.default if values is None else values[row])

    @cached_property
    def group_of(self) -> IntArray:
        """(N,) number of the group of every clip in `groups`, -1 for single dancers."""
        group_of = np.full(self.n_clips, -1, dtype=np.int64)
        first, count = (self.groups.get(name, ()) for name in ("first", "count"))
        for number, (begin, n) in enumerate(zip(first, count, strict=True)):
            group_of[begin : begin + n] = number
        return group_of

    def record(self, row: int) -> ClipRecord:
        """Return a row of the table of clips."""
        record = self._records.get(row)
        if record is None:
            values = {column.name: self.value(column, row) for column in CLIP_COLUMNS}
            record = ClipRecord(split=self.split_of(row), columns=self.free(row), **values)
            if len(self._records) >= _REMEMBERED:
                self._records.clear()
            self._records[row] = record
        return record

    def records(self) -> Iterator[ClipRecord]:
        """Yield all rows of the table of clips."""
        return map(self.record, range(self.n_clips))

    def free(self, row: int) -> dict[str, Any]:
        """Return the free columns of a clip, without those that it has no value of."""
        values = {}
        for name, kind in self.types.items():
            value = self.columns[name][row]
            value = value.item() if isinstance(value, np.generic) else value
            missing = MISSING[kind]
            if value != missing and not (kind == "float" and value != value):
                values[name.removeprefix(FREE)] = bool(value) if kind == "bool" else value
        return values

    @cached_property
    def clip_begin(self) -> IntArray:
        """(N + 1,) first window of every clip."""
        counts = (
            np.bincount(self.window_clip, minlength=self.n_clips) if len(self.window_clip) else np.zeros(self.n_clips)
        )
        return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)

    def positions_of(self, clip: int) -> npt.NDArray[np.integer[Any]]:
        """Return the positions in the table of a clip's windows, by their first frames."""
        return np.arange(*self.clip_begin[clip : clip + 2].tolist())

    def has_rows(self, f: Field) -> npt.NDArray[np.bool_]:
        """Return which clips (N,) have rows of a field: every clip, unless the field is optional."""
        return self.spans[f.name].available > 0 if f.optional else np.ones(self.n_clips, dtype=np.bool_)

    def rows_of(self, f: Field, grid: FrameGrid) -> IntArray:
        """Return the first row of every stored window in a field, (W,), in its clip's shard."""
        start = self.window_start.astype(np.int64)
        first: IntArray = self.spans[f.name].first[self.window_clip] + grid.rows_of_all(start, of=f.grid)[0]
        return first


def check_references(tables: Tables, n_licences: int, where: str) -> Tables:
    """Raise StoreError for numbers of clips, groups and licences that do not exist; reads their columns once."""
    n, groups = tables.n_clips, {k: np.asarray(v, np.float64) for k, v in tables.groups.items() if k != "id"}
    groups |= {"last": groups["first"] + groups["count"]} if groups else {}
    frames = (0, MAX_ROWS)
    sizes = {"first": (0, n), "count": (1, n), "last": (0, n), "n_source": (1, MAX_ROWS)}
    require_within(f"{where}, /windows", {"clip": tables.window_clip}, {"clip": (0, n - 1)})
    require_within(f"{where}, /groups", groups, sizes)
    require_within(f"{where}, /songs", tables.songs, {"sample_rate": (1, MAX_ROWS), "n_samples": (0, 2**53)})
    bounds = {"n_frames": frames, "trim_start": frames, "licence": (-1, n_licences - 1)}
    require_within(f"{where}, /clips", tables.columns, bounds)
    return tables


def check_spans(
    f: Field, first: IntArray, available: IntArray, offset: IntArray | None = None, *, n_rows: IntArray, where: str
) -> FieldSpans:
    """Check that clips lie within the rows of a field, `n_rows` (N,) in their shards: readers allocate as many."""
    begin = first if offset is None else first - offset
    # As unsigned numbers, those below 0 are the largest.
    bad = (begin.view(np.uint64) > _FARTHEST) | (available < 0) | (available > n_rows - first)
    if bad.any():
        k = int(np.argmax(bad))
        actual = f"clip {k} from row {first[k]} on, {available[k]} rows"
        actual += "" if offset is None else f", the timeline begins {offset[k]} rows before"
        raise broken(f"{where}, /clips/{f.path}", "spans outside the rows of a field", actual, f"{n_rows[k]} rows")
    return FieldSpans(first, available, offset)
