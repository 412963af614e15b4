"""Beats that audio fields store, at their instants."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Group
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import beat_rows_late
from dancedata.store.queries import fields_with
from dancedata.store.row_queries import RowQueries

#: Group of the column with the beats.
BEAT = "beat"
_BEAT_ALONE = Columns((Group(BEAT, 1, "0/1"),), None)


class AudioField(Protocol):
    """A field of a dataset or of a recipe."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def columns(self) -> Columns:
        """Its columns."""

    @property
    def grid(self) -> FrameGrid:
        """The grid of its rows."""


def field_beats(rows: npt.NDArray[Any], field: AudioField) -> MusicBeats:
    """Return the beats of rows (T, D) of an audio field, or of its column of beats alone (T,), at their instants."""
    late = beat_rows_late(field.name)
    if rows.ndim == 1:
        return MusicBeats.of_rows(rows[:, None], _BEAT_ALONE, field.grid, late=late)
    return MusicBeats.of_rows(rows, field.columns, field.grid, late=late)


def clip_beats(store: RowQueries, clip_id: str, field: str = "") -> npt.NDArray[np.float64]:
    """Return the instants of a clip's stored beats, (M,) seconds from its first frame; see `Clip.beats`."""
    fields = {f.name: f for f in fields_with(store, BEAT)}
    name = field or next(iter(fields), "")
    if name not in fields:
        raise UsageError("no beats are stored" if not field else f"field {field!r} has no beats",
                         where=str(store.path),
                         allowed=", ".join(fields) or "a dataset with librosa35 or beats")  # fmt: skip
    lead, rows = store._rows_within(clip_id, name)
    seconds = field_beats(rows, fields[name]).seconds + lead / float(fields[name].rate)
    return np.asarray(seconds.clip(min=0))
