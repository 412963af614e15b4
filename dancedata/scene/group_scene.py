"""Dancers of a group in their one world: distances, facing, contacts and collisions of each two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.tracks import runs
from dancedata.metrics.groups import Contact, collisions, contact_spans, facing_angles, root_distances
from dancedata.scene.figure import Figure

#: Joints that contacts and collisions are measured on, by name and place.
_BODY = SMPL24.joints[:22]


@dataclass(frozen=True, eq=False)
class Pair:
    """Two dancers of a group."""

    first: int
    second: int
    distance_m: Float64Array  # (T,) distance of their roots
    # (2, T) angle between where the hips of the first face and the direction to the second, and that of the second to
    # the first: 0 looks at the other, 180 has the other behind. NaN where it is undefined.
    facing_deg: Float64Array
    contacts: tuple[Contact, ...]
    collides: npt.NDArray[np.bool_]  # (T,) whether their bodies intersect

    @property
    def collisions(self) -> tuple[tuple[int, int], ...]:
        """Stretches of frames in which the bodies intersect, half-open."""
        return tuple(runs(self.collides))


@dataclass(frozen=True, eq=False)
class GroupScene:
    """All pairs of a group's dancers."""

    grid: FrameGrid
    # height of the floor, metres: one for all, that of the lowest dancer, so that a lifted one stays in the air
    floor: float
    pairs: tuple[Pair, ...]
    touch: bool  # whether contacts and collisions were measured: bodies need the first 22 joints of SMPL

    @classmethod
    def of(cls, figures: Sequence[Figure]) -> GroupScene:
        """Measure the pairs of figures of equal length, rate and skeleton."""
        joints = np.stack([figure.joints for figure in figures])
        skeleton, n_frames = figures[0].skeleton, joints.shape[1]
        touch = skeleton.joints[: len(_BODY)] == _BODY
        distance = root_distances(joints)
        hips = {"left_hip", "right_hip"} <= set(skeleton.joints)
        left, right = (skeleton.joints.index(f"{side}_hip") if hips else 0 for side in ("left", "right"))
        facing = facing_angles(joints[:, :, [0, left, right]])
        meet = collisions(joints) if touch else np.zeros((len(joints), len(joints), n_frames), dtype=np.bool_)
        pairs = tuple(
            Pair(
                a, b, distance[a, b], np.stack([facing[a, b], facing[b, a]]),
                tuple(contact_spans(joints[a], joints[b])) if touch else (), meet[a, b],
            )
            for a, b in combinations(range(len(joints)), 2)
        )  # fmt: skip
        return cls(figures[0].grid, min(figure.floor for figure in figures), pairs, touch)
