"""The clips of an open store, and their rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from itertools import groupby
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.text import quoted, shown
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.row_queries import RowQueries
from dancedata.store.schema import Field
from dancedata.store.windowing import require_field

if TYPE_CHECKING:
    from pandas import DataFrame

    from dancedata.core.plugins import Representation

#: Ids that the text of a list of clips shows.
_SHOWN = 3


@dataclass(frozen=True, repr=False, kw_only=True)
class Clip(ClipRecord):
    """One clip of a store: the attributes of `ClipRecord`, and `read` for its arrays.

    Attributes
    ----------
    store
        The `Store` that it is read from.
    """

    store: RowQueries

    @classmethod
    def of(cls, store: RowQueries, record: ClipRecord) -> Self:
        """Make the view of a row of the table /clips."""
        # Not through __init__, which sets field by field: lists of clips are made for whole splits.
        view = object.__new__(cls)
        view.__dict__.update(vars(record), store=store)
        return view

    @property
    def record(self) -> ClipRecord:
        """The row of the table alone, without the store."""
        return ClipRecord(**{f.name: getattr(self, f.name) for f in fields(ClipRecord)})

    def __contains__(self, field: object) -> bool:
        """Return whether the clip has rows of a field; an optional one may be missing."""
        return not self.store._without(self.id, (str(field),))

    def windows(self) -> tuple[Window, ...]:
        """Return the stored windows of the clip, by their first frames."""
        tables = self.store._tables
        starts = tables.window_start[tables.positions_of(self.store._row(self.id))].tolist()
        return tuple(Window(self.id, start, tables.window_length) for start in starts)

    def read(self, field: str) -> npt.NDArray[Any]:
        """Read all rows of a field that belong to the clip, (T, D), a new array.

        Motion: every stored row. Audio: rows that begin within the clip and the music.

        Raises UsageError: for a field that the clip does not have.
        """
        f = self.store.field(field)
        return self._read(f, None if f.per_clip else self.store.grid.rows_up(self.n_frames, of=f.grid))

    def read_song(self, field: str) -> npt.NDArray[Any]:
        """Read the rows of an audio field from the clip's first frame to the end of its music, (T, D), a new array.

        Raises UsageError: for a field of motion.
        """
        f = self.store.field(field)
        if f.kind != "audio":
            where, fix = str(self.store.path), "read it with clip.read(FIELD)"
            raise UsageError(f"field {field} is not a field of music", where=where, fix=fix)
        return self._read(f, None)

    def _read(self, f: Field, most: int | None) -> npt.NDArray[Any]:
        tables, row = self.store._tables, self.store._row(self.id)
        require_field(tables, row, f)
        spans = tables.spans[f.name]
        rows, lead = int(spans.available[row]), spans.delay(row)
        if lead:
            raise UsageError(f"the rows of field {f.name} begin after the clip's first frame",
                             where=f"clip {self.id}", found=f"row {lead}",
                             fix="read windows, which begin where all their fields do")  # fmt: skip
        rows = rows if most is None else max(0, min(rows, most))
        return self.store._shard_readers[int(tables.shard_of(row))].rows(f.name, int(spans.first[row]), rows)

    def __getitem__(self, field: str) -> npt.NDArray[Any]:
        """Return `read(field)`."""
        return self.read(field)

    def rows_within(self, field: str) -> tuple[int, npt.NDArray[Any]]:
        """Read the rows of a field that lie within the clip, from its first frame or where its music begins.

        Returns: The row at which they begin, counted from frame 0, and the rows.
        """
        f, grid, row = self.store.field(field), self.store.grid, self.store._row(self.id)
        spans = self.store._tables.spans[field]
        lead = spans.delay(row)
        if not lead:
            return 0, self.read(field)
        begin, _ = grid.common_period(f.grid)
        first = -(-f.grid.rows_up(lead, of=grid) // begin) * begin
        available = f.grid.rows_down(int(spans.available[row]), of=grid)
        length = max(0, min(self.n_frames - first, available // begin * begin - first) // begin * begin)
        rows = self.store.read(Window(self.id, first, length), field) if length else np.empty((0, f.columns.width))
        return grid.rows_down(first, of=f.grid), rows

    @property
    def music_offset(self) -> Fraction:
        """Time in the clip's music at its frame 0, exact seconds; negative where it begins later, 0 without."""
        if self.audio_start:
            return self.audio_start  # exact, where rows begin at a fraction of one
        field = next(iter(self.store.fields_with()), None)
        offset = None if field is None else self.store._tables.spans[field.name].offset
        if field is None or offset is None:
            return Fraction(0)
        return field.grid.seconds(int(offset[self.store._row(self.id)]))

    def motion(self, field: str = "") -> Motion:
        """Return the clip's motion: root and rotations, metres, +Y up.

        `field`: Motion field whose columns are decoded; default: the first that has rotations.
        Raises UsageError: for a field without rotations, or a dataset without such a field.
        """
        name, plugin = self._motion_field(field)
        if not plugin.decodes:
            raise UsageError("the field has no rotations", where=str(self.store.path),
                             found=field or "fields of positions alone", fix="take clip.joints()")  # fmt: skip
        try:
            return plugin.decode(self.read(name), self.store.field(name).grid)
        except DataError as error:
            error.where = ": ".join(str(place) for place in (self.id, error.where) if place is not None)
            raise

    def joints(self, field: str = "") -> npt.NDArray[np.float64]:
        """Return the positions of the clip's joints, (T, J, 3) metres, +Y up; `field` as for `motion`.

        A dataset without rotations gives the joints of its first field of positions.
        """
        name, plugin = self._motion_field(field)
        if plugin.decodes:
            return self.motion(name).joints()
        rows = self.read(name)
        return rows[:, plugin.columns.slice("position")].reshape(len(rows), -1, 3).astype(np.float64)

    def _motion_field(self, field: str) -> tuple[str, Representation]:
        """Return a field with its plug-in: the one named, else the first with rotations, else with positions."""
        # Imported here: it loads the plug-ins, which a list of clips does not need.
        from dancedata.store.motion_fields import stored_representation, stored_representations

        store = self.store
        if field:
            return field, stored_representation(store.info.get("recipe"), field, store.field(field).columns)
        kept = {
            name: plugin
            for name, plugin in stored_representations(store).items()
            if (plugin.decodes or "position" in plugin.columns.names) and name in self
        }
        if not kept:
            raise UsageError("the dataset has no field of motion that can be decoded", where=str(store.path),
                             found=", ".join(store.fields))  # fmt: skip
        return min(kept.items(), key=lambda item: not item[1].decodes)

    def beats(self, field: str = "") -> npt.NDArray[np.float64]:
        """Return the instants of the stored beats, (M,) seconds from the clip's first frame.

        `field`: Audio field with a column "beat"; default: the first.
        Raises UsageError: for a field without beats, or a dataset without such a field.
        """
        fields = {f.name: f for f in self.store.fields_with("beat")}
        name = field or next(iter(fields), "")
        if name not in fields:
            raise UsageError("no beats are stored" if not field else f"field {field!r} has no beats",
                             where=str(self.store.path),
                             allowed=", ".join(fields) or "a dataset with librosa35 or beats")  # fmt: skip
        lead, rows = self.rows_within(name)
        seconds = fields[name].beats(rows).seconds + lead / float(fields[name].rate)
        return np.asarray(seconds.clip(min=0))

    def __repr__(self) -> str:
        length = f"{self.n_frames} frames, {float(self.store.grid.seconds(self.n_frames)):.2f} s"
        texts = {"music": self.music, "genre": self.genre}
        described = "".join(f", {name} {shown(value)}" for name, value in texts.items() if value)
        return f"Clip({quoted(self.id)}, {self.split}, {length}{described})"


