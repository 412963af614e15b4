"""Scenes: the clips of a dataset, or its windows in window scope, as they are drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.errors import DataError, UsageError, did_you_mean, nearest
from dancedata.core.grid import FrameGrid, as_rate
from dancedata.core.registry import FEATURES, beat_rows_late
from dancedata.core.rotations import Float64Array
from dancedata.core.text import counted, listed
from dancedata.evaluation.music import BEAT, field_beats
from dancedata.keymotion.minima import KeyMotion
from dancedata.store import Store
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.motion_fields import ColumnsReader, motion_reader, motion_readers
from dancedata.viewer.figure import Figure, Movement
from dancedata.viewer.together import Together

_ONSET = "onset_envelope"


@dataclass(frozen=True, eq=False)
class Rhythm:
    """Beats and onsets of a clip's music, as the dataset stores them.

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

    Fields whose plug-ins are not installed are left out; `Scenes` gives the reason for a field by name.
    """
    kept = {
        name: reader
        for name, reader in motion_readers(store).items()
        if reader.representation.decodes or "position" in reader.representation.columns.names
    }
    # First whole motions, then positions, then motions that `decode` fits to the columns.
    rank = {name: (r.representation.positions_only, not r.representation.decodes) for name, r in kept.items()}
    return dict(sorted(kept.items(), key=lambda item: rank[item[0]]))


def rhythm_fields(store: Store) -> tuple[str, ...]:
    """Return the audio fields that have beats, librosa35 first: two datasets are then compared by the same beats."""
    names = [field.name for field in store.fields_with(BEAT)]
    return tuple(sorted(names, key=lambda name: FEATURES.split(name)[0] != "librosa35"))


def rhythm_of(rows: Float64Array, store: Store, name: str, lead: int = 0) -> Rhythm:
    """Return the rhythm of (T, D) rows of an audio field, at its instants, not late.

    The rows begin with the clip or, where its music begins later, `lead` rows after it.
    """
    columns, rate = store.fields[name], float(store.field(name).rate)
    beats = (field_beats(rows, store.field(name)).seconds + lead / rate).clip(min=0)
    if _ONSET not in columns.names:
        return Rhythm(beats, np.zeros(0), rate, name)
    onset = rows[beat_rows_late(name) :, columns.slice(_ONSET)].ravel().astype(np.float64)
    onset = np.pad(np.nan_to_num(onset, posinf=0.0, neginf=0.0), (lead, 0))
    top = float(onset.max(initial=0.0))
    return Rhythm(beats, np.clip(onset / top, 0, 1) if top > 0 else onset * 0, rate, name)


@dataclass(frozen=True)
class Item:
    """One entry of the list of a viewer: a clip or a group, in window scope a window of it. Or a dancer of a group.

    Attributes
    ----------
    number
        Place in the list; a dancer has that of the group.
    clip
        The clip's row of the table /clips; that of the first dancer of a group.
    start, n_frames
        First frame in the clip and number of frames, at the store's rate.
    window
        The window; None for a whole clip.
    members
        The dancers of a group, in stored order; empty for a clip.
    n_source
        Dancers of the group in the source, more than `members` where some were left out.
    source
        Id of the clip, or of the group, that this one is a copy of; else empty.
    """

    number: int
    clip: ClipRecord
    start: int
    n_frames: int
    window: Window | None = None
    members: tuple[Item, ...] = ()
    n_source: int = 0
    source: str = ""

    @property
    def name(self) -> str:
        """Id of the clip or of the group."""
        return self.clip.group if self.members else self.clip.id

    @property
    def id(self) -> str:
        """The name; in window scope the first frame of the window follows, as in "clip@75"."""
        return self.name if self.window is None else f"{self.name}@{self.start}"

    @property
    def part(self) -> str:
        """What a dancer is called beside the others: number in the source and role, as in "1 leader"."""
        return f"{self.clip.member} {self.clip.role}".strip()


@dataclass(frozen=True)
class Flag:
    """A quality flag of an item.

    Attributes
    ----------
    time
        Seconds from the item's first frame; None for a flag of the whole clip.
    """

    time: float | None
    kind: str
    joint: str
    value: float
    unit: str


@dataclass(frozen=True, eq=False)
class Scene:
    """The drawing of one item. Times are in seconds from its first frame.

    Attributes
    ----------
    grid
        The store's rate, of windows and of loops in links.
    field
        Motion field that is drawn; "" if none can be.
    figure
        The dancer; None if no field of the dataset has joint positions, and for a group.
    movement
        Speed and key motions; None without a figure and a stored field of them, and for a group.
    windows
        First frame and length of the dataset's windows, frames at the store's rate.
    notes
        Sentences on what is missing or was computed.
    members
        Scenes of the dancers of a group; empty for a clip.
    together
        Their distances and contacts; None for a clip, and where a dancer has no figure.
    """

    item: Item
    grid: FrameGrid
    field: str
    figure: Figure | None
    movement: Movement | None
    rhythm: Rhythm
    windows: tuple[tuple[int, int], ...]
    flags: tuple[Flag, ...]
    notes: tuple[str, ...]
    members: tuple[Scene, ...] = ()
    together: Together | None = None

    @property
    def dancers(self) -> tuple[Scene, ...]:
        """The scenes that have figures: those of the members of a group, or this one."""
        return tuple(scene for scene in self.members or (self,) if scene.figure is not None)

    @property
    def seconds(self) -> float:
        """Length of the item."""
        return float(self.grid.seconds(self.item.n_frames))


class Scenes:
    """The items of a dataset; arrays are read item by item.

    Parameters
    ----------
    store
        An open dataset.
    field
        Motion field to draw. Default: the first one that decodes to the motion itself.

    Raises
    ------
    UsageError
        If the field is unknown or cannot be drawn.
    """

    def __init__(self, store: Store, field: str | None = None) -> None:
        self.store = store
        self.readers = drawable_fields(store)
        self.field = next(iter(self.readers), None) if field is None else self._drawable(field)
        self._rhythm_field = next(iter(rhythm_fields(store)), None)

    @cached_property
    def items(self) -> tuple[Item, ...]:
        """The groups and clips in stored order; in window scope the windows, clip by clip or group by group."""
        items: list[Item] = []
        for unit in self.store.clips.units():
            dancers = [clip.record for clip in unit]
            windows = [self.store.windows_of(c.id) if self.store.scope == "window" else [None] for c in dancers]
            for of_dancers in zip(*windows, strict=True):
                members = tuple(
                    Item(len(items), clip, 0, clip.n_frames, source=clip.source)
                    if window is None
                    else Item(len(items), clip, window.start, window.length, window, source=clip.source)
                    for clip, window in zip(dancers, of_dancers, strict=True)
                )
                items.append(self._group(members) if dancers[0].group else members[0])
        return tuple(items)

    def items_of(self, name: str) -> list[Item]:
        """Return the items of a clip or a group, several in window scope; a dancer of a group is an item by himself.

        Raises
        ------
        UsageError
            For an unknown name.
        """
        named = self._by_name.get(name, [])
        if not named:
            kind = "clip or group" if any(item.members for item in self.items) else "clip"
            raise UsageError(
                f"no {kind} named {name!r}",
                where=str(self.store.path),
                fix=nearest(name, self._by_name, "name" if "or" in kind else kind, self.store.path),
            )
        return named

    def find(self, name: str, frame: int = 0) -> Item:
        """Return the item of a clip or a group, in window scope the first one that has a frame of the clip.

        Raises
        ------
        UsageError
            For an unknown name.
        """
        named = self.items_of(name)
        return next((item for item in named if item.start <= frame < item.start + item.n_frames), named[0])

    def scene(self, item: Item, field: str | None = None) -> Scene:
        """Read an item.

        Parameters
        ----------
        field
            Motion field to draw, one of `readers`. Default: that of these scenes.

        Raises
        ------
        UsageError
            For a field that cannot be drawn.
        StoreError
            If the dataset cannot be read, or was built again in the meantime.
        """
        name = self.field if field is None else self._drawable(field)
        if item.members:
            return self._group_scene(item, name)
        figure, problem = self._figure(item, name)
        rhythm = self._rhythm(item)
        return Scene(
            item, self.store.grid, name or "", figure, self._movement(item, figure), rhythm,
            self.windows_of(item), self._flags_of(item), tuple(_notes(self.store, figure, problem, rhythm)),
        )  # fmt: skip

    def flag_count(self, item: Item) -> int:
        """Return the number of flags of an item, those of the whole clip and of all dancers included."""
        return sum(len(self._flags_of(dancer)) for dancer in item.members or (item,))

    def _drawable(self, field: str) -> str:
        """Return the name of a field that can be drawn; UsageError for another one."""
        if field not in self.readers:
            if field in self.store.fields and self.store.field(field).kind == "motion":
                motion_reader(self.store, field)  # raises the reason
            fix = did_you_mean(field, list(self.readers))
            raise UsageError("this field cannot be drawn", where=str(self.store.path), found=field, fix=fix)
        return field

    def _rows(self, item: Item, field: str) -> npt.NDArray[Any]:
        if item.window is None:
            return self.store.read_clip(item.clip.id, field)
        return self.store.read(item.window, field)

    def _figure(self, item: Item, name: str | None) -> tuple[Figure | None, str]:
        if name is None:
            fields = [f for f in self.store.fields if self.store.field(f).kind == "motion"]
            return None, f"no figure: {', '.join(fields) or 'no field'} holds neither rotations nor joint positions"
        try:
            return Figure.of_columns(self._rows(item, name), self.readers[name]), ""
        except DataError as error:
            return None, f"no figure: {error}"

    def _movement(self, item: Item, figure: Figure | None) -> Movement | None:
        for name in self.store.fields:
            stored = self.store.field(name)
            if stored.kind == "keymotion" and stored.columns.names == ("speed", "minimum", "prominence"):
                return Movement.of(KeyMotion.from_rows(self._rows(item, name)), stored.grid, name)
        return None if figure is None or figure.n_frames < 2 else figure.movement

    def _rhythm(self, item: Item) -> Rhythm:
        name = self._rhythm_field
        if name is None:
            return Rhythm.none()
        if item.window is not None:
            return rhythm_of(self._rows(item, name), self.store, name)
        lead, rows = self.store.rows_within(item.clip.id, name)
        return rhythm_of(rows, self.store, name, lead)

    def windows_of(self, item: Item) -> tuple[tuple[int, int], ...]:
        """Return first frame and length of the windows of an item, frames from the item's first."""
        if item.window is not None:
            return ((0, item.n_frames),)
        return tuple((window.start, window.length) for window in self.store.windows_of(item.clip.id))

    def _flags_of(self, item: Item) -> tuple[Flag, ...]:
        begin, length = float(self.store.grid.seconds(item.start)), float(self.store.grid.seconds(item.n_frames))
        flags = []
        for row in self._quality.get(item.clip.id, ()):
            flag = _flag(row, begin)
            if flag.time is None or 0 <= flag.time < length:
                flags.append(flag)
        return tuple(flags)

    def _group(self, members: tuple[Item, ...]) -> Item:
        first = members[0]
        source = self.store.clip(first.clip.source).group if first.clip.source else ""
        n_source = self._sizes[first.clip.split].get(first.clip.group, len(members))
        return replace(first, members=members, n_source=n_source, source=source)

    def _group_scene(self, item: Item, name: str | None) -> Scene:
        members = tuple(self.scene(member, name) for member in item.members)
        figures = [scene.figure for scene in members if scene.figure is not None]
        together, notes = None, list(dict.fromkeys(note for scene in members for note in scene.notes))
        if item.n_source > len(members):
            numbers = listed([member.part for member in item.members], 12)
            notes.append(f"{len(members)} of {item.n_source} dancers are stored: {numbers}; the others were left out")
        if len(figures) == len(members):
            together = Together.of(figures)
            if not together.touch:
                notes.append("contacts and collisions are not measured: the body has other joints than SMPL")
        windows, rhythm = members[0].windows, members[0].rhythm
        return Scene(
            item, self.store.grid, name or "", None, None, rhythm, windows, (), tuple(notes), members, together
        )

    @cached_property
    def _sizes(self) -> dict[str, dict[str, int]]:
        """Dancers of each group in the source, by split and group."""
        tables = {split: self.store.tables(split).groups for split in self.store.splits}
        return {
            split: dict(zip(groups["id"], np.asarray(groups["n_source"]).tolist(), strict=True)) if groups else {}
            for split, groups in tables.items()
        }

    @cached_property
    def _by_name(self) -> dict[str, list[Item]]:
        items: dict[str, list[Item]] = {}
        for item in self.items:
            for dancer in item.members or (item,):
                items.setdefault(dancer.clip.id, []).append(dancer)
        # A clip of the same name comes first: commands name clips.
        groups = [item for item in self.items if item.members and item.name not in items]
        for item in groups:
            items.setdefault(item.name, []).append(item)
        return items

    @cached_property
    def _quality(self) -> dict[str, list[Mapping[str, Any]]]:
        flags: dict[str, list[Mapping[str, Any]]] = {}
        for row in self.store.quality:
            flags.setdefault(row["clip"], []).append(row)
        return flags


def _flag(row: Mapping[str, Any], begin: float) -> Flag:
    """Return the flag of a line of quality.jsonl; its frame is one of the source."""
    frame, rate = row.get("frame"), row.get("rate")
    try:
        time = None if frame is None or rate is None else float(frame / as_rate(str(rate))) - begin
    except (UsageError, OverflowError):
        time = None  # not a rate, or a frame beyond all time: the flag is shown as one of the whole clip
    return Flag(time, str(row.get("kind", "")), str(row.get("joint", "")), row.get("value", 0.0), row.get("unit", ""))


def _notes(store: Store, figure: Figure | None, problem: str, rhythm: Rhythm) -> list[str]:
    notes = [problem] if problem else []
    if figure is not None and not figure.contacts_stored:
        notes.append("contacts are not stored in this field: they were computed by the rule velocity")
    if not rhythm.field:
        audio = [name for name in store.fields if store.field(name).kind == "audio"]
        notes.append(f"no beats: {counted(len(audio), 'audio field')} of the dataset, none with a column beat")
    return notes
