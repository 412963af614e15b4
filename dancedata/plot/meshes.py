"""Body models on pictures: shaded triangles with a depth buffer, in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dancedata.core.packages import load
from dancedata.formats.body_mesh import Float32, Int32, vertex_normals
from dancedata.viewer import Figure

if TYPE_CHECKING:
    from PIL.Image import Image

    from dancedata.plot.frames import Camera

Places = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
#: Light from above, ahead and the side, in the world; and how much of it, of the sky and of the rim.
_LIGHT = np.array((0.45, 0.75, 0.5), dtype=np.float32) / np.float32(0.982)
_AMBIENT, _SKY, _KEY, _RIM = 0.4, 0.12, 0.52, 0.22


def draw_mesh(stage: Image, camera: Camera, figure: Figure, at: int, tones: Sequence[str]) -> None:
    """Draw a figure at a frame as its body model; nothing where a part is behind the camera.

    Parameters
    ----------
    tones
        Colours of trunk and head, left and right limbs.
    """
    vertices, mesh = figure.vertices(at), figure.mesh
    if vertices is None or mesh is None:
        return
    places = camera(vertices.astype(np.float64))
    if not np.isfinite(places).all():
        return
    plain = mesh.sides @ np.array([_rgb(tone) for tone in tones], dtype=np.float32)
    colours = plain * brightness(vertex_normals(vertices, mesh.faces), camera.towards)[:, None]
    drawn = rasterised(places, mesh.faces, colours, stage.size)
    if drawn is not None:
        picture, mask, corner = drawn
        images = load("PIL.Image", "video")
        stage.paste(images.fromarray(picture), corner, images.fromarray(mask))


def brightness(normals: Float32, towards: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return how bright surfaces with unit normals (V, 3) are; `towards` is the way to the camera, (3,)."""
    key = (0.5 + 0.5 * normals @ _LIGHT) ** 2
    rim = (1 - np.abs(normals @ towards)) ** 3
    return np.asarray(_AMBIENT + _SKY * normals[:, 1] + _KEY * key + _RIM * rim)


def rasterised(
    places: Places, faces: Int32, colours: Places, size: tuple[int, int]
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], tuple[int, int]] | None:
    """Draw the triangles that face the camera, the nearest in front.

    Parameters
    ----------
    places
        (V, 3) pixels right and down, and nearness: larger is nearer, linear on the picture.
    colours
        (V, 3) of 0 to 255, linear between the vertices.
    size
        Width and height of the whole picture.

    Returns
    -------
    (h, w, 3) colours, (h, w) mask of 0 and 255, (x, y) of the corner on the picture; None if nothing is on it.
    """
    # Counterclockwise from outside, in a world whose y is up, is clockwise on a picture whose y is down.
    (ax, ay), (bx, by), (cx, cy) = (places[faces[:, k], :2].T for k in range(3))
    seen = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) < 0
    corners = places[faces[seen]]
    triangle, row, column = _pixels(corners[..., :2], size)
    if not len(triangle):
        return None
    left, top = column.min(), row.min()
    width, height = int(column.max() - left) + 1, int(row.max() - top) + 1
    shares = _shares(corners[..., :2], triangle, column, row)
    near = np.einsum("nk,nk->n", shares, corners[triangle, :, 2])
    # The last one that is written to a pixel stays.
    order = np.argsort(near, kind="stable")
    nearest = np.full(height * width, -1, dtype=np.int64)
    nearest[((row - top) * width + column - left)[order]] = order
    filled = np.flatnonzero(nearest >= 0)
    kept = nearest[filled]
    picture = np.zeros((height * width, 3), dtype=np.uint8)
    picture[filled] = np.einsum("nk,nkc->nc", shares[kept], colours[faces[seen][triangle[kept]]]).clip(0, 255)
    mask = np.where(nearest >= 0, 255, 0).astype(np.uint8)
    return picture.reshape(height, width, 3), mask.reshape(height, width), (int(left), int(top))


def _pixels(corners: Places, size: tuple[int, int]) -> tuple[Indices, Indices, Indices]:
    """Return triangle, row and column of the pixels (N,) whose middles are inside triangles (F, 3, 2)."""
    first, last = (
        np.clip(np.ceil(end - 0.5), 0, size[1]).astype(np.int64)
        for end in (corners[..., 1].min(axis=1), corners[..., 1].max(axis=1))
    )
    triangle, row = _counted_up(first, last)
    y = row + 0.5
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for k in range(3):
        (px, py), (qx, qy) = corners[triangle, k].T, corners[triangle, (k + 1) % 3].T
        crossed = (py <= y) != (qy <= y)
        x = px + (y - py) * (qx - px) / np.where(crossed, qy - py, 1)
        left = np.where(crossed, np.minimum(left, x), left)
        right = np.where(crossed, np.maximum(right, x), right)
    begin, end = (np.clip(np.ceil(x - 0.5), 0, size[0]).astype(np.int64) for x in (left, right))
    part, column = _counted_up(begin, end)
    return triangle[part], row[part], column


def _counted_up(begin: Indices, end: Indices) -> tuple[Indices, Indices]:
    """Return the number of each range begin to end - 1 and its values, one after the other."""
    counts = np.maximum(end - begin, 0)
    number = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)
    return number, begin[number] + within


def _shares(corners: Places, triangle: Indices, column: Indices, row: Indices) -> Places:
    """Return the shares of the corners (N, 3) in the middles of pixels."""
    (ax, ay), (bx, by), (cx, cy) = (corners[:, k].T for k in range(3))
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    across, down = column + 0.5 - ax[triangle], row + 0.5 - ay[triangle]
    second = (across * (cy - ay)[triangle] - down * (cx - ax)[triangle]) / area[triangle]
    third = (down * (bx - ax)[triangle] - across * (by - ay)[triangle]) / area[triangle]
    return np.stack([1 - second - third, second, third], axis=1)


def _rgb(colour: str) -> tuple[int, ...]:
    """Return a colour "#rrggbb" as numbers of 0 to 255."""
    return tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5))
