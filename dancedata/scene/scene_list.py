"""Items that a page lists, and scenes as they are drawn, of a dataset or of any other motion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from dancedata.core.clip import Window
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton
from dancedata.formats.body_mesh import BodyMesh
from dancedata.kernel import ClipRecord
from dancedata.metrics.beats import nearest_offsets
from dancedata.scene.figure import Figure, Movement
from dancedata.scene.group_scene import GroupScene

#: Most characters of a name on the page; ids of clips are never shortened, as links need them.
MAX_NAME = 120


#: A key motion this near to a beat hits it, seconds: HIT_MS of timeline.js.
HIT_S = 0.06


@dataclass(frozen=True, eq=False)
class Rhythm:
    """Beats and onsets of a clip's music, as the dataset stores them."""

    beats: Float64Array  # (B,) instants of the beats, seconds from the clip's first frame
    onset: Float64Array  # (n,) onset curve, 0 to 1, `onset_rate` values per second; empty if none is stored
    onset_rate: float = 0.0
    field: str = ""  # audio field that they are read from; "" if there is none
    downbeats: tuple[int, ...] = ()  # numbers of the beats that begin a bar; empty where the field does not tell

    @classmethod
    def joined(cls, parts: Sequence[tuple[Rhythm, float, float]]) -> Rhythm:
        """Return the rhythm of parts of one song, each with begin and length in seconds, the first first."""
        first = parts[0][0]
        beats: list[float] = []
        downbeats: list[float] = []
        onset = np.full(round(max(begin + length for _, begin, length in parts) * first.onset_rate), np.nan)
        spans: list[tuple[float, float]] = []
        for rhythm, begin, length in parts:
            own = (rhythm.beats + begin).tolist()
            new = {
                k for k, beat in enumerate(own) if beat < begin + length and not any(a <= beat < b for a, b in spans)
            }
            beats += [own[k] for k in new]
            downbeats += [own[k] for k in rhythm.downbeats if k in new]
            if rhythm.field == first.field:
                place = onset[round(begin * first.onset_rate) :][: len(rhythm.onset)]
                np.copyto(place, rhythm.onset[: len(place)], where=np.isnan(place))
            spans.append((begin, begin + length))
        beats.sort()
        numbers = np.searchsorted(beats, sorted(downbeats)).tolist()
        return cls(np.array(beats), np.nan_to_num(onset), first.onset_rate, first.field, tuple(numbers))

    @classmethod
    def none(cls) -> Rhythm:
        """Return the rhythm of a dataset without beats."""
        return cls(np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class Item:
    """One entry of the list of a viewer: a clip, a window of it, or a group. Or a dancer of a group."""

    number: int  # place in the list; a dancer has that of the group
    clip: ClipRecord  # the clip's row of the table /clips; that of the first dancer of a group
    # `start`, `n_frames`: first frame in the clip and number of frames, at the store's rate
    start: int
    n_frames: int
    window: Window | None = None
    members: tuple[Item, ...] = ()  # the dancers of a group, in stored order; empty for a clip
    n_source: int = 0  # dancers of the group in the source, more than `members` where some were left out
    source: str = ""  # id of the clip, or of the group, that this one is a copy of; else empty
    called: str = ""
    sample: str = ""  # id of the sample that it is the truth of; "" for none

    @property
    def name(self) -> str:
        """Id of the clip or of the group."""
        return self.clip.group if self.members else self.clip.id

    @property
    def id(self) -> str:
        """The name; of a window that of the sample, or its first frame follows, as in "clip@75"."""
        return self.sample or (self.name if self.window is None else f"{self.name}@{self.start}")

    @property
    def part(self) -> str:
        """What a dancer is called beside the others: number in the source and role, as in "1 leader"."""
        return self.called or f"{self.clip.member} {self.clip.role}".strip()


def begins_after(item: Item, grid: FrameGrid, other: Item, other_grid: FrameGrid) -> Fraction:
    """Return how many seconds later in its song an item begins than another one; below 0 if it begins earlier.

    Where they have no song of one name, two items of one clip are compared by the source's motion; of different songs
    it is 0. A motion file begins with the clip that it is named as, or else with its song.
    """
    one, two = item.clip, other.clip
    of_file = not (one.split and two.split)
    if of_file and one.id == two.id:
        return Fraction(0)
    if (one.music or one.song) and (one.music or one.song) == (two.music or two.song):
        begins = one.audio_start - two.audio_start
    elif one.id == two.id:
        begins = (one.source_start or Fraction(0)) - (two.source_start or Fraction(0))
    else:
        return Fraction(0)
    return begins + grid.seconds(item.start) - other_grid.seconds(other.start)


@dataclass(frozen=True)
class Word:
    """A segment of an item: a span or an instant with words."""

    layer: str  # name of its layer, with the language where there is one
    # `begin`, `end`: seconds from the item's first frame, half-open
    begin: float
    end: float
    text: str
    member: int = -1  # place of the dancer in the group; -1 for a clip, and for segments of the whole group


@dataclass(frozen=True)
class Flag:
    """A quality flag of an item; `time` is in seconds from its first frame, None for a flag of the whole clip."""

    time: float | None
    kind: str
    joint: str
    value: float
    unit: str


@dataclass(frozen=True, eq=False)
class Scene:
    """The drawing of one item. Times are in seconds from its first frame."""

    item: Item
    grid: FrameGrid  # the store's rate, of windows and of loops in links
    field: str  # motion field that is drawn; "" if none can be
    # `figure`, `movement`: the dancer, with speed and key motions; None where there are none, and for a group
    figure: Figure | None
    movement: Movement | None
    rhythm: Rhythm
    # first frame and length of the dataset's windows, frames at the store's rate
    windows: tuple[tuple[int, int], ...]
    flags: tuple[Flag, ...]
    notes: tuple[str, ...]  # sentences on what is missing or was computed
    members: tuple[Scene, ...] = ()
    # their distances and contacts; None for a clip, a wall, and where a dancer has no figure
    together: GroupScene | None = None
    numbers: tuple[tuple[str, str], ...] = ()  # what is measured of a dancer of a wall: name and value as text
    words: tuple[Word, ...] = ()

    @property
    def offsets(self) -> Float64Array:
        """How late the nearest key motion of each beat is, seconds (B,), below 0 if early; empty without either."""
        if self.movement is None or not len(self.movement.key_times) or not len(self.rhythm.beats):
            return np.zeros(0)
        return -nearest_offsets(self.rhythm.beats, self.movement.key_times)

    @property
    def hits(self) -> Float64Array:
        """The offsets of the beats that a key motion hits, seconds."""
        offsets = self.offsets
        return offsets[np.abs(offsets) <= HIT_S + 1e-9]

    @property
    def dancers(self) -> tuple[Scene, ...]:
        """The scenes that have figures: those of the members of a group, or this one."""
        return tuple(scene for scene in self.members or (self,) if scene.figure is not None)

    def mirrored(self) -> Scene:
        """Return the scene with mirrored figures, in their common world."""
        members = tuple(member.mirrored() for member in self.members)
        return replace(self, figure=None if self.figure is None else self.figure.mirrored(), members=members)

    def with_mesh(self, mesh: BodyMesh) -> Scene:
        """Return the scene with body models instead of limbs, and a note where one keeps its limbs."""
        if self.members:
            members, notes, refused = [], list(self.notes), []
            for member in self.members:
                try:
                    members.append(member.with_mesh(mesh))
                except UsageError as error:
                    members.append(member)
                    refused.append(error)
                    notes.append(f"{member.item.part}: no body model: {error}")
            if len(refused) == len(members):
                raise refused[0]
            notes += [note for member in members for note in member.notes]
            return replace(self, members=tuple(members), notes=tuple(dict.fromkeys(notes)))
        if self.figure is None:
            return self
        figure = self.figure.with_mesh(mesh)
        lost = mesh.lost(self.figure.motion) if self.figure.motion is not None else ""
        return replace(self, figure=figure, notes=(*self.notes, lost) if lost else self.notes)

    @property
    def seconds(self) -> float:
        """Length of the item."""
        return float(self.grid.seconds(self.item.n_frames))


class SceneList(ABC):
    """Items, each with a scene."""

    place: str  # what they are read from, for messages
    grid: FrameGrid  # rate at which items are counted
    body: Skeleton  # body of positions whose joints have no names in a file
    fields: tuple[str, ...] = ()  # motion fields that the viewer offers; empty where there is nothing to choose

    @property
    @abstractmethod
    def items(self) -> Sequence[Item]:
        """The items in their order, numbered from 0."""

    @abstractmethod
    def scene(self, item: Item, field: str | None = None, *, first_s: float | None = None) -> Scene:
        """Read an item, with a field of `fields`, by default the first; `first_s` seconds of dancers are enough."""

    def sliding(self, item: Item) -> float | None:
        """Return how fast the feet of a dancer slide in contact, metres per second; None without a figure."""
        figure = self.scene(item).figure
        return None if figure is None else figure.sliding

    @abstractmethod
    def about(self) -> dict[str, Any]:
        """Return the head of the page: name, numbers and licence, as JSON data."""

    def second(self, item: Item) -> Fraction:
        """Return the second of its song at an item's first frame."""
        return item.clip.audio_start + self.grid.seconds(item.start)

    def windows_of(self, item: Item) -> tuple[tuple[int, int], ...]:
        """Return first frame and length of the windows of an item, frames from the item's first."""
        return ()

    def best(self) -> Item:
        """Return the item that a page begins with where none is named."""
        return self.items[0]

    def flag_count(self, item: Item) -> int:
        """Return the number of flags of an item, those of the whole clip and of all dancers included."""
        return 0

    def changed(self) -> bool:
        """Whether other items are at the place now."""
        return False

    def items_of(self, name: str) -> list[Item]:
        """Return the items of a clip, group or dancer, of windows several; UsageError for an unknown name."""
        named = self._by_name.get(name, [])
        if not named:
            kind = "clip or group" if any(item.members for item in self.items) else "clip"
            raise UsageError(f"no {kind} named {name!r}", where=self.place, fix=self._nearest(name, kind))
        return named

    def _nearest(self, name: str, kind: str) -> str:
        """Return the names that are meant by an unknown one, as a fix."""
        return did_you_mean(name, self._by_name)

    def has(self, name: str) -> bool:
        """Whether there is an item of this name, or a dancer of a group."""
        return name in self._by_name

    def find(self, name: str) -> Item:
        """Return the item of a clip or a group, of samples of one clip the first; UsageError as `items_of`."""
        return self.items_of(name)[0]

    @cached_property
    def _by_name(self) -> dict[str, list[Item]]:
        items: dict[str, list[Item]] = {}
        for item in self.items:
            for dancer in item.members or (item,):
                for name in filter(None, (dancer.clip.id, dancer.sample)):
                    items.setdefault(name, []).append(dancer)
        # A clip of the same name comes first: commands name clips.
        groups = [item for item in self.items if item.members and item.name not in items]
        for item in groups:
            items.setdefault(item.name, []).append(item)
        return items
