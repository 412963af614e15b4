"""Aligns the rest pose of a skeleton with SMPL's: a constant rotation for each joint, from the root outwards.

The rules are those of `dancedata.formats.bvh.retarget`, which uses this module.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dancedata.core.rotations import shortest_rotation
from dancedata.core.skeleton import SMPL24

Floats = NDArray[np.float64]


def rest_positions(parents: Sequence[int], offsets: Floats) -> Floats:
    """Return (J, 3) positions with all angles 0 and the root at 0."""
    positions = np.zeros((len(parents), 3))
    for k, parent in enumerate(parents):
        if parent != -1:
            positions[k] = positions[parent] + offsets[k]
    return positions


PELVIS, NECK, HEAD = 0, 12, 15
#: Rest positions of SMPL's joints relative to the pelvis, (24, 3) metres.
SMPL_REST = rest_positions(SMPL24.parents, SMPL24.offsets)
_SPINE = (3, 6, 9)
_SIDES = ((1, 2), (13, 14), (16, 17))
#: The child at the end of the bone that defines a joint's rotation.
_CHILD = {1: 4, 2: 5, 4: 7, 5: 8, 7: 10, 8: 11}
_CHILD |= {13: 16, 14: 17, 16: 18, 17: 19, 18: 20, 19: 21, 20: 22, 21: 23}
#: Joints with a large range of rotation about their bone.
_FREE = (1, 2, 16, 17, 18, 19, 20, 21)
#: Bones shorter than this fraction of the body count as points.
POINT = 1e-4
#: No thigh, shin, upper arm, forearm or trunk is shorter than this fraction of the body.
_LEAST_BONE = 0.01
LEGS = ((1, 4), (4, 7), (2, 5), (5, 8))
_ARMS = ((16, 18), (18, 20), (17, 19), (19, 21))


def body_size(places: Mapping[int, Floats]) -> float:
    """Return the largest distance of two joints at rest."""
    return max(norm(a - b) for a in places.values() for b in places.values())


def missing_bone(places: Mapping[int, Floats], size: float) -> tuple[int, int, float, float] | None:
    """Return two joints that are at one place at rest, their distance and the least one; None for a whole body."""
    trunk = (PELVIS, NECK if NECK in places else HEAD)
    least = dict.fromkeys((*LEGS, *_ARMS, trunk), _LEAST_BONE) | {(1, 2): POINT, (16, 17): POINT}
    for (a, b), fraction in least.items():
        if a in places and b in places and not norm(places[a] - places[b]) > size * fraction:
            return a, b, norm(places[a] - places[b]), size * fraction
    return None


def anchor(joint: int, places: Mapping[int, Floats]) -> int:
    """Return the nearest ancestor that the file has."""
    above = SMPL24.parents[joint]
    while above not in places:
        above = SMPL24.parents[above]
    return above


class Aligner:
    """Computes the constant rotations from the root outwards.

    `places`: SMPL joint -> position (3,) at rest of the other skeleton's joint; `up`: (3,) that skeleton's up axis.
    `point`: Bones below this length have no direction.
    `turns`: SMPL joint -> its rotations (n, 3, 3) in the world; may be empty.
    `level`: Whether SMPL's hips and shoulders count as level; else their own lines are compared.
    """

    def __init__(
        self,
        places: Mapping[int, Floats],
        point: float,
        up: Floats,
        turns: Mapping[int, Floats],
        *,
        level: bool = True,
    ) -> None:
        self.places = places
        self.point = point
        self.up = up
        self.turns = turns
        self.level = level
        self.align = np.tile(np.eye(3), (24, 1, 1))
        self.child_of: dict[int, int] = {}
        self.beyond: dict[int, int] = {}
        spine = [s for s in _SPINE if s in places]
        self._chest = spine[-1] if spine else PELVIS

    def run(self) -> Floats:
        """Return (24, 3, 3), the identity for joints that the other skeleton lacks."""
        for j in sorted(self.places):
            if j == PELVIS:
                self.align[j] = self._pelvis()
            elif j == self._chest:
                self.align[j] = self._chest_rotation()
            else:
                self.align[j] = self._limb(j)
        return self.align

    def _pelvis(self) -> Floats:
        spine = next((s for s in (*_SPINE, NECK, HEAD) if s in self.places and self._apart(PELVIS, s)), None)
        rest_up, up = np.array([0.0, 1.0, 0.0]), self.up
        if spine is not None:
            bone = self.places[spine] - self.places[PELVIS]
            if bone @ self.up < np.cos(np.radians(60)) * norm(bone):
                rest_up, up = SMPL_REST[spine], bone
        return self._frame((1, 2), rest_up, up, np.eye(3))

    def _chest_rotation(self) -> Floats:
        above: Floats = self.align[anchor(self._chest, self.places)]
        sides = next((pair for pair in _SIDES[1:] if set(pair) <= set(self.places) and self._apart(*pair)), (16, 17))
        neck = next((s for s in (NECK, HEAD) if s in self.places and self._apart(self._chest, s)), None)
        if neck is None:
            return above
        rest_up = SMPL_REST[neck] - SMPL_REST[self._chest]
        return self._frame(sides, rest_up, self.places[neck] - self.places[self._chest], above)

    def _frame(self, sides: tuple[int, int], rest_up: Floats, up: Floats, otherwise: Floats) -> Floats:
        """Map left to the file's line between two joints, and up as close as possible to `up`."""
        left, right = sides
        across = np.array([1.0, 0.0, 0.0]) if self.level else SMPL_REST[left] - SMPL_REST[right]
        source = _basis(across, rest_up)
        target = _basis(self.places[left] - self.places[right], up)
        return otherwise if source is None or target is None else target @ source.T

    def _limb(self, joint: int) -> Floats:
        above = anchor(joint, self.places)
        further = self._further(joint)
        below = next((s for s in further if self._apart(joint, s)), None)
        if below is None:
            start = self.align[PELVIS] if joint == HEAD else self.align[above]
            return self._untwisted(joint, above, start, None)
        if below == further[0]:
            self.child_of[joint] = below
        else:  # the joint in between may bend
            self.beyond[joint] = below
        # Joints in between are at the place of this one: the bone is that of the last of them.
        bone = SMPL_REST[below] - SMPL_REST[[joint, *further][further.index(below)]]
        start = self.align[above]
        aimed = shortest_rotation(start @ bone, self.places[below] - self.places[joint], start[:, 2]) @ start
        return self._untwisted(joint, above, aimed, bone / norm(bone))

    def _further(self, joint: int) -> list[int]:
        """Return the joints further along a limb or the spine, the nearest first."""
        if joint in _SPINE:
            return [s for s in (*_SPINE, NECK, HEAD) if s > joint and s in self.places]
        chain = []
        while (joint := _CHILD.get(joint, -1)) in self.places:
            chain.append(joint)
        return chain

    def _untwisted(self, joint: int, above: int, align: Floats, bone: Floats | None) -> Floats:
        """Remove the multiples of 90 degrees from a joint's mean rotation; about its bone if it has one."""
        from scipy.spatial.transform import Rotation

        if not self.turns:
            return align
        parent = self.turns[above] @ self.align[above]
        mean = Rotation.from_matrix(np.swapaxes(parent, -1, -2) @ self.turns[joint] @ align).mean()
        if bone is None:
            if np.degrees(mean.magnitude()) <= 60:
                return align
            quarters = Rotation.create_group("O")
            nearest = quarters[int(np.argmin((quarters.inv() * mean).magnitude()))]
            return np.asarray(align @ nearest.inv().as_matrix(), dtype=np.float64)
        x, y, z, w = mean.as_quat()
        twist = np.degrees(2 * np.arctan2(np.array([x, y, z]) @ bone, w))
        twist = (twist + 180) % 360 - 180
        limit, unit = (120.0, 180.0) if joint in _FREE else (60.0, 90.0)
        if abs(twist) <= limit:
            return align
        back = Rotation.from_rotvec(-np.radians(round(twist / unit) * unit) * bone)
        return np.asarray(align @ back.as_matrix(), dtype=np.float64)

    def _apart(self, a: int, b: int) -> bool:
        return norm(self.places[a] - self.places[b]) > self.point


def norm(vector: Floats) -> float:
    """Return the length of a vector (3,)."""
    return float(np.linalg.norm(vector))


def _basis(across: Floats, up: Floats) -> Floats | None:
    """Return axes (columns), the first along `across`; None if up and across are parallel."""
    first = across / max(norm(across), 1e-300)
    third = np.cross(first, up / max(norm(up), 1e-300))
    if norm(third) < 1e-3:
        return None
    third /= norm(third)
    return np.stack([first, np.cross(third, first), third], axis=1)
