"""Dancers at another place: motions and rows that are turned about a vertical axis, or shifted over the floor."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Spatial
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array, rotation

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Placement:
    """A turn about the vertical axis through the root in the first frame, then a shift over the floor.

    Attributes
    ----------
    turn_rad
        Angle, counter-clockwise as seen from above.
    x_m, z_m
        Shift in metres, in a world with +Y up.
    """

    turn_rad: float = 0.0
    x_m: float = 0.0
    z_m: float = 0.0


def require_roles(spatial: Spatial, columns: Columns) -> None:
    """Raise UsageError unless every group of the columns has a role that fits its width."""
    if set(spatial.roles) != set(columns.names):
        raise UsageError("the roles of column groups do not fit the columns",
                         found=", ".join(spatial.roles) or "none", allowed=", ".join(columns.names))  # fmt: skip
    for group in columns.groups:
        role = spatial.roles[group.name]
        whole = role in ("unchanged", "root_rotation") or group.width % 3 == 0
        if not whole or (role == "root_rotation" and _matrix_rows(columns, group.name) not in (2, 3)):
            raise UsageError(f"column group {group.name!r} cannot be a {role}", found=f"width {group.width}")


def moved_rows(
    spatial: Spatial, rows: Array, columns: Columns, by: Placement, about: Float64Array | None = None
) -> Array:
    """Return rows (L, D), not normalised, of the dancer at another place, in another direction.

    The axis of the turn goes through the root in the first of these rows, or through `about`, a point (3,) of the
    columns' world, for dancers who turn together. Columns that are not concerned are equal bit for bit.
    """
    out = rows.copy()
    turn, shift = _turn(spatial.up, by.turn_rad), _shift(spatial.up, by)
    root = root_place(spatial, rows[0], columns)
    if root is not None and about is not None:
        root = np.asarray(about, dtype=np.float64)
    for group in columns.groups:
        role, indices = spatial.roles[group.name], columns.slice(group.name)
        if role == "root_rotation" and by.turn_rad:
            width = 3 * _matrix_rows(columns, group.name)
            indices = slice(indices.start, indices.start + width)
            out[:, indices] = _turned_root(rows[:, indices], turn)
        elif role == "direction" and by.turn_rad:
            out[:, indices] = _triples(rows[:, indices], turn, np.zeros(3), np.zeros(3))
        elif role == "place" and root is not None and (by.turn_rad or shift.any()):
            out[:, indices] = _triples(rows[:, indices], turn, root, shift)
    return out


def moved_bounds(
    spatial: Spatial, low: Float64Array, high: Float64Array, columns: Columns, *, turns: bool, shift_m: float
) -> tuple[Float64Array, Float64Array]:
    """Return bounds (D,) that hold for moved rows, from bounds that hold for the rows.

    `turns`: Whether rows are turned, by any angle.
    `shift_m`: Largest shift over the floor, metres.
    """
    low, high = low.copy(), high.copy()
    floor = [0, 2] if spatial.up == "y" else [0, 1]
    places = [first for g in columns.groups if spatial.roles[g.name] == "place" for first in _firsts(columns, g.name)]
    root = slice(places[0], places[0] + 3) if places else slice(0)
    root_low, root_high = low[root].copy(), high[root].copy()
    for first in places:
        axes = np.array(floor) + first
        if turns:
            apart = np.maximum(high[axes] - root_low[floor], root_high[floor] - low[axes])
            radius = float(np.hypot(*apart))
            low[axes], high[axes] = root_low[floor] - radius, root_high[floor] + radius
        low[axes], high[axes] = low[axes] - shift_m, high[axes] + shift_m
    for group in (g.name for g in columns.groups if turns):
        if spatial.roles[group] == "direction":
            for first in _firsts(columns, group):
                axes = np.array(floor) + first
                length = float(np.hypot(*np.maximum(np.abs(low[axes]), np.abs(high[axes]))))
                low[axes], high[axes] = -length, length
        if spatial.roles[group] == "root_rotation":
            first, n_rows = columns.slice(group).start, _matrix_rows(columns, group)
            for row in (axis for axis in floor if axis < n_rows):
                low[first + 3 * row : first + 3 * row + 3] = -1.0
                high[first + 3 * row : first + 3 * row + 3] = 1.0
    return low, high


def root_place(spatial: Spatial, row: Array, columns: Columns) -> Float64Array | None:
    """Return the root's place (3,) in a row (D,); None if the columns have no places."""
    for group in columns.names:
        if spatial.roles[group] == "place":
            start = columns.slice(group).start
            return np.asarray(row[start : start + 3], dtype=np.float64)
    return None


