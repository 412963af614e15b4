"""The clips of an open store, and their rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import groupby
from typing import Any, Self, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.text import quoted, shown
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.row_queries import RowQueries
from dancedata.store.tables import Tables

#: Ids that the text of a list of clips shows.
_SHOWN = 3


@dataclass(frozen=True, repr=False, kw_only=True)
class ClipView(ClipRecord):
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

    def has_field(self, field: str) -> bool:
        """Return whether the clip has rows of a field; an optional one may be missing."""
        return self.store.has_field(self.id, field)

    def read(self, field: str) -> npt.NDArray[Any]:
        """Read all rows of a field that belong to the clip, (T, D), a new array.

        Motion: every stored row. Audio: rows that begin within the clip and the music.

        Raises
        ------
        UsageError
            For a field that the clip does not have.
        """
        return self.store.read_clip(self.id, field)

    def read_song(self, field: str) -> npt.NDArray[Any]:
        """Read the rows of an audio field from the clip's first frame to the end of its music, (T, D), a new array.

        Raises
        ------
        UsageError
            For a field of motion.
        """
        return self.store.read_song(self.id, field)

    def __getitem__(self, field: str) -> npt.NDArray[Any]:
        """Return `read(field)`."""
        return self.read(field)

    def motion(self, field: str = "") -> Motion:
        """Return the clip's motion: root and rotations, metres, +Y up.

        Parameters
        ----------
        field
            Motion field whose columns are decoded; default: the first that has rotations.

        Raises
        ------
        UsageError
            For a field without rotations, or a dataset without such a field.
        """
        from dancedata.store.motion_fields import clip_motion  # with the plug-ins, which a list of clips needs not

        return clip_motion(self.store, self.id, field)

    def joints(self, field: str = "") -> npt.NDArray[np.float64]:
        """Return the positions of the clip's joints, (T, J, 3) metres, +Y up; `field` as for `motion`.

        A dataset without rotations gives the joints of its first field of positions.
        """
        from dancedata.store.motion_fields import clip_pose

        return clip_pose(self.store, self.id, field).joints

    def beats(self, field: str = "") -> npt.NDArray[np.float64]:
        """Return the instants of the stored beats, (M,) seconds from the clip's first frame.

        Parameters
        ----------
        field
            Audio field with a column "beat"; default: the first.

        Raises
        ------
        UsageError
            For a field without beats, or a dataset without such a field.
        """
        from dancedata.store.beats import clip_beats

        return clip_beats(self.store, self.id, field)

    def __repr__(self) -> str:
        length = f"{self.n_frames} frames, {float(self.store.grid.seconds(self.n_frames)):.2f} s"
        texts = {"music": self.music, "genre": self.genre}
        described = "".join(f", {name} {shown(value)}" for name, value in texts.items() if value)
        return f"ClipView({quoted(self.id)}, {self.split}, {length}{described})"


class Clips(Sequence[ClipView]):
    """The clips of a store, in stored order; each view is made on access."""

    def __init__(self, store: RowQueries, tables: Tables, rows: range | None = None) -> None:
        self._store, self._tables = store, tables
        self._rows = range(tables.n_clips) if rows is None else rows

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, item: int) -> ClipView: ...

    @overload
    def __getitem__(self, item: slice) -> Clips: ...

    def __getitem__(self, item: int | slice) -> ClipView | Clips:
        if isinstance(item, str):
            raise UsageError("clips are counted from 0", found=item, fix="get a clip by its id with ds.clip(ID)")
        if isinstance(item, slice):
            return Clips(self._store, self._tables, self._rows[item])
        return ClipView.of(self._store, self._tables.record(self._rows[item]))

    def units(self) -> Iterator[tuple[ClipView, ...]]:
        """Yield the clips of each group together, and each single dancer alone, in stored order."""
        for _, unit in groupby(self, lambda clip: (clip.split, clip.group, "" if clip.group else clip.id)):
            yield tuple(unit)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Clips):
            return NotImplemented
        return self._store is other._store and self._rows == other._rows

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        names = [repr(clip.id) for clip in self[:_SHOWN]]
        return f"Clips({len(self)}: {', '.join([*names, *['...'] * (len(self) > _SHOWN)])})"
