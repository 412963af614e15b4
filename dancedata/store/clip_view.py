"""Clips of a store: what is known of them, and their rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.text import quoted, shown
from dancedata.store.schema import ClipRecord

if TYPE_CHECKING:
    from dancedata.store.dataset import Store

#: Ids that the text of a list of clips shows.
_SHOWN = 3


@dataclass(frozen=True, repr=False)
class ClipView:
    """One clip of a store: its row of the table /clips, and `read` for its arrays.

    Attributes
    ----------
    record
        The row alone, without the store.
    """

    store: Store
    record: ClipRecord

    @property
    def id(self) -> str:
        """Name of the clip."""
        return self.record.id

    @property
    def split(self) -> str:
        """Split the clip is in."""
        return self.record.split

    @property
    def genre(self) -> str:
        """Genre, as the dataset names it."""
        return self.record.genre

    @property
    def music(self) -> str:
        """Music id."""
        return self.record.music

    @property
    def dancer(self) -> str:
        """Dancer, as the dataset names them."""
        return self.record.dancer

    @property
    def tempo_bpm(self) -> float | None:
        """Tempo that the dataset states, beats per minute."""
        return self.record.tempo_bpm

    @property
    def source(self) -> str:
        """Id of the clip that this one is a mirrored copy of, else empty."""
        return self.record.source

    @property
    def n_flags(self) -> int:
        """Quality flags raised for the clip; `Store.quality` has them."""
        return self.record.n_flags

    @property
    def trim_start(self) -> int:
        """First frame, at the store's fps, that belongs to the dance."""
        return self.record.trim_start

    @property
    def height_m(self) -> float | None:
        """Vertical extent of the joints, median over frames, metres."""
        return self.record.height_m

    @property
    def source_rate(self) -> str:
        """Frames per second of the source, as text; empty if unknown."""
        return self.record.source_rate

    @property
    def lists(self) -> tuple[str, ...]:
        """Lists of the dataset that the clip is in."""
        return self.record.lists

    @property
    def n_frames(self) -> int:
        """Frames at the store's fps."""
        return self.record.n_frames

    def read(self, field: str) -> npt.NDArray[Any]:
        """Read all rows of a field that belong to the clip.

        Parameters
        ----------
        field
            Name of a field.

        Returns
        -------
        ndarray
            (T, D), fresh. Motion: every stored row. Audio: rows that begin within the clip, as far as the
            music goes.

        Raises
        ------
        StoreError
            In window scope, where clips are not stored whole.
        """
        return self.store.read_clip(self.record.id, field)

    def __repr__(self) -> str:
        """Show id, length and what the dataset says of the clip."""
        length = f"{self.n_frames} frames, {float(self.n_frames / self.store.fps):.2f} s"
        about = {"music": self.music, "genre": self.genre}
        known = "".join(f", {name} {shown(value)}" for name, value in about.items() if value)
        return f"ClipView({quoted(self.id)}, {self.split}, {length}{known})"


class Clips(Sequence[ClipView]):
    """The clips of a store, in stored order; each is made when asked for."""

    def __init__(self, store: Store, records: tuple[ClipRecord, ...]) -> None:
        self._store = store
        self._records = records

    def __len__(self) -> int:
        """Return the number of clips."""
        return len(self._records)

    @overload
    def __getitem__(self, item: int) -> ClipView: ...

    @overload
    def __getitem__(self, item: slice) -> Clips: ...

    def __getitem__(self, item: int | slice) -> ClipView | Clips:
        """Return one clip, or some of them; by position, as `Store.clip` finds a clip by its id."""
        if isinstance(item, str):
            raise UsageError("clips are counted from 0", found=item, fix="get a clip by its id with ds.clip(ID)")
        if isinstance(item, slice):
            return Clips(self._store, self._records[item])
        return ClipView(self._store, self._records[item])

    def __eq__(self, other: object) -> bool:
        """Tell whether both are the same clips of one store."""
        if not isinstance(other, Clips):
            return NotImplemented
        return self._store is other._store and self._records == other._records

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Say how many there are, and name the first."""
        names = [repr(record.id) for record in self._records[:_SHOWN]]
        return f"Clips({len(self)}: {', '.join([*names, *['...'] * (len(self) > _SHOWN)])})"