def centroid(roots: Array) -> Float64Array:
    """Return the middle of the least and greatest coordinates of points (P, 3), whose order does not matter."""
    return np.asarray((roots.min(axis=0) + roots.max(axis=0)) / 2, dtype=np.float64)


def moved(motion: Motion, by: Placement, about: Float64Array | None = None) -> Motion:
    """Return a motion at another place, in another direction.

    Joints follow exactly: the position p of each becomes T (p - r) + r + shift, where r is the root's position in the
    first frame. The root's rest position is the same before and after it, so the translation follows too. `about` is
    the translation that the dancer would have with the root on the axis, for dancers who turn together.
    """
    if not by.turn_rad and not by.x_m and not by.z_m:
        return motion
    turn = _turn("y", by.turn_rad)
    first = motion.translation[0] if about is None else np.asarray(about, dtype=np.float64)
    translation = (motion.translation - first) @ turn.T + first + (by.x_m, 0.0, by.z_m)
    if not by.turn_rad:
        return replace(motion, translation=translation)
    rotations = motion.rotations.copy()
    rotations[:, 0] = (rotation(np.array([0.0, by.turn_rad, 0.0])) * rotation(rotations[:, 0])).as_rotvec()
    return replace(motion, translation=translation, rotations=rotations)


def _turn(up: str, angle: float) -> Float64Array:
    """Return the matrix of the turn in the columns' world."""
    c, s = math.cos(angle), math.sin(angle)
    if up == "y":
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _shift(up: str, by: Placement) -> Float64Array:
    return np.array([by.x_m, 0.0, by.z_m] if up == "y" else [by.x_m, -by.z_m, 0.0])


def _triples(rows: Array, turn: Float64Array, root: Float64Array, shift: Float64Array) -> Array:
    """Return points (L, 3 N) turned about the vertical through `root` and shifted."""
    points = rows.reshape(len(rows), -1, 3).astype(np.float64)
    return np.asarray(((points - root) @ turn.T + root + shift).reshape(rows.shape), dtype=rows.dtype)


def _turned_root(rows: Array, turn: Float64Array) -> Array:
    """Return the first two or three rows of matrices, (L, 6) or (L, 9), after a turn of the world."""
    matrices = rows.reshape(len(rows), -1, 3).astype(np.float64)
    first, second = matrices[:, 0], matrices[:, 1]
    third = matrices[:, 2] if matrices.shape[1] == 3 else np.cross(first, second)
    turned = turn @ np.stack([first, second, third], axis=1)
    return np.asarray(turned[:, : matrices.shape[1]].reshape(rows.shape), dtype=rows.dtype)


def _firsts(columns: Columns, group: str) -> range:
    """Return the first columns of a group's triples."""
    indices = columns.slice(group)
    return range(indices.start, indices.stop, 3)


def _matrix_rows(columns: Columns, group: str) -> int:
    """Return how many rows of each joint's matrix a group holds, by the names of its columns; 0 if they have none."""
    parts = next(g.parts for g in columns.groups if g.name == group)
    joints = {part.rpartition(".")[0] for part in parts}
    return len(parts) // (3 * len(joints)) if parts and len(parts) % (3 * len(joints)) == 0 else 0