class Clips(Sequence[Clip]):
    """Clips of a store, in stored order, as `Store.clips` gives them; each is made on access."""

    def __init__(self, store: RowQueries, rows: range | npt.NDArray[np.int64]) -> None:
        self._store, self._tables, self._rows = store, store._tables, rows

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, item: int) -> Clip: ...

    @overload
    def __getitem__(self, item: slice) -> Clips: ...

    def __getitem__(self, item: int | slice) -> Clip | Clips:
        if isinstance(item, slice):
            return Clips(self._store, self._rows[item])
        if not hasattr(item, "__index__"):
            raise UsageError("clips are counted from 0", found=shown(item), fix="get a clip by its id with ds[ID]")
        return Clip.of(self._store, self._tables.record(int(self._rows[item])))

    def __contains__(self, clip: object) -> bool:
        """Return whether a clip, or one of this id, is among them."""
        row = self._tables.find(clip.id if isinstance(clip, ClipRecord) else str(clip))
        return row is not None and row in self._rows

    @property
    def ids(self) -> list[str]:
        """Ids of the clips."""
        return self._tables.ids[list(self._rows)]

    def to_pandas(self) -> DataFrame:
        """Return the clips' rows of the table of clips as a pandas DataFrame, see `Store.to_pandas`."""
        from dancedata.store.tables_out import table_of

        return table_of(self._store, self, "clips")

    def units(self) -> Iterator[tuple[Clip, ...]]:
        """Yield the clips of each group together, and each single dancer alone, in stored order."""
        for _, unit in groupby(self, lambda clip: (clip.split, clip.group, "" if clip.group else clip.id)):
            yield tuple(unit)

    def __repr__(self) -> str:
        names = [repr(clip.id) for clip in self[:_SHOWN]]
        return f"Clips({len(self)}: {', '.join([*names, *['...'] * (len(self) > _SHOWN)])})"
