"""The timeline of a video: music, and a dancer's speed and contacts or a group's contacts and distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.rotations import Float64Array
from dancedata.core.tracks import runs
from dancedata.plot.dancers import Dancer
from dancedata.scene.palette import Theme
from dancedata.scene.scene_list import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

#: Colours by theme; those of dancers are in `dancers` and in the viewer's palette.
THEMES: dict[Theme, dict[str, str]] = {
    "dark": {
        "bg": "#14161a", "panel": "#1b1e24", "ink": "#e8eaed", "dim": "#98a1ad", "grid": "#2f3540",
        "shadow": "#08090b", "path": "#f2b84b", "contact": "#2fbf9b", "wave": "#7a8698",
    },
    "light": {
        "bg": "#f6f7f8", "panel": "#ffffff", "ink": "#1c2126", "dim": "#5c6570", "grid": "#d3d8de",
        "shadow": "#8a929c", "path": "#8a5a00", "contact": "#00866a", "wave": "#77828f",
    },
}  # fmt: skip
#: matplotlib's own font, whatever a user has set for figures; at 72 dots per inch a point is a pixel.
FONT: dict[str, Any] = {"family": "DejaVu Sans", "usetex": False, "parse_math": False}
DPI = 72
#: Share of the width after the lanes.
_RIGHT = 0.015


@dataclass(frozen=True, eq=False)
class Timeline:
    """Draws the lanes of a scene on axes, seconds to the right, lanes downwards; see `Frames` for the music."""

    axes: Axes
    scene: Scene
    dancers: Sequence[Dancer]
    theme: Theme
    music: AudioSignal | None

    def draw(self) -> Line2D:
        """Draw the lanes; returns the cursor, which stands at 0 and is drawn by the caller."""
        colours, axes = THEMES[self.theme], self.axes
        length = max(self.scene.seconds, 1e-9) / (1 - self._left - _RIGHT)
        axes.set(
            xlim=(-self._left * length, (1 - self._left) * length), xticks=(), yticks=(), facecolor=colours["panel"]
        )
        for spine in axes.spines.values():
            spine.set_visible(False)
        end = self._speed(self._music(0.4))
        for dancer in self.dancers:
            end = self._contacts(end, dancer)
        axes.vlines(self.scene.rhythm.beats, 0.4, end, colors=colours["path"], linewidths=0.5)
        axes.set_ylim(self._apart(end) + 0.3, 0)
        return axes.axvline(0.0, color=colours["path"], linewidth=2, animated=True)

    @cached_property
    def _text(self) -> int:
        """Size of the names, pixels."""
        return max(11, int(min(self.axes.figure.bbox.size)) // 52)

    @cached_property
    def _left(self) -> float:
        """Share of the width before the lanes, where their names are."""
        return max(0.085, 5.6 * self._text / self.axes.bbox.width)

    def _name(self, name: str, y: float, colour: str = "") -> None:
        x, place = 1.4 * self._text / self.axes.bbox.width, self.axes.get_yaxis_transform()
        fill = colour or THEMES[self.theme]["dim"]
        self.axes.text(x, y, name, transform=place, va="center_baseline", color=fill, size=self._text, **FONT)

    def _curve(self, values: Float64Array, rate: float, delay: float, ground: float, colour: str) -> None:
        """Draw values of 0 to 1 above the ground."""
        times = np.arange(len(values)) / rate
        inside = times <= self.scene.seconds
        self.axes.plot(times[inside] + delay, ground - 1.8 * values[inside], color=colour, linewidth=1)

    def _spans(self, on: npt.NDArray[np.bool_], rate: float, y: float, height: float, colour: str) -> None:
        spans = [(begin / rate, (end - begin) / rate) for begin, end in runs(on)]
        self.axes.broken_barh(spans, (y, height), facecolors=colour)

    def _music(self, top: float) -> float:
        """Draw the waveform, the largest magnitude of each two pixels, or else the onsets."""
        self._name("music", top + 0.9)
        rhythm, colour = self.scene.rhythm, THEMES[self.theme]["wave"]
        if self.music is None:
            self._curve(rhythm.onset, rhythm.onset_rate, 0.0, top + 1.8, colour)
            return top + 2.0
        samples = np.abs(np.asarray(self.music.samples, dtype=np.float64))
        samples = samples[: round(self.scene.seconds * self.music.sample_rate)]
        columns = int(self.axes.bbox.width * (1 - self._left - _RIGHT) / 2)
        first = np.unique(np.linspace(0, len(samples), columns, endpoint=False).astype(np.int64))
        if len(samples):
            peaks = np.maximum.reduceat(samples, first)
            peaks *= 0.9 / max(float(peaks.max()), 1e-9)
            middle = top + 0.9
            times = first / self.music.sample_rate
            self.axes.fill_between(times, middle - peaks, middle + peaks, step="post", color=colour, linewidth=1)
        return top + 2.0

    def _speed(self, top: float) -> float:
        movement = self.scene.movement
        if movement is None:
            return top
        rate, peak = float(movement.grid.rate), float(movement.speed.max(initial=0.0)) or 1.0
        self._name("speed", top + 1.1)
        self._curve(movement.speed / peak, rate, 0.5 / rate, top + 2.0, THEMES[self.theme]["ink"])
        return top + 2.2

    def _contacts(self, top: float, dancer: Dancer) -> float:
        """Draw the contacts of each foot joint of a single dancer, of each side of one of a group."""
        figure = dancer.figure
        sides = np.array([figure.sides[joint] for joint in figure.contact_joints])
        lane = 1.0 if self.scene.members else 2.2
        self._name(dancer.name or "contact", top + lane / 2, dancer.sides[0] if self.scene.members else "")
        rows = (
            [(side, sides == side) for side in (1, 2)] if self.scene.members
            else [(sides[foot], np.arange(4) == foot) for foot in np.argsort(sides, kind="stable")]
        )  # fmt: skip
        for k, (side, feet) in enumerate(rows):
            on, high = np.asarray(figure.contacts[:, feet].any(axis=1)), 0.85 * lane / len(rows)
            self._spans(on, float(figure.grid.rate), top + 0.1 * lane + k * high, 0.7 * high, dancer.sides[side])
        return top + lane

    def _apart(self, top: float) -> float:
        """Draw the least distance of two dancers of a group, and where any collide."""
        together, colours = self.scene.together, THEMES[self.theme]
        if together is None or not together.pairs:
            return top
        rate = float(together.grid.rate)
        least = np.min([pair.distance_m for pair in together.pairs], axis=0)
        self._name("apart", top + 1.1)
        self._curve(least / max(float(least.max()), 1e-9), rate, 0.0, top + 2.0, colours["ink"])
        self._name("collide", top + 2.5)
        meet = np.any([pair.collides for pair in together.pairs], axis=0)
        self._spans(meet, rate, top + 2.3, 0.4, colours["path"])
        return top + 2.8
