"""Bodies on pictures: the round cones of the viewer, or the triangles of a body model, as polygons by depth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.packages import load
from dancedata.core.rotations import Float64Array
from dancedata.formats.body_mesh import BodyMesh, Float32, vertex_normals
from dancedata.scene.figure import Figure

#: From the edge inwards: share of the width, shift towards the light in radii, share of white, or of black below 0.
_STRIPS = ((1.0, 0.0, -0.5), (0.9, 0.02, -0.22), (0.76, 0.05, 0.0), (0.44, 0.12, 0.16), (0.2, 0.16, 0.3))
#: Direction of the light on the picture, right and up.
_LIGHT = (0.55, 0.83)
#: Points of each end of a cone.
_ARC = np.linspace(0.0, 1.0, 9)
#: Light on a body model from above, ahead and the side, in the world; how much of it, of the sky and of the rim.
_SUN = np.array((0.45, 0.75, 0.5), dtype=np.float32) / np.float32(0.982)
_AMBIENT, _SKY, _KEY, _RIM = 0.4, 0.12, 0.52, 0.22
#: Nearest distance to the camera that is drawn, metres.
_NEAREST = 0.1


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at a point of the world."""

    middle: Float64Array  # (3,) metres, the point that is seen at (0, 0) of the picture
    # `turn_deg`, `tilt_deg`: turn about the vertical axis from the front, +Z, and downward tilt, degrees
    turn_deg: float
    tilt_deg: float = 0.0
    distance: float = math.inf  # from `middle`, metres; infinite: a parallel projection

    @property
    def axes(self) -> Float64Array:
        """Rows are right, up, and the way from `middle` to the camera, in the world; (3, 3), each of length 1."""
        turn, tilt = np.radians((self.turn_deg, self.tilt_deg))
        (st, ct), (sp, cp) = (np.sin(turn), np.cos(turn)), (np.sin(tilt), np.cos(tilt))
        return np.array([(ct, 0.0, -st), (-sp * st, cp, -sp * ct), (cp * st, sp, cp * ct)])

    def __call__(self, places: Float64Array) -> Float64Array:
        """Return places (..., 3), metres, as (..., 3): right and up, metres at `middle`, and nearness to the camera.

        Places behind the camera are NaN.
        """
        turned = (np.asarray(places) - self.middle) @ self.axes.T
        near = turned[..., 2]
        return np.concatenate([turned[..., :2] * self.scale(near)[..., None], near[..., None]], axis=-1)

    def scale(self, near: Float64Array) -> Float64Array:
        """Return how much larger than at `middle` things at a nearness are drawn."""
        return np.where(self.distance - near > _NEAREST, 1 / (1 - near / self.distance), np.nan)


@cache
def blend(colour: str, other: str, share: float) -> str:
    """Return a share of one colour, "#rrggbb", and the rest of another."""
    pairs = ((int(colour[k : k + 2], 16), int(other[k : k + 2], 16)) for k in (1, 3, 5))
    return "#" + "".join(f"{round(a * share + b * (1 - share)):02x}" for a, b in pairs)


@cache
def shade(colour: str, white: float) -> str:
    """Return a colour with a share of white, or of black below 0."""
    return blend(colour, "#ffffff" if white > 0 else "#000000", 1 - abs(white))


def body(
    figure: Figure, at: int, camera: Camera, tones: Sequence[str], place: tuple[float, float], zorder: float
) -> Any:
    """Return a figure at a frame as a matplotlib collection of polygons, the farthest first."""
    vertices = figure.vertices(at)
    if vertices is None or figure.mesh is None:
        polygons, colours = _cones(figure, at, camera, tones)
    else:
        polygons, colours = _faces(vertices, figure.mesh, camera, tones)
    collection = load("matplotlib.collections", "report", "a figure").PolyCollection
    # Without an edge of its own colour, the floor shines through between two triangles.
    width = 0.0 if figure.mesh is None else 0.5
    return collection(polygons + place, facecolors=colours, edgecolors="face", linewidths=width, zorder=zorder)


def _cones(figure: Figure, at: int, camera: Camera, tones: Sequence[str]) -> tuple[Float64Array, Any]:
    """Return the strips of the cones of a pose, (N, P, 2), and their colours; none if a part is behind the camera."""
    cones = figure.limbs.cones(figure.joints[at], None if figure.look is None else figure.look[at])
    begin, end = camera(cones.begin), camera(cones.end)
    radii = cones.radii * camera.scale(np.stack([begin[:, 2], end[:, 2]], axis=1))
    outlines = np.stack([cone_outlines(begin[:, :2], end[:, :2], radii, *strip[:2]) for strip in _STRIPS], axis=1)
    colours = [*tones, shade(tones[0], -0.65)]
    order = np.argsort(begin[:, 2] + end[:, 2], kind="stable")
    order = order if np.isfinite(outlines).all() else order[:0]
    fills = [shade(colours[cones.tones[k]], white) for k in order for *_, white in _STRIPS]
    return outlines[order].reshape(-1, *outlines.shape[2:]), fills


def _faces(vertices: Float32, mesh: BodyMesh, camera: Camera, tones: Sequence[str]) -> tuple[Float64Array, Any]:
    """Return the triangles of a body model that face the camera, (N, 3, 2), and their colours (N, 3), 0 to 1."""
    corners = camera(vertices.astype(np.float64))[mesh.faces]
    (ax, ay), (bx, by), (cx, cy) = (corners[:, k, :2].T for k in range(3))
    # Counterclockwise from outside is counterclockwise on the picture; NaN, behind the camera, is not.
    seen = np.flatnonzero((bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0)
    seen = seen[np.argsort(corners[seen, :, 2].sum(axis=1), kind="stable")]
    plain = mesh.sides @ load("matplotlib.colors", "report", "a figure").to_rgba_array(tones)[:, :3]
    colours = plain * _brightness(vertex_normals(vertices, mesh.faces), camera.axes[2])[:, None]
    return corners[seen, :, :2], colours[mesh.faces[seen]].mean(axis=1).clip(0, 1)


def _brightness(normals: Float32, towards: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return how bright surfaces with unit normals (V, 3) are; `towards` is the way to the camera, (3,)."""
    key = (0.5 + 0.5 * normals @ _SUN) ** 2
    rim = (1 - np.abs(normals @ towards)) ** 3
    return np.asarray(_AMBIENT + _SKY * normals[:, 1] + _KEY * key + _RIM * rim)


def cone_outlines(
    begin: Float64Array, end: Float64Array, radii: Float64Array, share: float, shift: float
) -> Float64Array:
    """Return the outlines of K round cones on the picture, (K, P, 2)."""
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
