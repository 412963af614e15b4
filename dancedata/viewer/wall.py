"""Walls: several motions to one music, side by side on one stage."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dancedata.core.dance import Dance, MusicBeats, Undefined
from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.physical_contact import pfc
from dancedata.viewer.comparisons import Comparison
from dancedata.viewer.figure import Figure
from dancedata.viewer.scene_list import Item, Rhythm, Scene, SceneList
from dancedata.viewer.source import ClipSound, Sounds

#: Joints that the beats of a motion are of, those that SMPL and SMPL-X share, as `evaluate` takes them.
_BODY = 22
#: Most dancers on a wall, and in a row of it.
MOST, ROW = 12, 4
#: Least and greatest distance of neighbours in a row, and between rows, metres.
_NEAR_M, _FAR_M, _BEHIND_M = 1.5, 3.0, 2.2


class Wall(SceneList):
    """Walls of up to `MOST` dancers: each clip beside what it is compared with, or the clips of each song.

    Every dancer begins at a place of his own, on one floor; where he goes from there, and which way he faces, is as
    it was. A wall is as long as the longest. Figures are drawn at the rate of the first; one that ends earlier stands
    still, and is measured without that.

    Parameters
    ----------
    scenes
        Whose items are shown; groups are left out.
    comparisons
        Motions that stand beside each clip; without any, a wall is a song.
    name
        What the clips themselves are called beside others.
    apart
        Whether each has a place of his own; if not, all are drawn where they are, one over the other.

    Raises
    ------
    UsageError
        If there are fewer than two motions for every wall.
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
            raise UsageError(
                "a wall needs two motions to one music", where=scenes.place,
                fix="name others with --compare, or show a dataset in which several clips have one song",
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
        songs: dict[str, list[tuple[Item, str]]] = {}
        for item in single:
            if not item.source:  # not beside its own copies
                songs.setdefault(item.clip.music, []).append((item, item.clip.dancer or item.id))
        return [(song or self._name, takes) for song, takes in songs.items() if len(takes) > 1]

    @override
    def scene(self, item: Item, field: str | None = None, *, first_s: float | None = None) -> Scene:
        # Numbers are of whole motions, so all is read.
        longest = self.scenes.scene(self.longest(item), field)
        notes, grid = list(longest.notes), None
        if self._left_out or item.n_source > len(item.members):
            named = listed(self._left_out) or counted(item.n_source - len(item.members), "further dancer")
            notes.append(f"a wall has {MOST} dancers at most; left out: {named}")
        takes: list[tuple[Item, Figure, Figure]] = []
        for number, member in enumerate(item.members):
            try:
                figure = self._figure(item, number, longest, field)
            except DanceDataError as error:
                notes.append(f"{member.part}: {error}")
                continue
            grid = grid or figure.grid
            if figure.n_frames / float(figure.grid.rate) < longest.seconds - 1 / float(grid.rate):
                notes.append(f"{member.part} ends at {figure.n_frames / float(figure.grid.rate):.2f} s")
            takes.append((member, figure, figure.resampled(grid, longest.seconds)))
        if not takes:
            raise DataError("nothing of this wall can be drawn", reason="missing_joints", found="; ".join(notes))
        truth = takes[0][1] if self.comparisons and takes[0][0].clip.member == 0 else None
        shifts = places([figure for _, _, figure in takes]) if self._apart else [np.zeros(3)] * len(takes)
        members = tuple(
            Scene(
                member, self.grid, "", figure.shifted(place), figure.movement if figure.n_frames > 1 else None,
                longest.rhythm, longest.windows, (), (), numbers=_numbers(as_read, longest.rhythm, truth),
            )
            for (member, as_read, figure), place in zip(takes, shifts, strict=True)
        )  # fmt: skip
        kept = replace(item, members=tuple(member for member, _, _ in takes))
        return Scene(
            kept, self.grid, longest.field, None, None, longest.rhythm, longest.windows, (), tuple(notes), members
        )

    @override
    def about(self) -> dict[str, Any]:
        return {**self.scenes.about(), "groups": len(self.items), "wall": True}

    @override
    def changed(self) -> bool:
        return self.scenes.changed()

    def longest(self, wall: Item) -> Item:
        """Return the clip of `scenes` whose length, music, beats and windows are those of a wall: its longest."""
        return max((item for item, _ in self._takes[wall.number][1][:MOST]), key=lambda item: item.n_frames)

    def wall_of(self, item: Item) -> Item:
        """Return the wall that a clip of `scenes` stands on; UsageError if it stands on none."""
        for wall, (_, takes) in zip(self.items, self._takes, strict=True):
            if any(shown.id == item.id for shown, _ in takes[:MOST]):
                return wall
        raise UsageError("this clip stands on no wall", where=self.place, found=item.id)

    def _wall(self, number: int, name: str, takes: list[tuple[Item, str]]) -> Item:
        members, n_frames = [], max(item.n_frames for item, _ in takes[:MOST])
        for k, (item, called) in enumerate(takes[:MOST]):
            name_of_clip = f"{item.clip.id} {called}" if self.comparisons else item.clip.id
            clip = replace(item.clip, id=name_of_clip, group=name, member=k, role="")
            members.append(replace(item, number=number, called=called, clip=clip, n_frames=n_frames))
        return replace(members[0], members=tuple(members), n_source=len(takes), called="")

    def _figure(self, wall: Item, number: int, longest: Scene, field: str | None) -> Figure:
        if self.comparisons and number:
            return self.comparisons[number - 1].figure(longest)
        item = self._takes[wall.number][1][number][0]
        scene = longest if item is longest.item else self.scenes.scene(item, field)
        if scene.figure is None:
            raise DataError("; ".join(scene.notes) or "no figure", reason="missing_joints")
        return scene.figure


@dataclass(frozen=True, eq=False)
class WallSounds:
    """The music of walls: that of their longest clips."""

    wall: Wall
    sounds: Sounds

    def sound(self, item: Item) -> ClipSound | None:
        """Return the music of a wall; None without any. DataError if it cannot be decoded."""
        return self.sounds.sound(self.wall.longest(item))


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
    """Return the measures of a figure, name and value as text, without undefined ones."""
    numbers = []
    with suppress(Undefined, DanceDataError):
        beats = MusicBeats(np.round(rhythm.beats * 1000).astype(np.int64), FrameGrid.of(1000), rhythm.beats)
        score = BeatAlignment(joints=_BODY).measure(Dance(figure.joints, figure.grid, beats))[0]
        numbers.append(("BAS", f"{score:.3f}"))
    if figure.n_frames > 1:
        numbers.append(("sliding", f"{100 * figure.sliding:.1f} cm/s"))
    with suppress(Undefined, DanceDataError):
        numbers.append(("PFC", f"{pfc(figure.joints, float(figure.grid.rate)):.3g}"))
    if truth is not None and figure is not truth:
        distance = truth.shifted(-truth.joints[0, 0]).distance_mm(figure.shifted(-figure.joints[0, 0]))
        if np.isfinite(distance).any():
            numbers.append(("distance", f"{np.nanmean(distance):.0f} mm"))
    return tuple(numbers)
