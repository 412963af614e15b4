"""Bodies on pictures: the round cones of the viewer as polygons, in strips from the edge to the highlight."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from dancedata.core.rotations import Float64Array
from dancedata.viewer import Figure

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

    from dancedata.plot.frames import Camera

#: From the edge inwards: share of the width, shift towards the light in radii, share of white, or of black below 0.
STRIPS = ((1.0, 0.0, -0.5), (0.9, 0.02, -0.22), (0.76, 0.05, 0.0), (0.44, 0.12, 0.16), (0.2, 0.16, 0.3))
#: Direction of the light on the picture, right and down.
_LIGHT = (0.55, -0.83)
#: Darkness below which nothing is drawn: it would only hide the lines of the floor.
_FAINT = 0.2
#: Points of each end of a cone.
_ARC = np.linspace(0.0, 1.0, 9)
#: How fast a shadow fades with the height of its joint, per metre, and the darkness of its rim and its middle.
_FADE, _RIM, _MIDDLE = 2.4, 0.45, 0.9


@cache
def blend(colour: str, other: str, share: float) -> str:
    """Return a share of one colour, "#rrggbb", and the rest of another."""
    pairs = ((int(colour[k : k + 2], 16), int(other[k : k + 2], 16)) for k in (1, 3, 5))
    return "#" + "".join(f"{round(a * share + b * (1 - share)):02x}" for a, b in pairs)


@cache
def shade(colour: str, white: float) -> str:
    """Return a colour with a share of white, or of black below 0."""
    return blend(colour, "#ffffff" if white > 0 else "#000000", 1 - abs(white))


def draw_body(draw: ImageDraw, camera: Camera, figure: Figure, at: int, tones: Sequence[str]) -> None:
    """Draw a figure at a frame, the farthest cones first; nothing where a part is behind the camera.

    Parameters
    ----------
    tones
        Colours of trunk and head, left and right limbs.
    """
    look = None if figure.look is None else figure.look[at]
    cones = figure.limbs.cones(figure.joints[at], look)
    begin, end = camera(cones.begin), camera(cones.end)
    if not (np.isfinite(begin).all() and np.isfinite(end).all()):
        return
    colours = [*tones, blend(tones[0], "#000000", 0.35)]
    radii = cones.radii * np.stack([begin[:, 2], end[:, 2]], axis=1)
    outlines = [cone_outlines(begin[:, :2], end[:, :2], radii, *strip[:2]) for strip in STRIPS]
    for k in np.argsort(begin[:, 2] + end[:, 2], kind="stable"):
        for outline, (_, _, white) in zip(outlines, STRIPS, strict=True):
            draw.polygon(outline[k].ravel().tolist(), fill=shade(colours[cones.tones[k]], white))


def cone_outlines(
    begin: Float64Array, end: Float64Array, radii: Float64Array, share: float, shift: float
) -> Float64Array:
    """Return the outlines of K round cones on the picture, (K, P, 2) pixels.

    Parameters
    ----------
    begin, end
        (K, 2) pixels.
    radii
        (K, 2) pixels.
    share, shift
        Share of the width, and shift towards the light in radii: a strip along the bone.
    """
    bone = end - begin
    length = np.maximum(np.linalg.norm(bone, axis=1), 1e-6)
    across = np.stack([-bone[:, 1], bone[:, 0]], axis=1) / length[:, None]
    towards = across * (across @ np.array(_LIGHT))[:, None] * shift
    turn = np.arctan2(bone[:, 1], bone[:, 0])[:, None]
    opening = np.arccos(np.clip((radii[:, 0] - radii[:, 1]) / length, -1, 1))[:, None]
    arcs = (turn + opening + _ARC * 2 * (np.pi - opening), turn - opening + _ARC * 2 * opening)
    halves = []
    for place, radius, arc in zip((begin, end), radii.T, arcs, strict=True):
        round_it = np.stack([np.cos(arc), np.sin(arc)], axis=-1)
        aside = np.einsum("kpc,kc->kp", round_it, across)[..., None] * across[:, None]
        halves.append(place[:, None] + radius[:, None, None] * (round_it + (share - 1) * aside + towards[:, None]))
    return np.concatenate(halves, axis=1)


def draw_shadow(
    draw: ImageDraw, camera: Camera, figure: Figure, at: int, floor: float, colour: str, ground: str
) -> None:
    """Draw a blob on the floor under each joint, the darker the lower the joint is."""
    joints, scale = figure.joints[at], figure.limbs.scale
    flat = joints.copy()
    flat[:, 1] = floor
    places = camera(flat)
    if not np.isfinite(places).all():
        return
    high = np.maximum(0.0, joints[:, 1] - floor) / scale
    dark = np.exp(-_FADE * np.maximum(0.0, high - 0.03))
    radii = (0.06 + np.max(figure.limbs.girths, axis=1) + 0.1 * high) * scale * places[:, 2]
    for size, strength in ((1.0, _RIM), (0.65, _MIDDLE)):
        for k in np.argsort(dark, kind="stable"):
            if dark[k] < _FAINT:
                continue
            (x, y), a = places[k, :2], size * radii[k]
            b = a * max(0.15, camera.tilt)
            draw.ellipse((x - a, y - b, x + a, y + b), fill=blend(colour, ground, round(strength * dark[k], 2)))
