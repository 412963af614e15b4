"""Values over time as PNG images, with seconds and beats beside them."""

import base64
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns
from dancedata.pages.markup import escaped, number
from dancedata.pages.svg import ticks

#: Most rows and columns of a heat map; more are left out evenly.
_ROWS, _FRAMES = 320, 900
#: Least height of a group of the heat map, so that its name can be read; narrow fields have room for it.
_NAME = 14
#: Height of the map of joints.
_JOINTS_PX = 240
#: Beats that are marked at most.
_BEATS = 240
#: Corners of the palette, dark to light (of equal steps in lightness), and its number of colours.
_PALETTE = ((13, 8, 60), (60, 20, 120), (150, 40, 110), (225, 95, 60), (250, 180, 60), (252, 250, 190))
_COLOURS = 32


@dataclass(frozen=True)
class Timeline:
    """The time below a heat map: its length, and the instants of the beats, seconds."""

    seconds: float
    beats: Sequence[float] = ()

    def marks(self) -> str:
        """Return the beats, as marks over the map."""
        inside = [beat for beat in self.beats if 0 <= beat <= self.seconds]
        marks = (f'<i style="left:{self._place(beat)}"></i>' for beat in inside)
        return "".join(marks) if len(inside) <= _BEATS else ""

    def axis(self) -> str:
        """Return the seconds, below the map."""
        texts = (f'<span style="left:{self._place(t)}">{number(t)}</span>' for t in ticks(0, self.seconds, 8))
        return f'<div></div><div class="ticks">{"".join(texts)}</div>'

    def _place(self, t: float) -> str:
        return f"{100 * t / (self.seconds or 1):.2f}%"


def joint_map(speed: npt.NDArray[Any], names: Sequence[str], timeline: Timeline, label: str) -> str:
    """Return speeds (T, J) as an image, a line per joint, dark at 0, light at the 98th percentile of all."""
    values = _thinned(speed)
    high = float(np.percentile(values, 98)) if values.size else 0.0
    scaled = np.clip(values.T / (high or 1), 0, 1)
    items = "".join(f'<li style="flex:1 0 0">{escaped(name.replace("_", " "))}</li>' for name in names)
    return _map(scaled, items, timeline, label, _JOINTS_PX, "heat joints")


def heat_map(rows: npt.NDArray[Any], columns: Columns, label: str, timeline: Timeline | None = None) -> str:
    """Return rows (T, D) as an image, a line per column, each scaled by its 2nd and 98th percentile."""
    values = _thinned(rows)
    kept = np.arange(0, values.shape[1], -(-values.shape[1] // _ROWS))
    values = values[:, kept].T
    low, high = np.percentile(values, (2, 98), axis=1, keepdims=True)
    flat = high <= low
    low, high = (
        np.where(flat, values.min(axis=1, keepdims=True), low),
        np.where(flat, values.max(axis=1, keepdims=True), high),
    )
    scaled = np.clip((values - low) / np.where(high > low, high - low, 1), 0, 1)
    names, least = "", len(kept)
    for group in columns.groups:
        span = columns.slice(group.name)
        inside = np.flatnonzero((kept >= span.start) & (kept < span.stop))
        if len(inside):
            least = min(least, len(inside))
            names += f'<li style="flex:{len(inside)} 0 0">{escaped(group.name.replace("_", " "))}</li>'
    height = int(np.clip(len(kept) * max(7, _NAME / least), 120, 520))
    return _map(scaled, names, timeline, label, height, "heat")


def _thinned(rows: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    return np.asarray(rows, dtype=np.float64)[:: -(-len(rows) // _FRAMES) or 1]


def _map(
    scaled: npt.NDArray[np.float64], items: str, timeline: Timeline | None, label: str, height: int, kind: str
) -> str:
    image = base64.b64encode(_png((scaled * (_COLOURS - 1)).round().astype(np.uint8))).decode()
    marks, axis = ("", "") if timeline is None else (timeline.marks(), timeline.axis())
    return (
        f'<div class="{kind}" style="--height:{height}px"><ul>{items}</ul>'
        f'<div class="map"><img alt="{escaped(label)}" src="data:image/png;base64,{image}">{marks}</div>{axis}</div>'
    )


def _png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Return a PNG with a palette of numbers of colours (H, W)."""
    height, width = pixels.shape
    at = np.linspace(0, len(_PALETTE) - 1, _COLOURS)
    corners = np.asarray(_PALETTE, dtype=np.float64)
    palette = np.stack([np.interp(at, range(len(corners)), corners[:, c]) for c in range(3)], axis=1)
    lines = np.concatenate([np.zeros((height, 1), np.uint8), pixels], axis=1).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    chunks = (
        (b"IHDR", header),
        (b"PLTE", palette.round().astype(np.uint8).tobytes()),
        (b"IDAT", zlib.compress(lines, 9)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
