"""Skeletons: joints, parents, bone offsets, left and right, feet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError, did_you_mean


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of joints; every parent comes before its children.

    Attributes
    ----------
    joints
        Names, (J,).
    parents
        Index of each joint's parent, -1 for the root, which is joint 0.
    offsets
        (J, 3) metres at rest, joint minus parent; the root's is its rest position, which is added to the
        translation.
    pairs
        Left and right joints that mirroring swaps.
    feet
        Left ankle, right ankle, left toe, right toe: the joints whose contacts are labelled.
    captured
        Whether the bones are a recording's, not a body model's. Its rotations say where bones point, so on other
        bones limbs keep their directions; the parameters of body models are copied, as their projects do.

    Examples
    --------
    >>> from dancedata.core.skeleton import SMPL24
    >>> SMPL24.n_joints
    24
    >>> SMPL24.index("left_foot")
    10
    """

    name: str
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: npt.NDArray[np.float64]
    pairs: tuple[tuple[int, int], ...]
    feet: tuple[int, int, int, int]
    captured: bool = False

    def __post_init__(self) -> None:
        offsets = np.array(self.offsets, dtype=np.float64)
        n = len(self.joints)
        if len(self.parents) != n or offsets.shape != (n, 3):
            raise UsageError(f"skeleton {self.name}: joints, parents and offsets have different lengths",
                             found=f"{n}, {len(self.parents)}, {offsets.shape}")  # fmt: skip
        if self.parents[0] != -1 or any(not 0 <= p < j for j, p in enumerate(self.parents) if j):
            raise UsageError(f"skeleton {self.name}: a parent must come before its children, the root first")
        paired = [j for pair in self.pairs for j in pair]
        if len(self.feet) != 4 or not {*paired, *self.feet} <= set(range(n)) or len(set(paired)) != len(paired):
            raise UsageError(f"skeleton {self.name}: requires four foot joints, and each joint in at most one pair",
                             found=f"pairs {self.pairs}, feet {self.feet}", allowed=f"0 to {n - 1}")  # fmt: skip
        offsets.setflags(write=False)
        object.__setattr__(self, "offsets", offsets)

    @property
    def n_joints(self) -> int:
        """Number of joints J."""
        return len(self.joints)

    def __repr__(self) -> str:
        return f"Skeleton({self.name!r}, {self.n_joints} joints)"

    def index(self, joint: str) -> int:
        """Return the index of a joint by name; for an unknown name UsageError with the closest one."""
        try:
            return self.joints.index(joint)
        except ValueError:
            raise UsageError(
                f"skeleton {self.name} has no joint {joint!r}", fix=did_you_mean(joint, self.joints)
            ) from None

    def with_root_offset(self, name: str, offset: tuple[float, float, float]) -> Skeleton:
        """Return this skeleton with another rest position of its root, metres."""
        offsets = np.array(self.offsets)
        offsets[0] = offset
        return replace(self, name=name, offsets=offsets)

    def subset(self, name: str, joints: tuple[str, ...]) -> Skeleton:
        """Return the skeleton of some joints, bones across others joined; UsageError without root or feet."""
        kept = [self.index(joint) for joint in joints]
        needed = {0, *self.feet}
        if kept != sorted(kept) or not needed <= set(kept):
            raise UsageError(f"a subset of skeleton {self.name} must keep the order, the root and the feet",
                             found=", ".join(joints[:6]),
                             allowed=", ".join(self.joints[j] for j in sorted(needed)) + " among them")  # fmt: skip
        parents, offsets = [], np.array(self.offsets[kept])
        for new, old in enumerate(kept):
            parent = self.parents[old]
            while parent not in kept and parent != -1:
                offsets[new] += self.offsets[parent]
                parent = self.parents[parent]
            parents.append(-1 if parent == -1 else kept.index(parent))
        pairs = [(kept.index(a), kept.index(b)) for a, b in self.pairs if a in kept and b in kept]
        ankle, other_ankle, toe, other_toe = (kept.index(j) for j in self.feet)
        feet = (ankle, other_ankle, toe, other_toe)
        return Skeleton(name, joints, tuple(parents), offsets, tuple(pairs), feet, self.captured)

    @property
    def other_side(self) -> dict[int, int]:
        """The joint of the other side, for each left and right one."""
        return dict(self.pairs) | {right: left for left, right in self.pairs}

    def mirrored(self) -> Skeleton:
        """Return the reflection across x = 0: sides swapped, x negated."""
        order = np.arange(self.n_joints)
        for left, right in self.pairs:
            order[left], order[right] = right, left
        return replace(self, name=f"{self.name}-mirrored", offsets=self.offsets[order] * (-1.0, 1.0, 1.0))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "name": self.name,
            "joints": list(self.joints),
            "parents": list(self.parents),
            "offsets": self.offsets.tolist(),
            "pairs": [list(p) for p in self.pairs],
            "feet": list(self.feet),
            **({"captured": True} if self.captured else {}),
        }

    @classmethod
    def from_json(cls, obj: Mapping[str, Any]) -> Skeleton:
        """Read the result of `to_json`."""
        feet = obj["feet"]
        return cls(
            name=obj["name"],
            joints=tuple(obj["joints"]),
            parents=tuple(obj["parents"]),
            offsets=np.asarray(obj["offsets"], dtype=np.float64),
            pairs=tuple((left, right) for left, right in obj["pairs"]),
            feet=(feet[0], feet[1], feet[2], feet[3]),
            captured=bool(obj.get("captured", False)),
        )


