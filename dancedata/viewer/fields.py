"""Which fields of a dataset can be drawn, and how their columns are read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.registry import FEATURES, beat_rows_late
from dancedata.core.rotations import Float64Array
from dancedata.evaluation.clip_music import BEAT, field_beats
from dancedata.representations.stored import ColumnsReader, motion_reader, motion_readers
from dancedata.store import Store

__all__ = ["Rhythm", "drawable_fields", "field_to_draw", "rhythm_fields"]

_ONSET = "onset_envelope"


@dataclass(frozen=True, eq=False)
class Rhythm:
    """What the dataset knows of a clip's music.

    Attributes
    ----------
    beats
        (B,) instants of the beats, seconds from the clip's first frame.
    onset
        (n,) onset curve, 0 to 1; empty if none is stored.
    onset_rate
        Values of `onset` per second.
    field
        Audio field that they are read from; "" if there is none.
    """

    beats: Float64Array
    onset: Float64Array
    onset_rate: float = 0.0
    field: str = ""

    @classmethod
    def none(cls) -> Rhythm:
        """Return the rhythm of a dataset without beats."""
        return cls(np.zeros(0), np.zeros(0))


def drawable_fields(store: Store) -> dict[str, ColumnsReader]:
    """Return the motion fields that have joint positions, those first that give back the motion as it was.

    A field whose plug-in is not installed is left out: `field_to_draw` names the reason.
    """
    kept = {
        name: reader
        for name, reader in motion_readers(store).items()
        if reader.representation.decodes or "position" in reader.representation.columns.names
    }
    # First whole motions, then positions, then motions that `decode` fits to the columns.
    rank = {name: (r.representation.fits, not r.representation.decodes) for name, r in kept.items()}
    return dict(sorted(kept.items(), key=lambda item: rank[item[0]]))


def field_to_draw(store: Store, name: str | None) -> str | None:
    """Return the field to draw: the given one, else the best one; None if the dataset has none.

    Raises
    ------
    UsageError
        If the given field is unknown, or its columns have no joint positions.
    """
    fields = drawable_fields(store)
    if name is None:
        return next(iter(fields), None)
    if name not in fields:
        if name in store.fields and store.field(name).kind == "motion":
            motion_reader(store, name)
        raise UsageError(
            "this field cannot be drawn", where=str(store.path), found=name, fix=did_you_mean(name, list(fields))
        )
    return name


def rhythm_fields(store: Store) -> tuple[str, ...]:
    """Return the audio fields that have beats, librosa35 first: two datasets are then compared by the same beats."""
    audio = [name for name in store.fields if store.field(name).kind == "audio"]
    return tuple(sorted((name for name in audio if BEAT in store.fields[name].names), key=_is_not_librosa35))


def _is_not_librosa35(name: str) -> bool:
    return FEATURES.split(name)[0] != "librosa35"


def rhythm_of(rows: Float64Array, store: Store, name: str) -> Rhythm:
    """Return the rhythm of (T, D) rows of an audio field that begin with the clip: at its instants, not late."""
    columns, rate = store.fields[name], float(store.field(name).rate)
    beats = field_beats(rows, store.field(name)).seconds.clip(min=0)
    if _ONSET not in columns.names:
        return Rhythm(beats, np.zeros(0), rate, name)
    onset = rows[beat_rows_late(name) :, columns.slice(_ONSET)].ravel().astype(np.float64)
    onset = np.nan_to_num(onset, posinf=0.0, neginf=0.0)
    top = float(onset.max(initial=0.0))
    return Rhythm(beats, np.clip(onset / top, 0, 1) if top > 0 else onset * 0, rate, name)
