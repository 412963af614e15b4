"""HumanML3D's 263 columns."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import BODY_JOINTS, RETARGET, has_body
from dancedata.core.columns import Columns, Group, Mirror, Spatial
from dancedata.core.errors import UsageError
from dancedata.core.fitting import fitted
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.typing import override
from dancedata.representations import _columns as parts
from dancedata.representations import _humanml as humanml
from dancedata.representations._columns import Part


def _skeleton() -> Skeleton:
    """Return HumanML3D's body: SMPL's directions at rest, the target's lengths, the pelvis at the translation."""
    body = SMPL24.subset("humanml22", BODY_JOINTS)
    lengths = np.array(humanml.BONE_LENGTHS)[:, None]
    directions = body.offsets / np.linalg.norm(body.offsets, axis=-1, keepdims=True)
    return Skeleton(body.name, body.joints, body.parents, lengths * directions, body.pairs, body.feet)


#: The 22 joints and their bones.
HUMANML22 = _skeleton()
#: The root's turn, velocity and height.
ROOT = (
    Part(Group("root_turn", 1, "rad, half the angle"), Mirror((0,), (-1,))),
    Part(Group("root_velocity", 2, "m", ("x", "z")), Mirror((0, 1), (-1, 1))),
    Part(Group("root_height", 1, "m"), Mirror((0,), (1,))),
)
# Entry (r, c) of a rotation changes its sign if row or column is x, not if both are; here column by column.
_ENTRIES, _SIGNS = ("x0", "y0", "z0", "x1", "y1", "z1"), (1, -1, -1, -1, 1, 1)
_FEET = ("left_ankle", "left_foot", "right_ankle", "right_foot")
#: The columns after the root.
BODY = (
    parts.per_joint("local_position", "m", HUMANML22, "xyz", (-1, 1, 1), first=1),
    parts.per_joint("rotation_6d_columns", "1", HUMANML22, _ENTRIES, _SIGNS, first=1),
    parts.per_joint("local_velocity", "m", HUMANML22, "xyz", (-1, 1, 1)),
    Part(Group("foot_contact", 4, "1", _FEET), Mirror((2, 3, 0, 1), (1, 1, 1, 1))),
)
#: A clip begins at the origin and faces +Z wherever it was danced, and each row is relative to the one before.
SPATIAL = Spatial("y", {part.group.name: "unchanged" for part in (*ROOT, *BODY)})


@REPRESENTATIONS.register("humanml263")
@dataclass(frozen=True)
class Humanml263(Representation):
    """Root 4, 21 positions and rotations, 22 velocities, contacts 4; 20 per second (HumanML3D, Guo et al. 2022).

    Joints are retargeted to one body, whose bones have the lengths of a subject of AMASS; the lowest joint of the
    clip is at y = 0, the first frame at the origin and facing +Z. Positions and velocities are relative to
    the root and to the direction that the frame faces. Velocities lead to the next frame; the last row, which
    HumanML3D does not have, repeats those of the row before. 6D is the first two columns of each matrix.
    Mirroring swaps the sides and reflects across the plane x = 0; the body itself is not symmetric (by 7 mm).
    """

    skeleton: ClassVar[Skeleton] = HUMANML22
    columns: ClassVar[Columns] = parts.columns_of(*ROOT, *BODY)
    axes: ClassVar[str] = "right-handed, +Y up, each frame facing +Z; metres, metres per frame"
    rate: ClassVar[Fraction | None] = Fraction(20)
    spatial: ClassVar[Spatial | None] = SPATIAL
    grounded: ClassVar[bool] = True
    positions_only: ClassVar[bool] = True

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        """Encode the first 22 joints; contacts and velocities are per frame, so 20 per second are HumanML3D's.

        DataError, "bad_skeleton", for a bone without a length.
        """
        parts.refuse_rule(contacts, self.name)
        return self._columns(motion, None)

    @override
    def floor(self, motion: Motion) -> float:
        return humanml.floor_of(self._joints(motion))

    @override
    def encode_above(
        self, motion: Motion, floor_m: float, contacts: ContactRule | None = None
    ) -> npt.NDArray[np.float32]:
        parts.refuse_rule(contacts, self.name)
        return self._columns(motion, floor_m)

    def _columns(self, motion: Motion, floor_m: float | None) -> npt.NDArray[np.float32]:
        return humanml.columns_of(humanml.retargeted(self._joints(motion), floor_m))

    def _joints(self, motion: Motion) -> Float64Array:
        if not has_body(motion.skeleton):
            raise UsageError(
                f"{self.name} cannot hold a motion on skeleton {motion.skeleton.name}",
                found=f"joints {', '.join(motion.skeleton.joints[:4])}, ...",
                allowed=f"bodies of the SMPL family, whose first joints are {', '.join(BODY_JOINTS[:4])}, ...",
                fix=RETARGET,
            )
        return motion.joints()[:, : humanml.N_JOINTS]

    def positions(self, array: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Return the joint positions (T, 22, 3) of columns (T, D), metres, as HumanML3D's `recover_from_ric`.

        Raises UsageError: For another shape. Raises DataError: "nan".
        """
        return humanml.joints_of(self._humanml3d(parts.checked(array, self.columns.width, self.name)))

    def _humanml3d(self, array: Float64Array) -> Float64Array:
        return array

    @override
    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode columns into a motion with the positions that they hold.

        Rotations are fitted to the positions; the columns' own are not used, and neither are velocities of joints.
        How bones turn about themselves is not in the columns. Raises the errors of `positions`.
        """
        return fitted(self.positions(array), HUMANML22, grid)
