"""Walls: several motions to the same music, side by side on one stage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from dancedata.core.dance import MusicBeats
from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import PROTOCOLS
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.scene.comparisons import Comparison
from dancedata.scene.figure import Figure
from dancedata.scene.poses import Pose
from dancedata.scene.scene_list import Item, Rhythm, Scene, SceneList
from dancedata.scene.source import ClipSound, Sounds

#: Protocol of the numbers of dancers.
PROTOCOL = "dancedata"
#: Most dancers on a wall, and in a row of it.
MOST, ROW = 12, 4
#: Least and greatest distance of neighbours in a row, and between rows, metres.
_NEAR_M, _FAR_M, _BEHIND_M = 1.5, 3.0, 2.2


class Wall(SceneList):
    """Walls of up to `MOST` dancers: each clip beside what it is compared with, or the clips of each song.

    Every dancer begins at a place of his own, on one floor; where he goes from there, and which way he faces, is as
    it was. A wall has one time, that of its song: it begins with the first dancer and ends with the last. One who
    begins later or ends earlier stands still, and is measured without that, by his own beats. Clips of a song that
    share no second of it stand on walls of their own. Figures are drawn at the rate of the first.

    `scenes`: Whose items are shown; groups are left out.
    `comparisons`: Motions that stand beside each clip; without any, a wall is a song.
    `name`: What the clips themselves are called beside others.
    `apart`: Whether each has a place of his own; if not, all are drawn where they are, one over the other.
    Raises UsageError: if there are fewer than two motions for every wall.
    """

    def __init__(
        self, scenes: SceneList, comparisons: Sequence[Comparison] = (), name: str = "", *, apart: bool = True
    ) -> None:
        self.scenes, self.comparisons = scenes, tuple(comparisons[: MOST - 1])
        self.place, self.grid, self.body, self.fields = scenes.place, scenes.grid, scenes.body, scenes.fields
        self._apart = apart
        self._name = name or str(scenes.about()["name"])
        self._left_out = [c.name for c in comparisons[MOST - 1 :]]
        if not self.items:
            groups, clips = [i for i in scenes.items if i.members], [i for i in scenes.items if not i.members]
            begins = [f"{i.id} to {i.clip.music or '?'} from {float(scenes.second(i)):g} s" for i in clips]
            left_out = [f"{counted(len(groups), 'group')}, which walls leave out"] if groups else []
            raise UsageError(
                "a wall needs two motions that overlap in the same song",
                reason="mixed_starts", where=scenes.place,
                found="; ".join([*left_out, *([listed(begins)] if begins else [])]),
                fix="a group is shown on one stage without a wall" if groups and not clips
                else "name others to compare with, or show a dataset with several clips of the same song",
            )  # fmt: skip

    @override
    @cached_property
    def items(self) -> tuple[Item, ...]:
        return tuple(self._wall(number, name, takes) for number, (name, takes) in enumerate(self._takes))

    @cached_property
    def _takes(self) -> list[tuple[str, list[tuple[Item, str]]]]:
        """Name of each wall, and its dancers: the item of `scenes`, and what he is called."""
        single = [item for item in self.scenes.items if not item.members]
        if self.comparisons:
            names = (self._name, *(comparison.name for comparison in self.comparisons))
            return [(item.name, [(item, name) for name in names]) for item in single]
        songs: dict[str, list[Item]] = {}
        for item in single:
            if not item.source:  # not beside its own copies
                songs.setdefault(item.clip.music or item.clip.song, []).append(item)
        walls = [
            (song or self._name, together)
            for song, items in songs.items()
            for together in self._together(items)
            if len(together) > 1
        ]
        seen = Counter(name for name, _ in walls)
        return [
            (
                name if seen[name] == 1 else f"{name} {float(min(map(self.second, items))):g} s",
                [(item, item.clip.dancer or item.id) for item in items],
            )
            for name, items in walls
        ]

    def _together(self, items: Sequence[Item]) -> list[list[Item]]:
        """Return the items of a song that share time: windows and slices that begin together, clips that overlap."""
        begins: dict[Fraction, list[Item]] = {}
        for item in items:
            begins.setdefault(self.second(item), []).append(item)
        if (items[0].window is not None or items[0].clip.slice_of) and max(map(len, begins.values())) > 1:
            return list(begins.values())
        walls: list[list[Item]] = []
        end = Fraction(0)
        for item in sorted(items, key=self.second):
            if not walls or self.second(item) >= end:
                walls.append([])
            walls[-1].append(item)
            end = max(end, self.second(item) + self.grid.seconds(item.n_frames))
        return [sorted(wall, key=lambda item: item.number) for wall in walls]

    def _late(self, wall: Item) -> list[float]:
        """Return how many seconds after the wall each dancer begins."""
        items = [item for item, _ in self._takes[wall.number][1][:MOST]]
        first = self.first(wall)
        return [float(self.second(item) - self.second(first)) for item in items]

    @override
    def scene(self, item: Item, field: str | None = None, *, first_s: float | None = None) -> Scene:
        # Numbers are of whole motions, so all is read.
        longest = self.scenes.scene(self.longest(item), field)
        notes, grid, late = list(longest.notes), None, self._late(item)
        seconds = float(self.grid.seconds(item.n_frames))
        if self._left_out or item.n_source > len(item.members):
            named = listed(self._left_out) or counted(item.n_source - len(item.members), "further dancer")
            notes.append(f"a wall has {MOST} dancers at most; left out: {named}")
        takes: list[tuple[Item, Figure, Figure, Rhythm]] = []
        parts: list[tuple[Rhythm, float, float]] = []
        for number, member in enumerate(item.members):
            try:
                figure, own = self._figure(item, number, longest, field)
            except DanceDataError as error:
                notes.append(f"{member.part}: {error}")
                continue
            grid = grid or figure.grid
            begin, length = late[number], figure.n_frames / float(figure.grid.rate)
            notes += [f"{member.part} begins at {begin:.2f} s"] if begin else []
            if begin + length < seconds - 1 / float(grid.rate):
                notes.append(f"{member.part} ends at {begin + length:.2f} s")
            parts.append((own, begin, length))
            takes.append((member, figure, figure.resampled(grid, seconds, begin), own))
        if not takes:
            raise DataError("nothing of this wall can be drawn", reason="missing_joints", found="; ".join(notes))
        truth = takes[0][1] if self.comparisons and takes[0][0].clip.member == 0 else None
        notes.append(f"BAS and PFC by protocol {PROTOCOL}, as evaluate has them: over pieces of 5 s")
        shifts = places([figure for _, _, figure, _ in takes]) if self._apart else [np.zeros(3)] * len(takes)
        first = late[next(k for k, (one, _) in enumerate(self._takes[item.number][1]) if one is longest.item)]
        rhythm = Rhythm.joined(sorted(parts, key=lambda part: part[1])) if any(late) else longest.rhythm
        frames = round(first * float(self.grid.rate))
        windows = tuple((start + frames, length) for start, length in longest.windows)
        members = tuple(
            Scene(
                member, self.grid, "", figure.shifted(place), figure.movement if figure.n_frames > 1 else None,
                rhythm, windows, (), (), numbers=_numbers(as_read, own, truth),
            )
            for (member, as_read, figure, own), place in zip(takes, shifts, strict=True)
        )  # fmt: skip
        kept = replace(item, members=tuple(member for member, *_ in takes))
        return Scene(kept, self.grid, longest.field, None, None, rhythm, windows, (), tuple(notes), members)

    @override
    def about(self) -> dict[str, Any]:
        return {**self.scenes.about(), "groups": len(self.items), "wall": True}

    @override
    def changed(self) -> bool:
        return self.scenes.changed()

    def longest(self, wall: Item) -> Item:
        """Return the clip of `scenes` whose field and windows are those of a wall: its longest."""
        return max((item for item, _ in self._takes[wall.number][1][:MOST]), key=lambda item: item.n_frames)

    def first(self, wall: Item) -> Item:
        """Return the clip of `scenes` that begins first in the song of a wall."""
        return min((item for item, _ in self._takes[wall.number][1][:MOST]), key=self.second)

    def wall_of(self, item: Item) -> Item:
        """Return the wall that a clip of `scenes` stands on; UsageError if it stands on none."""
        for wall, (_, takes) in zip(self.items, self._takes, strict=True):
            if any(shown.id == item.id for shown, _ in takes[:MOST]):
                return wall
        raise UsageError("this clip is on no wall", where=self.place, found=item.id)

    def _wall(self, number: int, name: str, takes: list[tuple[Item, str]]) -> Item:
        members, items = [], [item for item, _ in takes[:MOST]]
        begin = min(map(self.second, items))
        end = max(self.second(item) + self.grid.seconds(item.n_frames) for item in items)
        n_frames = self.grid.frames_up(end - begin)
        for k, (item, called) in enumerate(takes[:MOST]):
            name_of_clip = f"{item.sample or item.clip.id} {called}" if self.comparisons else item.clip.id
            clip = replace(item.clip, id=name_of_clip, group=name, member=k, role="")
            members.append(replace(item, number=number, called=called, clip=clip, n_frames=n_frames))
        return replace(members[0], members=tuple(members), n_source=len(takes), called="")

    def _figure(self, wall: Item, number: int, longest: Scene, field: str | None) -> tuple[Figure, Rhythm]:
        """Return a dancer of a wall, and the rhythm of his music."""
        if self.comparisons and number:
            return self.comparisons[number - 1].figure(longest), longest.rhythm
        item = self._takes[wall.number][1][number][0]
        scene = longest if item is longest.item else self.scenes.scene(item, field)
        if scene.figure is None:
            raise DataError("; ".join(scene.notes) or "no figure", reason="missing_joints")
        return scene.figure, scene.rhythm


@dataclass(frozen=True, eq=False)
class WallSounds:
    """The music of walls, from the second of its song at which the first of their clips begins."""

    wall: Wall
    sounds: Sounds

    def sound(self, item: Item) -> ClipSound | None:
        """Return the music of a wall; None without any. DataError if it cannot be decoded."""
        return self.sounds.sound(replace(self.wall.first(item), n_frames=item.n_frames))


def places(figures: Sequence[Figure]) -> list[np.ndarray]:
    """Return the shift (3,) of each figure: its first root onto its place, its floor onto 0."""
    wide = max(float(np.ptp(figure.joints[:, 0, 0])) for figure in figures) + 1.0
    step, shifts = min(max(wide, _NEAR_M), _FAR_M), []
    for number, figure in enumerate(figures):
        row = number // ROW
        in_row = min(ROW, len(figures) - row * ROW)
        x = (number % ROW - (in_row - 1) / 2) * step
        root = figure.joints[0, 0]
        shifts.append(np.array([x - root[0], -figure.floor, -row * _BEHIND_M - root[2]]))
    return shifts


def _numbers(figure: Figure, rhythm: Rhythm, truth: Figure | None) -> tuple[tuple[str, str], ...]:
    """Return the measures of a figure, name and value as text, without undefined ones: those of `evaluate`."""
    beats = MusicBeats(np.round(rhythm.beats * 1000).astype(np.int64), FrameGrid.of(1000), rhythm.beats)
    scores: dict[str, float | None] = {}
    with suppress(DanceDataError):
        pose = Pose(figure.joints, figure.skeleton.joints, figure.grid)
        scores = PROTOCOLS.get(PROTOCOL)().clip_scores(pose, beats if rhythm.field else None)
    numbers = [("BAS", "" if (bas := scores.get("bas")) is None else f"{bas:.3f}")]
    numbers.append(("sliding", f"{100 * figure.sliding:.1f} cm/s" if figure.n_frames > 1 else ""))
    numbers.append(("PFC", "" if (value := scores.get("pfc")) is None else f"{value:.3g}"))
    numbers = [(name, text) for name, text in numbers if text]
    if truth is not None and figure is not truth:
        distance = truth.shifted(-truth.joints[0, 0]).distance_mm(figure.shifted(-figure.joints[0, 0]))
        if np.isfinite(distance).any():
            numbers.append(("distance", f"{np.nanmean(distance):.0f} mm"))
    return tuple(numbers)
