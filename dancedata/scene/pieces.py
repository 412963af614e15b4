"""Joints, contacts, key motions and beats of clips: the input of a report's measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dancedata.core.dance import MusicBeats
from dancedata.core.rotations import Float64Array
from dancedata.kernel import Clip, Field, Store
from dancedata.metrics.key_motion import SIGMA_FRAMES, KeyMotion, key_motion
from dancedata.scene.figure import Figure
from dancedata.scene.poses import ColumnsReader
from dancedata.scene.scenes import drawable_fields, rhythm_fields

#: Names of the groups of columns with contact labels.
_CONTACTS = ("contact", "foot_contact")
#: Rate for which Lodge's Gaussian is given.
_SIGMA_RATE = 30
#: Columns of a key motion field that `KeyMotion.from_rows` reads.
_KEY_COLUMNS = ("speed", "minimum", "prominence")


@dataclass(frozen=True, eq=False)
class Piece:
    """A clip as it is measured."""

    figure: Figure
    key: KeyMotion  # its key motions, frames of the figure's grid
    beats: MusicBeats | None  # beats of the music from the first frame on; None without music
    music_s: float | None  # length of the music from the first frame on, seconds; None without music

    @property
    def rate(self) -> float:
        """Frames per second."""
        return float(self.figure.grid.rate)

    @property
    def beat_times(self) -> Float64Array | None:
        """Instants of the beats, seconds; None without music."""
        return None if self.beats is None else self.beats.seconds


def figure_key_motion(figure: Figure) -> KeyMotion:
    """Return the key motions of joints whose dataset stores none; Lodge's Gaussian is as wide in seconds."""
    return key_motion(figure.joints, SIGMA_FRAMES * float(figure.grid.rate) / _SIGMA_RATE)


@dataclass(frozen=True)
class ClipReader:
    """Reads the clips of a store."""

    store: Store
    # `motion`, `reader`: motion field that joints and contacts are read from; None if no field has joints
    motion: Field | None
    reader: ColumnsReader | None
    # `keymotion`, `music`: field with key motions, and with beats; None if there is none
    keymotion: Field | None
    music: Field | None

    @classmethod
    def of(cls, store: Store) -> ClipReader:
        """Choose the fields: motion with contacts before other motion, and the first of the others that fit."""
        readers = drawable_fields(store)
        # Of fields that every clip has, where one can be drawn: clips without the field have no figures.
        readers = {name: reader for name, reader in readers.items() if name in store.required_fields} or readers
        with_contacts = (n for n in readers if set(_CONTACTS) & set(readers[n].representation.columns.names))
        motion = next(with_contacts, next(iter(readers), None))
        fields = [store.field(name) for name in store.fields]
        keys = (f for f in fields if f.kind == "keymotion" and f.columns.names == _KEY_COLUMNS)
        music = rhythm_fields(store)
        drawn, beats = None if motion is None else store.field(motion), store.field(music[0]) if music else None
        return cls(store, drawn, readers.get(motion or ""), next(keys, None), beats)

    def piece(self, clip: Clip) -> Piece | None:
        """Read a clip; None without motion. DataError if columns are not those of the representation."""
        if self.motion is None or self.reader is None or self.motion.name not in clip:
            return None
        figure = Figure.of_columns(np.asarray(clip.read(self.motion.name)), self.reader)
        stored = self.keymotion
        if stored is not None and stored.grid == figure.grid and stored.name in clip:
            key = KeyMotion.from_rows(np.asarray(clip.read(stored.name)))
        else:
            key = figure_key_motion(figure)
        return Piece(figure, key, *self._beats(clip))

    def _beats(self, clip: Clip) -> tuple[MusicBeats | None, float | None]:
        field = self.music
        if field is None:
            return None, None
        if self.store[clip.id].music_offset < 0:
            lead, rows = self.store[clip.id].rows_within(field.name)
            tables = self.store._tables
            n_rows = int(tables.spans[field.name].available[tables.find(clip.id)])
        else:
            lead, rows = 0, clip.read_song(field.name)
            n_rows = len(rows)
        return field.beats(rows).after(-lead, field.grid), float(field.grid.seconds(n_rows))


def measured_units(store: Store) -> list[Sequence[Clip]]:
    """Return the clips and groups that are measured: no copies, and of slices those that do not overlap."""
    units = [dancers for dancers in store.clips().units() if not dancers[0].source]
    slices = [dancers[0] for dancers in units if dancers[0].slice_of]
    ends: dict[str, int] = {}
    overlapping = set()
    for clip in sorted(slices, key=lambda clip: (clip.slice_of, clip.slice_start)):
        if clip.slice_start < ends.get(clip.slice_of, 0):
            overlapping.add(clip.id)
        else:
            ends[clip.slice_of] = clip.slice_start + clip.n_frames
    return [dancers for dancers in units if dancers[0].id not in overlapping]
