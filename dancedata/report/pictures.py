"""Pictures that are not charts: paths of the root, strips of columns, the heat map of a clip as a PNG."""

import base64
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns
from dancedata.core.text import counted
from dancedata.report.markup import escaped, number
from dancedata.report.svg import drawn

#: Most rows and columns of a heat map; more are left out evenly.
_ROWS, _FRAMES = 320, 900
#: Most columns of a group in the strips.
_STRIPS = 200
#: Size of a path's square, and of a group's strips.
_SQUARE, _PANEL = 130.0, (760.0, 64.0)
#: Least height of a group of the heat map, so that its name can be read; narrow fields have room for it.
_NAME = 14
#: Corners of the palette, dark to light (of equal steps in lightness), and its number of colours.
_PALETTE = ((13, 8, 60), (60, 20, 120), (150, 40, 110), (225, 95, 60), (250, 180, 60), (252, 250, 190))
_COLOURS = 32


def paths(clips: Mapping[str, Sequence[Sequence[float]]], links: Mapping[str, str]) -> str:
    """Return the paths of roots seen from above, all at one scale, under the links of their clips."""
    reach = max((abs(v) for path in clips.values() for point in path for v in point), default=1.0) or 1.0
    cells = [f"<li>{links[clip]}{_path(clip, path, reach)}</li>" for clip, path in clips.items()]
    return f'<ul class="paths">{"".join(cells)}</ul>'


def _path(clip: str, path: Sequence[Sequence[float]], reach: float) -> str:
    half = _SQUARE / 2

    def place(point: Sequence[float]) -> str:
        return f"{half + point[0] / reach * (half - 8):.1f} {half + point[1] / reach * (half - 8):.1f}"

    line = "L".join(map(place, path))
    first, last = (place(p).split() for p in (path[0], path[-1]))
    body = (
        f'<rect class="frame" x="1" y="1" width="{_SQUARE - 2}" height="{_SQUARE - 2}" rx="4"/>'
        f'<path class="grid" d="M{half} 8V{_SQUARE - 8}M8 {half}H{_SQUARE - 8}"/><path class="way" d="M{line}"/>'
        f'<circle class="s0" cx="{first[0]}" cy="{first[1]}" r="3.5"/>'
        f'<circle class="end" cx="{last[0]}" cy="{last[1]}" r="3.5"/>'
    )
    return drawn(body, f"path of {clip}, from above", _SQUARE, _SQUARE)


Row = Mapping[str, Any]


def strips(columns: Columns, rows: Sequence[Row], other: Mapping[str, Row] | None = None) -> str:
    """Return a panel for each group of columns: range, quartiles and median of each column.

    Parameters
    ----------
    other
        Rows of another dataset by the name of their column: the outlines of their ranges.
    """
    panels = []
    for group in columns.groups:
        lines = list(rows[columns.slice(group.name)])
        step = -(-len(lines) // _STRIPS)
        panels.append(_panel(f"{group.name}, {group.unit}", lines[::step], len(lines), step, other or {}))
    return f'<div class="scroll">{"".join(panels)}</div>'


def _panel(title: str, rows: Sequence[Row], n: int, step: int, other: Mapping[str, Row]) -> str:
    both = [*rows, *(other[r["label"]] for r in rows if r["label"] in other)]
    low, high = min(r["min"] for r in both), max(r["max"] for r in both)
    (width, height), left, top = _PANEL, 62.0, 16.0

    def y(value: float) -> float:
        return float(top + (height - top - 6) * (1 - (value - low) / ((high - low) or 1)))

    each = (width - left - 6) / len(rows)
    thinned = f", one of {step} is drawn" if step > 1 else ""
    told = f"{title.removesuffix(', 1')}: {counted(n, 'column')}{thinned}"  # a unit of 1 says nothing
    body = f'<text x="{left}" y="11" text-anchor="start">{escaped(told)}</text>'
    for value in dict.fromkeys((low, high)):
        body += f'<text x="{left - 5}" y="{y(value) + 4:.1f}" text-anchor="end">{number(value)}</text>'
        body += f'<path class="grid" d="M{left} {y(value):.1f}H{width - 6}"/>'
    for k, row in enumerate(rows):
        x, thick = left + (k + 0.5) * each, min(8.0, each * 0.7)
        constant = row["max"] - row["min"] < 1e-6
        text = f"{row['label']}: " + ", ".join(f"{q} {number(v)}" for q, v in row.items() if q != "label")
        body += (
            f'<g class="{"constant" if constant else "s0"}"><title>{escaped(text)}</title>'
            f'<path class="whisker" d="M{x:.1f} {y(row["min"]):.1f}V{y(row["max"]):.1f}"/>'
            f'<rect x="{x - thick / 2:.1f}" y="{y(row["p75"]):.1f}" width="{thick:.1f}" '
            f'height="{max(1.0, y(row["p25"]) - y(row["p75"])):.1f}"/>'
            + (f'<path class="cross" d="M{x - 3:.1f} {y(low) - 3:.1f}l6 6m0 -6l-6 6"/>' if constant else "")
            + "</g>"
        )
        if row["label"] in other:
            beside = other[row["label"]]
            top_of, wide = y(beside["max"]), max(2.0, each * 0.9)
            body += (
                f'<rect class="other thin" x="{x - wide / 2:.1f}" y="{top_of:.1f}" width="{wide:.1f}" '
                f'height="{max(1.0, y(beside["min"]) - top_of):.1f}"/>'
            )
    return drawn(body, f"ranges of {title}", height, width, "panel")


def heat_map(rows: npt.NDArray[Any], columns: Columns, label: str) -> str:
    """Return rows (T, D) as an image, a line a column, each scaled by its own 2nd and 98th percentile."""
    values = np.asarray(rows, dtype=np.float64)[:: -(-len(rows) // _FRAMES)]
    kept = np.arange(0, values.shape[1], -(-values.shape[1] // _ROWS))
    values = values[:, kept].T
    low, high = np.percentile(values, (2, 98), axis=1, keepdims=True)
    flat = high <= low
    low, high = (
        np.where(flat, values.min(axis=1, keepdims=True), low),
        np.where(flat, values.max(axis=1, keepdims=True), high),
    )
    scaled = np.clip((values - low) / np.where(high > low, high - low, 1), 0, 1)
    image = base64.b64encode(_png((scaled * (_COLOURS - 1)).round().astype(np.uint8))).decode()
    names, least = "", len(kept)
    for group in columns.groups:
        span = columns.slice(group.name)
        inside = np.flatnonzero((kept >= span.start) & (kept < span.stop))
        if len(inside):
            least = min(least, len(inside))
            names += f'<li style="flex:{len(inside)} 0 0">{escaped(group.name.replace("_", " "))}</li>'
    height = int(np.clip(len(kept) * max(7, _NAME / least), 120, 520))
    return (
        f'<div class="heat" style="height:{height}px"><ul>{names}</ul>'
        f'<img alt="{escaped(label)}" src="data:image/png;base64,{image}"></div>'
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