_SMPL24_JOINTS = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot "
    "neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist "
    "left_hand right_hand"
)

#: Rest position of the pelvis of the male SMPL model, to which AIST++ was fitted, metres.
_SMPL_MALE_PELVIS = (-0.00217368, -0.24078918, 0.02858379)

#: Bone offsets of EDGE's vis.py (Tseng et al. 2023, MIT), metres.
_SMPL24_OFFSETS = (
    _SMPL_MALE_PELVIS,
    (0.05858135, -0.08228004, -0.01766408),
    (-0.06030973, -0.09051332, -0.01354254),
    (0.00443945, 0.12440352, -0.03838522),
    (0.04345142, -0.38646945, 0.008037),
    (-0.04325663, -0.38368791, -0.00484304),
    (0.00448844, 0.1379564, 0.02682033),
    (-0.01479032, -0.42687458, -0.037428),
    (0.01905555, -0.4200455, -0.03456167),
    (-0.00226458, 0.05603239, 0.00285505),
    (0.04105436, -0.06028581, 0.12204243),
    (-0.03483987, -0.06210566, 0.13032329),
    (-0.0133902, 0.21163553, -0.03346758),
    (0.07170245, 0.11399969, -0.01889817),
    (-0.08295366, 0.11247234, -0.02370739),
    (0.01011321, 0.08893734, 0.05040987),
    (0.12292141, 0.04520509, -0.019046),
    (-0.11322832, 0.04685326, -0.00847207),
    (0.2553319, -0.01564902, -0.02294649),
    (-0.26012748, -0.01436928, -0.03126873),
    (0.26570925, 0.01269811, -0.00737473),
    (-0.26910836, 0.00679372, -0.00602676),
    (0.08669055, -0.01063603, -0.01559429),
    (-0.0887537, -0.00865157, -0.01010708),
)

#: SMPL's 24 joints with the true pelvis: joints as AIST++ publishes them.
SMPL24 = Skeleton(
    name="smpl24",
    joints=tuple(_SMPL24_JOINTS.split()),
    parents=(-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21),
    offsets=np.array(_SMPL24_OFFSETS),
    pairs=((1, 2), (4, 5), (7, 8), (10, 11), (13, 14), (16, 17), (18, 19), (20, 21), (22, 23)),
    feet=(7, 8, 10, 11),
)

#: The same with EDGE's root: the pelvis is at the translation itself (0.24 m too high).
SMPL24_EDGE = SMPL24.with_root_offset("smpl24-edge", (0.0, 0.0, 0.0))
