"""Frames of a video: the dancers on a floor, and a timeline below."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, filterwarnings

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.packages import load
from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.plot.bodies import Camera, blend, body
from dancedata.plot.dancers import Dancer, dancers_of
from dancedata.plot.timeline import DPI, FONT, THEMES, Timeline
from dancedata.scene.palette import Theme
from dancedata.scene.scene_list import Scene
from dancedata.scene.wall import ROW

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The camera's turn, before a wall, whose dancers stand in rows, and tilt, degrees; the height that it looks at and
#: its distance, metres; the height of the picture at distance 1.
_TURN, _WALL_TURN, _TILT, _LOOK_AT, _DISTANCE, _HIGH = 31.5, 7.0, 11.5, 0.85, 3.9, 0.8
#: Rates at which the camera follows a dancer and a group, per second.
_FOLLOW, _FOLLOW_GROUP = 1.2, 0.5
#: Seconds of the path that are drawn strongly, and at the end in which the credit is shown.
_RECENT_S, _CREDIT_S = 1.5, 2.0
#: A circle on the floor, (P, 3), and the radius of the ring of a contact, metres.
_CIRCLE = np.stack([np.cos(np.arange(32) * np.pi / 16), np.zeros(32), np.sin(np.arange(32) * np.pi / 16)], axis=1)
_RING = 0.085
#: How fast a shadow fades with the height of its joint, per metre, and the darkness below which there is none.
_FADE, _FAINT = 2.4, 0.2


@contextmanager
def _any_letters() -> Iterator[None]:
    """Draw letters that the font does not have as boxes, without a warning for each frame."""
    with catch_warnings():
        filterwarnings("ignore", "Glyph", UserWarning)
        yield


@dataclass(frozen=True, eq=False)
class Frames:
    """Draws the frames of a scene, (height, width, 4) bytes of RGBA each."""

    scene: Scene
    size: tuple[int, int]  # width and height, pixels
    times: Float64Array  # (N,) instants of the frames, seconds
    theme: Theme = "dark"
    credit: str = ""  # line in the picture of the last two seconds
    # samples from the scene's first frame on, for the timeline; None: its onsets are drawn
    music: AudioSignal | None = None

    def __iter__(self) -> Iterator[npt.NDArray[np.uint8]]:
        """Draw what moves over a picture of the rest, which is drawn once."""
        (width, height), colours = self.size, self._colours
        size = {"figsize": (width / DPI, height / DPI), "dpi": DPI, "facecolor": colours["bg"]}
        figure = load("matplotlib.figure", "video", "a video").Figure(**size)
        canvas = load("matplotlib.backends.backend_agg", "video", "a video").FigureCanvasAgg(figure)
        lanes = figure.add_axes((0, 0, 1, self._share), facecolor=colours["panel"])
        cursor = Timeline(lanes, self.scene, self._dancers, self.theme, self.music).draw()
        stage = figure.add_axes((0, self._share, 1, 1 - self._share), animated=True)
        stage.set_axis_off()
        high = _HIGH * self._distance
        wide = high * width / (height * (1 - self._share))
        stage.set(xlim=(-wide / 2, wide / 2), ylim=(-high / 2, high / 2))
        with _any_letters():
            canvas.draw()
        empty = canvas.copy_from_bbox(figure.bbox)
        for time, middle in zip(self.times.tolist(), self._middles, strict=True):
            for artist in (*stage.collections, *stage.lines, *stage.texts):
                artist.remove()
            cursor.set_xdata([time])
            canvas.restore_region(empty)
            with _any_letters():
                self._stage(stage, time, middle)
                figure.draw_artist(stage)
            figure.draw_artist(cursor)
            yield np.array(canvas.buffer_rgba())

    @cached_property
    def _colours(self) -> dict[str, str]:
        return THEMES[self.theme]

    @cached_property
    def _dancers(self) -> list[Dancer]:
        return dancers_of(self.scene, self.theme)

    @cached_property
    def _rate(self) -> float:
        return float(self._dancers[0].figure.grid.rate)

    @cached_property
    def _share(self) -> float:
        """Share of the height that the timeline takes."""
        return min(0.4, 0.17 + 0.025 * len(self._dancers)) if self.scene.members else 0.17

    @cached_property
    def _floor(self) -> float:
        return min(dancer.figure.floor for dancer in self._dancers)

    @cached_property
    def _roots(self) -> Float64Array:
        """Roots of all dancers, (P, T, 3)."""
        n = min(dancer.figure.n_frames for dancer in self._dancers)
        return np.stack([dancer.figure.joints[:n, 0] for dancer in self._dancers])

    @cached_property
    def _reach(self) -> float:
        """Largest distance of a dancer from the middle of the group, metres."""
        return float(np.ptp(self._roots[..., [0, 2]], axis=0).max() / 2)

    @cached_property
    def _distance(self) -> float:
        """Distance of the camera, metres: a narrow picture shows the dancers from farther away."""
        narrow = self.size[1] * (1 - self._share) / self.size[0]
        back = (1 if len(self._dancers) > ROW else 0.55) * self._reach  # rows: the first one is whole
        return (max(_DISTANCE, (2 * self._reach + 1.3) * 1.25 * narrow) + back) * max(1.0, 1.1 * narrow)

    @cached_property
    def _middles(self) -> Float64Array:
        """Points that the camera looks at in each frame, (N, 3): the middle of the roots, smoothed."""
        from scipy.ndimage import gaussian_filter1d

        follow = _FOLLOW_GROUP if self.scene.members else _FOLLOW
        middle = (self._roots.min(axis=0) + self._roots.max(axis=0)) / 2
        smooth = gaussian_filter1d(middle, self._rate / follow, axis=0, mode="nearest")
        middles: Float64Array = smooth[np.minimum((self.times * self._rate).round().astype(int), len(smooth) - 1)]
        middles[:, 1] = self._floor + _LOOK_AT
        return middles

    def _stage(self, axes: Axes, time: float, middle: Float64Array) -> None:
        """Draw the floor, then the dancers, the farthest first, and their names, and the instant."""
        at = min(round(time * self._rate), self._roots.shape[1] - 1)
        turn = _WALL_TURN if any(member.numbers for member in self.scene.members) else _TURN
        camera = Camera(middle, turn, _TILT, self._distance)
        self._grid(axes, camera)
        dancers = sorted(self._dancers, key=lambda dancer: float(camera(dancer.figure.joints[at, 0])[2]))
        for dancer in dancers:
            self._path(axes, camera, dancer, at)
            self._under(axes, camera, dancer, at)
        for number, dancer in enumerate(dancers):
            axes.add_artist(body(dancer.figure, at, camera, dancer.sides, (0.0, 0.0), zorder=3 + number))
        self._names(axes, camera, dancers, at)
        self._clock(axes, time, at)

    def _flat(self, places: Float64Array) -> Float64Array:
        """Return places (..., 3) on the floor."""
        return places * (1, 0, 1) + (0, self._floor, 0)

    def _grid(self, axes: Axes, camera: Camera) -> None:
        """Draw lines each half a metre."""
        reach = 3.0 + np.ceil(self._reach)
        x, _, z = np.round(camera.middle * 2) / 2
        k = np.arange(-reach, reach + 0.01, 0.5)
        ends = np.stack([np.full(len(k), -reach), np.full(len(k), reach)], axis=1)
        across, along = np.stack([ends, k[:, None] + 0 * ends]), np.stack([k[:, None] + 0 * ends, ends])
        lines = self._flat(np.stack([across + x, 0 * across, along + z], axis=-1).reshape(-1, 2, 3))
        collection = load("matplotlib.collections", "video", "a video").LineCollection
        axes.add_artist(collection(camera(lines)[..., :2], colors=self._colours["grid"], linewidths=1, zorder=0))

    def _path(self, axes: Axes, camera: Camera, dancer: Dancer, at: int) -> None:
        """Draw the way of the root: all of it of a single dancer, and strongly the last of it."""
        way = camera(self._flat(dancer.figure.joints[:, 0]))[:, :2]
        recent, colour = way[max(0, at - round(_RECENT_S * self._rate)) : at + 1], dancer.sides[0]
        if not self.scene.members:
            axes.plot(*way.T, color=self._colours["dim"], linewidth=1, zorder=1)
            colour = self._colours["path"]
        axes.plot(*recent.T, color=colour, linewidth=2.5, zorder=1)

    def _under(self, axes: Axes, camera: Camera, dancer: Dancer, at: int) -> None:
        """Draw a shadow on the floor under each joint, the darker the lower it is, and rings of feet in contact."""
        figure, discs = dancer.figure, load("matplotlib.collections", "video", "a video").PolyCollection
        joints, scale = figure.joints[at], figure.limbs.scale
        high = np.maximum(0.0, joints[:, 1] - self._floor) / scale
        dark = np.exp(-_FADE * np.maximum(0.0, high - 0.03))
        radii = (0.06 + np.max(figure.limbs.girths, axis=1) + 0.1 * high) * scale
        order = np.argsort(dark, kind="stable")
        order = order[dark[order] >= _FAINT]
        for size, strength in ((1.0, 0.45), (0.65, 0.9)):
            circles = self._flat(joints[order])[:, None] + (size * radii[order])[:, None, None] * _CIRCLE
            tones = [blend(self._colours["shadow"], self._colours["bg"], round(strength * dark[k], 2)) for k in order]
            axes.add_artist(discs(camera(circles)[..., :2], facecolors=tones, edgecolors="none", zorder=1))
        feet = joints[[joint for joint, on in zip(figure.contact_joints, figure.contacts[at], strict=True) if on]]
        rings = camera(self._flat(feet)[:, None] + _RING * _CIRCLE)[..., :2]
        ring = {"facecolors": "none", "edgecolors": self._colours["contact"], "linewidths": 2, "zorder": 2}
        axes.add_artist(discs(rings, **ring))

    def _names(self, axes: Axes, camera: Camera, dancers: Sequence[Dancer], at: int) -> None:
        """Write the names of the dancers of a group above their heads, each above those that stand there."""
        pen: Any = axes.figure.canvas
        pen, taken = pen.get_renderer(), list[Any]()
        size = max(11, min(self.size) // 48)
        for dancer in dancers if self.scene.members else ():
            places = camera(dancer.figure.joints[at])
            x, y = float(places[0, 0]), float(places[:, 1].max()) + 0.2
            if not np.isfinite((x, y)).all():
                continue
            text = axes.text(x, y, dancer.name, color=dancer.sides[0], size=size, ha="center", zorder=99, **FONT)
            while any(text.get_window_extent(pen).overlaps(box) for box in taken):
                y += 0.1
                text.set_y(y)
            taken.append(text.get_window_extent(pen))

    def _clock(self, axes: Axes, time: float, at: int) -> None:
        """Write the clip, the instant and the credit, and draw a disc at each beat."""
        width, height = self.size[0], round(self.size[1] * (1 - self._share))
        size, margin = max(12, min(self.size) // 42), min(self.size) / 36
        text: dict[str, Any] = {"transform": axes.transAxes, "zorder": 99, **FONT}
        x, y = margin / width, 1 - margin / height
        axes.text(x, y, shown(self.scene.item.id, 80), color=self._colours["ink"], size=size, va="top", **text)
        y -= 1.5 * size / height
        axes.text(x, y, f"{time:.2f} s   frame {at}", color=self._colours["dim"], size=size, va="top", **text)
        past = self.scene.rhythm.beats[self.scene.rhythm.beats <= time + 1e-9]
        if len(past) and time - past[-1] < 0.12:
            disc: dict[str, Any] = {"marker": "o", "markersize": 1.2 * margin, "color": self._colours["path"]}
            axes.plot(1 - 2 * x, 1 - 2 * margin / height, transform=axes.transAxes, **disc)
        if self.credit and float(self.times[-1]) - time < _CREDIT_S:
            size = max(9, min(self.size) // 60)
            axes.text(x, margin / 3 / height, self.credit, color=self._colours["ink"], size=size, wrap=True, **text)
