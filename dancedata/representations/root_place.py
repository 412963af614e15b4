"""Place and facing of a dancer, for use with columns that have no place."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Group, Mirror, Spatial
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.placement import Placement, moved
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.typing import override
from dancedata.representations import _columns as parts

_ACROSS = (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder"))
_AXES, _REFLECTED = ("x", "y", "z"), Mirror((0, 1, 2), (-1, 1, 1))
#: Below this length, metres, the line across the body has no direction on the floor: the last one stays.
_LEAST_M = 1e-3


@REPRESENTATIONS.register("root_place")
@dataclass(frozen=True)
class RootPlace(Representation):
    """Pelvis 3 and facing 3 in the world, +Y up.

    Beside a representation without a place (`humanml263`, `humanml264`), so that the dancers of a group stay where
    they are: without it, dancers in different places have equal columns. The facing is a unit vector on the floor,
    perpendicular to the line from right to left, of hips and shoulders together, as in HumanML3D; where that line is
    upright, the last one. It cannot be decoded by itself: `placed` puts a decoded motion where it was. Mirroring
    reflects across the plane x = 0.
    """

    skeleton: ClassVar[Skeleton] = SMPL24
    columns: ClassVar[Columns] = parts.columns_of(
        parts.Part(Group("place", 3, "m", _AXES), _REFLECTED), parts.Part(Group("facing", 3, "1", _AXES), _REFLECTED)
    )
    axes: ClassVar[str] = "right-handed, +Y up, metres"
    holds_places: ClassVar[bool] = True
    spatial: ClassVar[Spatial | None] = Spatial("y", {"place": "place", "facing": "direction"})

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        """Encode a motion on a skeleton with hips and shoulders."""
        parts.refuse_rule(contacts, "root_place")
        joints = motion.joints()
        return np.column_stack([joints[:, 0], facing(joints, motion.skeleton)]).astype(np.float32)

    @override
    def placed(self, motion: Motion, rows: npt.ArrayLike) -> Motion:
        values: npt.NDArray[Any] = np.asarray(rows, dtype=np.float64)
        if values.shape != (motion.n_frames, 6):
            raise UsageError(
                "the rows do not fit the motion", found=f"shape {values.shape}", allowed=f"({motion.n_frames}, 6)"
            )
        joints = motion.part(0, 1).joints()
        here, there = facing(joints, motion.skeleton)[0], values[0, 3:]
        angle = np.arctan2(there[0], there[2]) - np.arctan2(here[0], here[2])
        turned = moved(motion, Placement(turn_rad=float(angle)))
        return replace(turned, translation=turned.translation + values[0, :3] - joints[0, 0])


def facing(joints: Float64Array, skeleton: Skeleton) -> Float64Array:
    """Return the direction that a body faces, (T, 3), a unit vector on the floor, from joints (T, J, 3), +Y up."""
    missing = [name for pair in _ACROSS for name in pair if name not in skeleton.joints]
    if missing:
        raise UsageError(f"skeleton {skeleton.name} has no {', '.join(missing)}", fix="use a body of the SMPL family")
    pairs = [(joints[:, skeleton.index(left)], joints[:, skeleton.index(right)]) for left, right in _ACROSS]
    across = np.sum([left - right for left, right in pairs], axis=0)
    forward = np.stack([-across[:, 2], across[:, 0]], axis=1)
    return np.insert(parts.on_floor(forward, _LEAST_M), 1, 0.0, axis=1)
