"""Clips of a dataset as what a report measures: joints, contacts, key motions and beats, in both scopes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array
from dancedata.evaluation.clip_music import BEAT
from dancedata.evaluation.inputs.columns import ColumnsReader, field_readers
from dancedata.keymotion.minima import SIGMA_FRAMES, KeyMotion, key_motion
from dancedata.core.text import shown
from dancedata.store import ClipView, Store
from dancedata.store.schema import Field

__all__ = ["ClipReader", "Piece", "contact_group"]

BoolArray = npt.NDArray[np.bool_]
#: Names of the groups of columns with contact labels, those of foot joints.
_CONTACTS = ("contact", "foot_contact")
#: Rate for which Lodge's Gaussian is given.
_SIGMA_RATE = 30
#: Columns of a key motion field that `KeyMotion.from_rows` reads.
_KEY_COLUMNS = ("speed", "minimum", "prominence")


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a clip that is stored in one piece: the whole clip, in window scope a window.

    Attributes
    ----------
    start
        First frame, at the store's rate.
    joints
        (T, J, 3) metres, +Y up.
    names
        Names of the joints.
    grid
        Rate of the frames.
    contacts
        (T, 4) whether each foot joint touches the ground; None where no field says so.
    key
        Its key motions, frames of `grid`.
    beats
        Beats of the music from the first frame on; None without music.
    music_s
        Length of the music from the first frame on, seconds; None without music.
    """

    start: int
    joints: Float64Array
    names: tuple[str, ...]
    grid: FrameGrid
    contacts: BoolArray | None
    key: KeyMotion
    beats: MusicBeats | None
    music_s: float | None


@dataclass(frozen=True)
class ClipReader:
    """Reads the clips of a store.

    Attributes
    ----------
    motion
        Motion field that joints and contacts are read from; None if no field gives joints.
    reader
        Decodes the motion field.
    feet
        Names of the joints that the columns with contacts are about; () without such columns.
    keymotion, music
        Field with key motions, and with beats; None if there is none.
    problem
        Why no motion can be read; "" if it can.
    """

    store: Store
    motion: Field | None
    reader: ColumnsReader | None
    feet: tuple[str, ...]
    keymotion: Field | None
    music: Field | None
    problem: str = ""

    @classmethod
    def of(cls, store: Store) -> ClipReader:
        """Choose the fields: motion with contacts before other motion, and the first of the others that fit."""
        found, problem = _readers(store)
        readers = {name: reader for name, reader in found.items() if _has_joints(reader)}
        motion = min(readers, key=lambda name: _rank(readers[name]), default=None)
        reader = None if motion is None else readers[motion]
        keys = [f for f in _fields(store, "keymotion") if f.columns.names == _KEY_COLUMNS]
        music = [f for f in _fields(store, "audio") if BEAT in f.columns.names]
        return cls(
            store,
            None if motion is None else store.field(motion),
            reader,
            () if motion is None else contact_group(store.field(motion))[1],
            keys[0] if keys else None,
            music[0] if music else None,
            "" if readers else problem or "no field of motion holds joints",
        )

    def pieces(self, clip: ClipView, windows: Sequence[Window]) -> Iterator[Piece]:
        """Yield what is stored of a clip, each frame at most once.

        Parameters
        ----------
        windows
            The clip's windows, by start; they are read in window scope.

        Raises
        ------
        DataError
            If columns are not those of the representation.
        """
        if self.motion is None or self.reader is None:
            return
        if self.store.scope == "track":
            yield self._piece(clip, None)
            return
        end = 0
        for window in windows:
            if window.start >= end:
                yield self._piece(clip, window)
                end = window.start + window.length

    def _piece(self, clip: ClipView, window: Window | None) -> Piece:
        assert self.motion is not None
        assert self.reader is not None
        rows = self._rows(clip, window, self.motion)
        pose = self.reader.pose(rows)
        contacts = rows[:, self.motion.columns.slice(contact_group(self.motion)[0])] > 0.5 if self.feet else None
        beats, music_s = self._beats(clip, window)
        start = 0 if window is None else window.start
        return Piece(start, pose.joints, pose.names, pose.grid, contacts, self._key(clip, window, pose.joints), beats,
                     music_s)  # fmt: skip

    def _rows(self, clip: ClipView, window: Window | None, field: Field) -> npt.NDArray[np.float32]:
        return clip.read(field.name) if window is None else self.store.read(window, field.name)

    def _key(self, clip: ClipView, window: Window | None, joints: Float64Array) -> KeyMotion:
        assert self.motion is not None
        if self.keymotion is not None and self.keymotion.grid == self.motion.grid:
            return KeyMotion.from_rows(self._rows(clip, window, self.keymotion))
        return key_motion(joints, SIGMA_FRAMES * float(self.motion.rate) / _SIGMA_RATE)

    def _beats(self, clip: ClipView, window: Window | None) -> tuple[MusicBeats | None, float | None]:
        field = self.music
        if field is None:
            return None, None
        rows = clip.read_song(field.name) if window is None else self.store.read(window, field.name)
        frames = np.flatnonzero(rows[:, field.columns.slice(BEAT)].any(axis=1))
        return MusicBeats.of(frames, field.grid), float(field.grid.seconds(len(rows)))


def contact_group(field: Field) -> tuple[str, tuple[str, ...]]:
    """Return the name of a field's columns with contacts, and the joints they are about; "" and () without any."""
    for group in field.columns.groups:
        if group.name in _CONTACTS and group.parts:
            return group.name, group.parts
    return "", ()


def _readers(store: Store) -> tuple[Mapping[str, ColumnsReader], str]:
    """Return the readers of the motion fields, or why there are none."""
    try:
        return field_readers(store), ""
    except UsageError as error:  # a recipe with plug-ins that are not installed here
        return {}, shown(error)


def _has_joints(reader: ColumnsReader) -> bool:
    return reader.representation.decodes or "position" in reader.representation.columns.names


def _rank(reader: ColumnsReader) -> tuple[bool, bool]:
    """Order motion fields: exact joints first, then those with contacts."""
    names = reader.representation.columns.names
    return reader.representation.fits, not any(name in names for name in _CONTACTS)


def _fields(store: Store, kind: str) -> list[Field]:
    return [f for f in map(store.field, store.fields) if f.kind == kind]

