"""Draw build.svg, slices.svg and layers.svg: python docs/images/draw.py.

The curves of slices.svg are onset envelopes of a synthetic song, as builds of whole clips and of slices have them.
layers.svg has the layers of pyproject.toml and the first sentences of the packages' docstrings.
Pictures have their own ground and follow the reader's colour scheme, so they are readable on any page.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

import dancedata
from dancedata.core.audio_signal import AudioSignal
from dancedata.synthetic import synthesise_song

ROOT = Path(__file__).resolve().parents[2]
WIDTH = 560
#: (light, dark) by the name of a class. tests/docs/test_site.py measures their contrast.
COLOURS = {
    "ground": ("#ffffff", "#0d1117"),
    "box": ("#eef2f7", "#1c232d"),
    "text": ("#1f2328", "#e6edf3"),
    "muted": ("#4f5863", "#aab4c0"),
    "line": ("#6e7781", "#8b949e"),
    "track": ("#0550ae", "#79b8ff"),
    "window": ("#9a3d00", "#ffa657"),
}


def _style() -> str:
    def rules(scheme: int) -> str:
        colour = {name: both[scheme] for name, both in COLOURS.items()}
        return (
            f".ground{{fill:{colour['ground']}}} .box{{fill:{colour['box']};stroke:{colour['line']}}} "
            f"text{{fill:{colour['text']}}} .muted{{fill:{colour['muted']}}} "
            f".line{{stroke:{colour['line']};fill:none}} .tip{{fill:{colour['line']}}} "
            f".track{{stroke:{colour['track']};fill:none}} .window{{stroke:{colour['window']};fill:none}} "
        )

    fonts = "text{font:15px system-ui,-apple-system,'Segoe UI','DejaVu Sans',sans-serif} .name{font-weight:600}"
    return f"{fonts} {rules(0)}@media (prefers-color-scheme:dark){{{rules(1)}}}"


def _picture(title: str, height: int, parts: Sequence[str], width: int = WIDTH) -> str:
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    ground = f'<rect class="ground" width="{width}" height="{height}" rx="8"/>'
    tip = (
        '<marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path class="tip" d="M0 0 8 4 0 8z"/></marker>'
    )
    body = [f"<title>{escape(title)}</title>", f"<style>{_style()}</style>", f"<defs>{tip}</defs>", ground, *parts]
    return "\n".join([f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">', *body, "</svg>", ""])


def _text(x: float, y: float, text: str, kind: str = "", anchor: str = "start") -> str:
    return f'<text x="{x:g}" y="{y:g}" class="{kind}" text-anchor="{anchor}">{escape(text)}</text>'


def _box(x: int, y: int, width: int, name: str, *lines: str) -> str:
    height = 30 + 19 * len(lines)
    rows = [f'<rect class="box" x="{x}" y="{y}" width="{width}" height="{height}" rx="6"/>']
    rows.append(_text(x + 12, y + 21, name, "name"))
    rows += [_text(x + 12, y + 40 + 19 * i, line, "muted") for i, line in enumerate(lines)]
    return "\n".join(rows)


def _arrow(*points: tuple[float, float]) -> str:
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    return f'<polyline class="line" stroke-width="1.5" marker-end="url(#tip)" points="{path}"/>'


def build_picture() -> str:
    """Return the picture of a build: from files to a dataset, stage by stage."""
    left, right, half = 16, 288, 256
    parts = [
        _box(left, 16, half, "motion", "pkl, npz, npy, bvh"),
        _box(right, 16, half, "music", "wav, flac, mp3, ogg"),
        _arrow((144, 65), (144, 88)),
        _arrow((416, 65), (416, 88)),
        _box(left, 88, 528, "identify", "clips, their splits and songs; a hash of every file"),
        _arrow((144, 137), (144, 160)),
        _arrow((416, 137), (416, 160)),
        _box(left, 160, half, "encode", "columns of each trainer,", "contacts, key motions"),
        _box(right, 160, half, "extract", "features of whole songs,", "or of each slice"),
        _arrow((144, 228), (144, 251)),
        _box(left, 251, half, "cut windows", "length, stride, filter"),
        _arrow((272, 275), (352, 275), (352, 229)),
        _arrow((144, 300), (144, 323)),
        _arrow((416, 228), (416, 323)),
        _box(left, 323, 528, "copy", "mirrored, turned, faster: set in the recipe"),
        _arrow((144, 372), (144, 395)),
        _arrow((416, 372), (416, 395)),
        _box(left, 395, half, "dataset", "*.h5, stats.json,", "dataset.json: written last"),
        _box(right, 395, half, "what to know", "rejects.jsonl: left out, why", "segments: quality flags"),
        _text(WIDTH / 2, 488, "Results of encode and extract are kept in the cache:", anchor="middle"),
        _text(WIDTH / 2, 507, "a build that was interrupted continues there.", anchor="middle"),
    ]
    return _picture("What a build does", 524, parts)


def _curve(values: np.ndarray, x: np.ndarray, floor: float, kind: str, width: float) -> str:
    points = " ".join(f"{a:.1f},{floor - 2.6 * min(float(v), 18):.1f}" for a, v in zip(x, values, strict=True))
    return f'<polyline class="{kind}" stroke-width="{width}" points="{points}"/>'


def slices_picture() -> str:
    """Return the picture of whole clips and slices: onset envelopes of a song, and of three slices by themselves."""
    fps, length_s, stride_s, total_s = 30, 5.0, 2.5, 10.0
    signal = synthesise_song("mBR0", length_s=total_s).signal
    song = dancedata.features(signal, "librosa35", fps=fps, bpm=80)[: int(total_s * fps), 0]
    left, pixels = 16.0, 528 / total_s
    starts = np.arange(0, total_s - length_s + 1e-9, stride_s)

    def places(start_s: float, rows: int) -> np.ndarray:
        return left + pixels * (start_s + np.arange(rows) / fps)

    parts = [
        _text(16, 30, "whole clips", "name"),
        _text(16, 50, "one analysis of the whole song; windows are views of it", "muted"),
        _curve(song, places(0, len(song)), 118, "track", 1.5),
    ]
    for number, start in enumerate(starts):
        x, y, width = left + pixels * start, 130 + 22 * number, pixels * length_s
        parts.append(f'<path class="line" stroke-width="1.5" d="M{x:g} {y - 6}v8h{width:g}v-8"/>')
        parts.append(_text(x + 8, y + 19, f"{start:g} to {start + length_s:g} s", "muted"))
    parts += [
        _text(16, 238, "slices", "name"),
        _text(16, 258, "the song is cut first; every slice is analysed by itself", "muted"),
    ]
    for number, start in enumerate(starts):
        first, n = round(start * signal.sample_rate), round(length_s * signal.sample_rate)
        piece = AudioSignal(signal.samples[first : first + n], signal.sample_rate)
        rows = dancedata.features(piece, "librosa35", fps=fps, bpm=80)[: int(length_s * fps), 0]
        floor = 318 + 58 * number
        track = song[int(start * fps) :][: len(rows)]
        parts.append(_curve(track, places(start, len(rows)), floor, "track", 1.2))
        parts.append(_curve(rows, places(start, len(rows)), floor, "window", 1.5))
        x, width = left + pixels * start, pixels * length_s
        parts.append(f'<path class="line" stroke-width="1.5" d="M{x:g} {floor - 2}v8h{width:g}v-8"/>')
    parts += [
        _text(16, 413, "At 2.5 s the second slice", "muted"),
        _text(16, 432, "lacks the onset of the song.", "muted"),
    ]
    return _picture("Whole clips and slices", 500, [*parts, *_legend(472)])


def _legend(y: int) -> list[str]:
    entries = [(16, "track", "onset envelope of the song"), (288, "window", "of the slice by itself")]
    lines = [f'<path class="{kind}" stroke-width="2.5" d="M{x} {y - 5}h24"/>' for x, kind, _ in entries]
    return [*lines, *(_text(x + 32, y, text) for x, _, text in entries)]


def _layers() -> list[list[str]]:
    """Return the rooms of each layer, from the top, as import-linter checks them."""
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    (contract,) = (c for c in tools["importlinter"]["contracts"] if c["type"] == "layers")
    return [re.findall(r"\w+", layer) for layer in contract["layers"]]


def purpose(room: str) -> str:
    """Return the first sentence of a room's docstring."""
    package = ROOT / "dancedata" / room / "__init__.py"
    path = package if package.exists() else package.parent.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0].partition(". ")[0].rstrip(".")


def layers_picture() -> str:
    """Return the picture of the rooms: a box per layer; rooms import those of lower layers."""
    parts, y = [], 16
    for layer in _layers():
        height = 21 * len(layer) + 13
        parts.append(f'<rect class="box" x="40" y="{y}" width="644" height="{height}" rx="6"/>')
        for number, room in enumerate(layer):
            row = y + 23 + 21 * number
            parts += [_text(52, row, room, "name"), _text(196, row, purpose(room), "muted")]
        y += height + 8
    bottom = y - 8
    parts += [
        _arrow((22, 16), (22, bottom)),
        _text(40, bottom + 25, "A room may import the rooms of the boxes below its own.", "muted"),
    ]
    return _picture("The layers of dancedata", bottom + 40, parts, width=700)


if __name__ == "__main__":
    folder = Path(__file__).resolve().parent
    (folder / "build.svg").write_text(build_picture(), encoding="utf-8")
    (folder / "slices.svg").write_text(slices_picture(), encoding="utf-8")
    (folder / "layers.svg").write_text(layers_picture(), encoding="utf-8")
