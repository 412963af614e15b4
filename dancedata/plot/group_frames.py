"""Frames of a video of a group: all dancers in one world, and a timeline with a lane for each of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.core.tracks import runs
from dancedata.core.typing import override
from dancedata.plot.frames import _DISTANCE, _RECENT_S, FINER, Camera, Frames, Timeline, draw_dancer, pen, text_font
from dancedata.viewer.figure import Figure
from dancedata.viewer.palette import Theme, colours_of
from dancedata.viewer.scene_list import Scene
from dancedata.viewer.wall import ROW

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

#: Rate at which the camera follows the group, per second.
_FOLLOW = 0.5
#: Turn of the camera before a wall, whose dancers stand in rows, radians.
_WALL_YAW = 0.12
#: Height of the music and of the lane of distances, in lanes of a dancer.
_MUSIC, _APART = 2.4, 2.8


@dataclass(frozen=True, eq=False)
class GroupTimeline(Timeline):
    """The lanes of a group: music, contacts of each dancer, distances and collisions.

    Attributes
    ----------
    theme, share
        Theme of the colours of dancers; share of the picture's height.
    """

    theme: Theme = "dark"
    share: float = 0.3

    @override
    def draw(self, draw: ImageDraw) -> None:
        width, height = (n * FINER for n in self.size)
        top = round(self.size[1] * (1 - self.share)) * FINER
        draw.rectangle((0, top, width, height), fill=self.colours["panel"])
        dancers = self.scene.dancers
        lane = (height - top) / (_MUSIC + len(dancers) + _APART + 0.4)
        self._music(draw, top, lane, _MUSIC + len(dancers))
        for k, dancer in enumerate(dancers):
            self._dancer(draw, dancer, top + (_MUSIC + k) * lane, lane)
        self._pairs(draw, top + (_MUSIC + len(dancers)) * lane, lane)

    def _dancer(self, draw: ImageDraw, dancer: Scene, top: float, lane: float) -> None:
        figure, colours = dancer.figure, colours_of(dancer.item, self.theme)
        self._name(draw, shown(dancer.item.part, 12), top + lane / 2, colours[0])
        if figure is None:
            return
        for row, side in enumerate((1, 2)):
            feet = [k for k, joint in enumerate(figure.contact_joints) if figure.sides[joint] == side]
            spans = runs(np.asarray(figure.contacts[:, feet].any(axis=1)))
            y = top + (0.12 + 0.42 * row) * lane
            self._spans(draw, spans, float(figure.grid.rate), y, 0.3 * lane, colours[side])

    def _pairs(self, draw: ImageDraw, top: float, lane: float) -> None:
        together = self.scene.together
        if together is None or not together.pairs:
            return
        rate = float(together.grid.rate)
        least = np.min([pair.distance_m for pair in together.pairs], axis=0)
        self._name(draw, "apart", top + 0.8 * lane)
        self._curve(draw, least / max(float(least.max()), 1e-9), rate, 0.0, top + 1.6 * lane, 1.3 * lane, "ink")
        meet = runs(np.any([pair.collides for pair in together.pairs], axis=0))
        self._name(draw, "collide", top + 2.3 * lane)
        self._spans(draw, meet, rate, top + 2.1 * lane, 0.4 * lane, self.colours["path"])


@dataclass(frozen=True, eq=False)
class GroupFrames(Frames):
    """Draws the frames of a group; `figure` is one of its dancers, for rate and length."""

    @property
    @override
    def _share(self) -> float:
        return min(0.4, 0.17 + 0.025 * len(self.scene.dancers))

    @cached_property
    @override
    def _timeline(self) -> Timeline:
        return GroupTimeline(
            self.scene, self.figure, self.size, self._colours, self.music, self.theme, self._share
        )  # fmt: skip

    @cached_property
    def _figures(self) -> tuple[tuple[Figure, tuple[str, str, str], str], ...]:
        """Figure, colours and name of each dancer."""
        return tuple(
            (scene.figure, colours_of(scene.item, self.theme), shown(scene.item.part, 20))
            for scene in self.scene.dancers
            if scene.figure is not None
        )

    @cached_property
    def _roots(self) -> Float64Array:
        """Roots of all dancers, (P, T, 3)."""
        return np.stack([figure.joints[:, 0] for figure, _, _ in self._figures])

    @cached_property
    def _reach(self) -> float:
        """Largest distance of a dancer from the middle of the group, metres."""
        return float(np.ptp(self._roots[..., [0, 2]], axis=0).max() / 2)

    @cached_property
    @override
    def _targets(self) -> Float64Array:
        from scipy.ndimage import gaussian_filter1d

        middle = (self._roots.min(axis=0) + self._roots.max(axis=0)) / 2
        smooth = gaussian_filter1d(middle, self._rate / _FOLLOW, axis=0, mode="nearest")
        at = np.minimum((self.times * self._rate).round().astype(int), len(smooth) - 1)
        targets: Float64Array = smooth[at]
        targets[:, 1] = min(figure.floor for figure, _, _ in self._figures)
        return targets

    @override
    def _stage(self, stage: Image, at: int, number: int) -> None:
        (width, height), draw = stage.size, pen(stage)
        x, floor, z = self._targets[number].tolist()
        across = (2 * self._reach + 1.3) * 1.25 * height / width
        yaw = _WALL_YAW if any(dancer.numbers for dancer in self.scene.dancers) else Camera.yaw
        back = (1 if len(self._figures) > ROW else 0.55) * self._reach  # rows: the first one is whole
        camera = Camera(width, height, (x, floor, z), max(_DISTANCE, across) + back, yaw)
        self._floor(draw, camera, 3.0 + np.ceil(self._reach))
        dancers = sorted(self._figures, key=lambda dancer: camera(dancer[0].joints[at, 0])[2])
        for figure, colours, _ in dancers:
            way = figure.joints[max(0, at - round(_RECENT_S * self._rate)) : at + 1, 0].copy()
            way[:, 1] = floor
            self._line(draw, camera(way), colours[0], 4)
        names: list[tuple[float, float, float]] = []
        for figure, _, _ in dancers:
            self._under(draw, camera, figure, at, floor)
        for figure, colours, name in dancers:
            draw_dancer(stage, camera, figure, at, colours)
            self._called(draw, camera(figure.joints[at]), name, colours[0], names)

    def _called(
        self,
        draw: ImageDraw,
        places: Float64Array,
        name: str,
        colour: str,
        names: list[tuple[float, float, float]],
    ) -> None:
        """Write the name of a dancer above the head, above the names that stand there: x, y and half the width."""
        if not np.isfinite(places).all():
            return
        size = max(11, self.size[1] // 48) * FINER
        x, y = float(places[0, 0]), float(places[:, 1].min()) - 0.2 * float(places[0, 2])
        font = text_font(size)
        half = font.getlength(name) / 2
        while any(abs(x - u) < half + wide and abs(y - v) < size for u, v, wide in names):
            y -= 1.1 * size
        names.append((x, y, half))
        draw.text((x, y), name, fill=colour, font=font, anchor="mb")
