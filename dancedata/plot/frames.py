"""Frames of a video: a dancer on the floor, and a timeline of music, speed and contacts below."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.packages import load
from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.core.tracks import runs
from dancedata.plot.bodies import draw_body, draw_shadow
from dancedata.plot.meshes import draw_mesh
from dancedata.viewer import Figure, Scene
from dancedata.viewer.palette import Theme

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw


#: Frames are drawn larger and made smaller, which smooths edges.
FINER = 2
#: Share of the height that the timeline takes.
TIMELINE = 0.17
#: Share of the width that the names of lanes take.
_NAMES = 0.085


@dataclass(frozen=True, eq=False)
class Timeline:
    """The lanes below the dancer: music with beats, speed with key motions, contacts.

    Attributes
    ----------
    music
        Samples of the music from the scene's first frame on; None: its onsets are drawn.
    """

    scene: Scene
    figure: Figure
    size: tuple[int, int]
    colours: Mapping[str, str]
    music: AudioSignal | None = None

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
        self._music(draw, top, lane, 4.4)
        if self.scene.movement is not None:
            speed, rate = self.scene.movement.speed, float(self.scene.movement.grid.rate)
            peak = float(speed.max(initial=0.0)) or 1.0
            self._name(draw, "speed", top + 3.4 * lane)
            self._curve(draw, speed / peak, rate, 0.5 / rate, top + 4.4 * lane, 1.8 * lane, "ink")
        self._contacts(draw, top + 4.8 * lane, lane * 0.42)

    def _music(self, draw: ImageDraw, top: float, lane: float, end: float) -> None:
        """Draw the waveform, or else the onsets, and beats down to `end` lanes."""
        self._name(draw, "music", top + 1.2 * lane)
        if self.music is not None:
            self._wave(draw, self.music, top + 1.3 * lane, 0.9 * lane)
        else:
            self._curve(
                draw, self.scene.rhythm.onset, self.scene.rhythm.onset_rate, 0.0, top + 2.2 * lane, 1.8 * lane, "wave"
            )
        for beat in self.scene.rhythm.beats:
            draw.line(
                [(self.x(beat), top + 0.4 * lane), (self.x(beat), top + end * lane)],
                fill=self.colours["path"],
                width=1,
            )

    def _wave(self, draw: ImageDraw, music: AudioSignal, middle: float, height: float) -> None:
        """Draw the largest magnitude of the samples of each two pixels, up and down from the middle."""
        begin, end = self.x(0.0), self.x(self.scene.seconds)
        seconds = np.arange(begin, end, 2 * FINER) - begin
        seconds *= self.scene.seconds / max(end - begin, 1e-9)
        first = np.unique(np.round(seconds * music.sample_rate).astype(int))
        first = first[first < len(music.samples)]
        if not len(first):
            return
        peaks = np.maximum.reduceat(np.abs(np.asarray(music.samples, dtype=np.float64)), first)
        peaks /= max(float(peaks.max()), 1e-9)
        for sample, peak in zip(first.tolist(), peaks.tolist(), strict=True):
            x, half = self.x(sample / music.sample_rate), max(1.0, peak * height)
            draw.line([(x, middle - half), (x, middle + half)], fill=self.colours["wave"], width=2 * FINER)

    def _name(self, draw: ImageDraw, name: str, y: float, colour: str = "") -> None:
        size = max(11, self.size[1] // 52) * FINER
        fill = colour or self.colours["dim"]
        draw.text((self.size[1] // 36 * FINER, y - size * 0.6), name, fill=fill, font=text_font(size))

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
            draw.line(points, fill=self.colours.get(colour, colour), width=FINER)

    def _contacts(self, draw: ImageDraw, top: float, height: float) -> None:
        self._name(draw, "contact", top + 2 * height)
        sides, rate = self.colours["sides"].split(), float(self.figure.grid.rate)
        order = sorted(
            range(len(self.figure.contact_joints)), key=lambda k: self.figure.sides[self.figure.contact_joints[k]]
        )
        for row, foot in enumerate(order):
            colour = sides[self.figure.sides[self.figure.contact_joints[foot]]]
            spans = runs(self.figure.contacts[:, foot])
            self._spans(draw, spans, rate, top + row * height * 1.15, height * 0.8, colour)

    def _spans(
        self,
        draw: ImageDraw,
        spans: Iterable[tuple[int, int]],
        rate: float,
        top: float,
        height: float,
        colour: str,
    ) -> None:
        for begin, end in spans:
            draw.rectangle((self.x(begin / rate), top, self.x(end / rate), top + height), fill=colour)


def text_font(size: float) -> Any:
    """Return the font of Pillow, so that pictures are the same on all machines."""
    return load("PIL.ImageFont", "video").load_default(size)


#: Turn about the vertical axis and downward tilt, radians; height of the target point above the floor, metres.
_YAW, _PITCH, _LOOK_AT = 0.55, 0.2, 0.85
#: Focal length in heights of the picture, and distance of the camera, metres.
_FOCAL, _DISTANCE = 1.25, 3.9
#: Nearest distance that is drawn.
_NEAREST = 0.1


@dataclass(frozen=True)
class Camera:
    """A perspective camera.

    Attributes
    ----------
    width, height
        Of the picture, pixels.
    target
        (x, floor, z) of the point on the floor below the target point, metres.
    distance
        From the target point, metres.
    yaw
        Turn about the vertical, radians; 0 looks along -Z.
    """

    width: int
    height: int
    target: tuple[float, float, float]
    distance: float = _DISTANCE
    yaw: float = _YAW

    @property
    def tilt(self) -> float:
        """Height divided by width of a circle on the floor."""
        return float(np.sin(_PITCH))

    @property
    def towards(self) -> Float64Array:
        """Way from the target point to the camera, (3,) of length 1."""
        flat = float(np.cos(_PITCH))
        return np.array([flat * np.sin(self.yaw), np.sin(_PITCH), flat * np.cos(self.yaw)])

    def __call__(self, places: Float64Array) -> Float64Array:
        """Return places (..., 3), metres, as (..., 3): pixels right and down, and pixels per metre.

        Places behind the camera are NaN.
        """
        x, y, z = np.moveaxis(places - np.asarray(self.target), -1, 0)
        y = y - _LOOK_AT
        across = x * np.cos(self.yaw) - z * np.sin(self.yaw)
        along = x * np.sin(self.yaw) + z * np.cos(self.yaw)
        up = y * np.cos(_PITCH) - along * np.sin(_PITCH)
        near = y * np.sin(_PITCH) + along * np.cos(_PITCH)
        # A narrow picture shows the dancer from farther away.
        away = self.distance * max(1.0, 1.1 * self.height / self.width) - near
        scale = np.where(away > _NEAREST, _FOCAL * self.height / np.where(away > _NEAREST, away, 1.0), np.nan)
        return np.stack([self.width / 2 + across * scale, self.height / 2 - up * scale, scale], axis=-1)


#: Colours of the viewer, by theme.
THEMES: dict[Theme, dict[str, str]] = {
    "dark": {
        "bg": "#14161a", "panel": "#1b1e24", "ink": "#e8eaed", "dim": "#98a1ad", "grid": "#2f3540",
        "shadow": "#08090b",
        "path": "#f2b84b", "contact": "#2fbf9b", "wave": "#7a8698", "sides": "#d5d9df #7accf8 #d48500",
    },
    "light": {
        "bg": "#f6f7f8", "panel": "#ffffff", "ink": "#1c2126", "dim": "#5c6570", "grid": "#d3d8de",
        "shadow": "#8a929c",
        "path": "#8a5a00", "contact": "#00866a", "wave": "#77828f", "sides": "#77818d #2a8ccb #a04c00",
    },
}  # fmt: skip
#: Seconds at the end in which the credit is shown.
_CREDIT_S = 2.0
#: Seconds of the path that are drawn strongly.
_RECENT_S = 1.5
#: Radius of the ring of a contact, metres.
_RING = 0.085
#: Rate at which the camera follows the dancer, per second.
_FOLLOW = 1.2


@dataclass(frozen=True, eq=False)
class Frames:
    """Draws the frames of a clip.

    Attributes
    ----------
    scene, figure
        The clip, and its dancer.
    size
        Width and height, pixels.
    times
        (N,) instants of the frames, seconds.
    credit
        Line in the picture of the last two seconds.
    music
        Samples from the scene's first frame on, for the timeline.
    """

    scene: Scene
    figure: Figure
    size: tuple[int, int]
    times: Float64Array
    theme: Theme = "dark"
    credit: str = ""
    music: AudioSignal | None = None

    def __iter__(self) -> Iterator[bytes]:
        for number in range(len(self.times)):
            yield self.image(number).tobytes()

    def image(self, number: int) -> Image:
        """Return one frame."""
        time = float(self.times[number])
        at = min(round(time * self._rate), self.figure.n_frames - 1)
        stage = load("PIL.Image", "video").new("RGB", self._stage_size, self._colours["bg"])
        self._stage(stage, at, number)
        small = self._empty.copy()
        small.paste(stage.reduce(FINER))
        self._cursor(small, time)
        self._clock(pen(small), time, at)
        if self.credit and float(self.times[-1]) - time < _CREDIT_S:
            self._credit(pen(small))
        return small

    def _credit(self, draw: ImageDraw) -> None:
        """Write the credit at the foot of the stage, in as many lines as it takes."""
        size = max(9, min(self.size) // 60)
        font, width = text_font(size), 0.96 * self.size[0]
        lines = [""]
        for word in self.credit.split():
            longer = f"{lines[-1]} {word}".strip()
            lines = [*lines[:-1], longer] if font.getlength(longer) <= width else [*lines, word]
        foot = round(self.size[1] * (1 - self._share)) - size
        for number, line in enumerate(reversed(lines[:4])):
            at = (0.02 * self.size[0], foot - 1.25 * size * number)
            draw.text(at, line, fill=self._colours["ink"], font=font, anchor="ls", stroke_width=1,
                      stroke_fill=self._colours["bg"])  # fmt: skip

    @property
    def _rate(self) -> float:
        return float(self.figure.grid.rate)

    @cached_property
    def _colours(self) -> dict[str, str]:
        return THEMES[self.theme]

    @cached_property
    def _sides(self) -> list[str]:
        return self._colours["sides"].split()

    @cached_property
    def _timeline(self) -> Timeline:
        return Timeline(self.scene, self.figure, self.size, self._colours, self.music)

    @cached_property
    def _stage_size(self) -> tuple[int, int]:
        width, height = self.size
        return width * FINER, round(height * (1 - self._share)) * FINER

    @property
    def _share(self) -> float:
        """Share of the height that the timeline takes."""
        return TIMELINE

    @cached_property
    def _targets(self) -> Float64Array:
        """Points that the camera looks at in each frame, (N, 3): the root, smoothed."""
        from scipy.ndimage import gaussian_filter1d

        smooth = gaussian_filter1d(self.figure.joints[:, 0], self._rate / _FOLLOW, axis=0, mode="nearest")
        at = np.minimum((self.times * self._rate).round().astype(int), self.figure.n_frames - 1)
        targets: Float64Array = smooth[at]
        targets[:, 1] = self.figure.floor
        return targets

    @cached_property
    def _lanes(self) -> Image:
        """The timeline, larger, below an empty stage."""
        image: Image = load("PIL.Image", "video").new("RGB", [n * FINER for n in self.size], self._colours["bg"])
        self._timeline.draw(pen(image))
        return image

    @cached_property
    def _empty(self) -> Image:
        """A frame with the timeline and without the dancer."""
        return self._lanes.reduce(FINER)

    def _stage(self, stage: Image, at: int, number: int) -> None:
        (width, height), draw = stage.size, pen(stage)
        x, floor, z = self._targets[number].tolist()
        camera = Camera(width, height, (x, floor, z))
        self._floor(draw, camera)
        self._path(draw, camera, at)
        self._under(draw, camera, self.figure, at, floor)
        draw_dancer(stage, camera, self.figure, at, self._sides)

    def _floor(self, draw: ImageDraw, camera: Camera, reach: float = 3.0) -> None:
        x, floor, z = camera.target
        middle = np.round(np.array([x, z]) * 2) / 2
        for k in np.arange(-reach, reach + 0.01, 0.5):
            ends = [(middle[0] + k, middle[1] - reach), (middle[0] + k, middle[1] + reach)]
            for a, b in (ends, [(middle[0] - reach, middle[1] + k), (middle[0] + reach, middle[1] + k)]):
                self._line(
                    draw, camera(np.array([[a[0], floor, a[1]], [b[0], floor, b[1]]])), self._colours["grid"], 2
                )

    def _path(self, draw: ImageDraw, camera: Camera, at: int) -> None:
        way = self.figure.joints[:, 0].copy()
        way[:, 1] = self.figure.floor
        self._line(draw, camera(way[::2]), self._colours["dim"], 2)
        recent = way[max(0, at - round(_RECENT_S * self._rate)) : at + 1]
        self._line(draw, camera(recent), self._colours["path"], 5)

    def _line(self, draw: ImageDraw, places: Float64Array, colour: str, width: int) -> None:
        """Draw a line through places; it stops at those behind the camera."""
        behind = np.flatnonzero(~np.isfinite(places).all(axis=1))
        for part in np.split(places, behind):
            points = [(x, y) for x, y, scale in part.tolist() if math.isfinite(scale)]
            if len(points) > 1:
                draw.line(points, fill=colour, width=width, joint="curve")

    def _under(self, draw: ImageDraw, camera: Camera, figure: Figure, at: int, floor: float) -> None:
        """Draw the shadow, and rings where feet touch the ground."""
        draw_shadow(draw, camera, figure, at, floor, self._colours["shadow"], self._colours["bg"])
        flat = figure.joints[at].copy()
        flat[:, 1] = floor
        for touches, joint in zip(figure.contacts[at], figure.contact_joints, strict=True):
            x, y, scale = camera(flat[joint])
            if touches and np.isfinite(scale):
                a, b = _RING * scale, _RING * scale * max(0.2, camera.tilt)
                draw.ellipse((x - a, y - b, x + a, y + b), outline=self._colours["contact"], width=3 * FINER)

    def _cursor(self, frame: Image, time: float) -> None:
        """Draw the cursor: only what it covers of the timeline is drawn larger."""
        x, top = self._timeline.x(time), self._stage_size[1]
        left = int(x) // FINER - 2
        strip = self._lanes.crop((left * FINER, top, (left + 5) * FINER, self.size[1] * FINER))
        at = x - left * FINER
        pen(strip).line([(at, 0), (at, strip.height)], fill=self._colours["path"], width=2 * FINER)
        frame.paste(strip.reduce(FINER), (left, top // FINER))

    def _clock(self, draw: ImageDraw, time: float, at: int) -> None:
        font = text_font(max(12, self.size[1] // 42))
        margin = self.size[1] // 36
        draw.text((margin, margin), shown(self.scene.item.id, 80), fill=self._colours["ink"], font=font)
        clock = f"{time:.2f} s   frame {at}"
        draw.text((margin, self._stage_size[1] // FINER - 2 * margin), clock, fill=self._colours["dim"], font=font)
        beats = self.scene.rhythm.beats
        past = beats[beats <= time + 1e-9]
        if len(past) and time - past[-1] < 0.12:
            _disc(draw, np.array([self.size[0] - 2 * margin, 2 * margin]), margin * 0.6, self._colours["path"])


def pen(image: Image) -> ImageDraw:
    """Return the drawing context of a picture."""
    drawing: ImageDraw = load("PIL.ImageDraw", "video").Draw(image)
    return drawing


def draw_dancer(stage: Image, camera: Camera, figure: Figure, at: int, tones: Sequence[str]) -> None:
    """Draw a figure at a frame, as its body model or as limbs; `tones` are those of trunk, left and right."""
    if figure.mesh is not None:
        draw_mesh(stage, camera, figure, at, tones)
    else:
        draw_body(pen(stage), camera, figure, at, tones)


def _disc(draw: ImageDraw, centre: Float64Array, radius: float, colour: str) -> None:
    x, y = centre.tolist()
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)
