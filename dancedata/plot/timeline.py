"""The lanes below the dancer of a video: music, speed and contacts over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dancedata.core.packages import load
from dancedata.core.rotations import Float64Array
from dancedata.viewer import Figure, Scene

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

__all__ = ["FINER", "TIMELINE", "Timeline", "text_font"]

#: Frames are drawn larger and made smaller, which smooths edges.
FINER = 2
#: Share of the height that the timeline takes.
TIMELINE = 0.17
#: Share of the width that the names of lanes take.
_NAMES = 0.085


@dataclass(frozen=True, eq=False)
class Timeline:
    """The lanes below the dancer: onsets with beats, speed with key motions, contacts."""

    scene: Scene
    figure: Figure
    size: tuple[int, int]
    colours: Mapping[str, str]

    def x(self, time: float) -> float:
        """Return the place of an instant, pixels of the larger picture."""
        width = self.size[0] * FINER
        return width * (_NAMES + (1 - _NAMES - 0.015) * time / max(self.scene.seconds, 1e-9))

    def draw(self, draw: ImageDraw) -> None:
        """Draw the lanes."""
        width, height = (n * FINER for n in self.size)
        top = round(self.size[1] * (1 - TIMELINE)) * FINER
        draw.rectangle((0, top, width, height), fill=self.colours["panel"])
        lane = (height - top) / 7
        self._name(draw, "music", top + 1.2 * lane)
        self._curve(
            draw, self.scene.rhythm.onset, self.scene.rhythm.onset_rate, 0.0, top + 2.2 * lane, 1.8 * lane, "wave"
        )
        for beat in self.scene.rhythm.beats:
            draw.line(
                [(self.x(beat), top + 0.4 * lane), (self.x(beat), top + 4.4 * lane)],
                fill=self.colours["path"],
                width=1,
            )
        if self.scene.movement is not None:
            speed, rate = self.scene.movement.speed, float(self.scene.movement.grid.rate)
            peak = float(speed.max(initial=0.0)) or 1.0
            self._name(draw, "speed", top + 3.4 * lane)
            self._curve(draw, speed / peak, rate, 0.5 / rate, top + 4.4 * lane, 1.8 * lane, "ink")
        self._contacts(draw, top + 4.8 * lane, lane * 0.42)

    def _name(self, draw: ImageDraw, name: str, y: float) -> None:
        size = max(11, self.size[1] // 52) * FINER
        draw.text((self.size[1] // 36 * FINER, y - size * 0.6), name, fill=self.colours["dim"], font=text_font(size))

    def _curve(
        self,
        draw: ImageDraw,
        values: Float64Array,
        rate: float,
        delay: float,
        bottom: float,
        height: float,
        colour: str,
    ) -> None:
        points = [
            (self.x(k / rate + delay), bottom - height * float(v))
            for k, v in enumerate(values)
            if k / rate <= self.scene.seconds
        ]
        if len(points) > 1:
            draw.line(points, fill=self.colours[colour], width=FINER)

    def _contacts(self, draw: ImageDraw, top: float, height: float) -> None:
        self._name(draw, "contact", top + 2 * height)
        sides, rate = self.colours["sides"].split(), float(self.figure.grid.rate)
        order = sorted(
            range(len(self.figure.contact_joints)), key=lambda k: self.figure.sides[self.figure.contact_joints[k]]
        )
        for row, foot in enumerate(order):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], self.figure.contacts[:, foot].astype(np.int8), [0]])))
            colour = sides[self.figure.sides[self.figure.contact_joints[foot]]]
            for begin, end in edges.reshape(-1, 2):
                y = top + row * height * 1.15
                draw.rectangle((self.x(begin / rate), y, self.x(end / rate), y + height * 0.8), fill=colour)


def text_font(size: float) -> Any:
    """Return Pillow's own font, so that pictures are the same on every machine."""
    return load("PIL.ImageFont", "video").load_default(size)
