"""EDGE's 151 columns."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import transfer
from dancedata.core.columns import Columns, Spatial
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import rotation_6d, rotvec_from_matrix
from dancedata.core.skeleton import SMPL24, SMPL24_EDGE, Skeleton
from dancedata.core.typing import override
from dancedata.representations._columns import required_rule
from dancedata.representations._six_d import ROLES, SixD

#: +Y up to +Z up: a quarter turn about x, (x, y, z) -> (x, -z, y).
_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_LAYOUT = SixD("edge151", SMPL24)


@REPRESENTATIONS.register("edge151")
@dataclass(frozen=True)
class Edge151(Representation):
    """Contacts 4, root translation 3, 24 joint rotations in 6D; the world turned to +Z up (EDGE, section 3.2).

    The columns have SMPL's translation, which EDGE uses as the position of the pelvis: its forward kinematics, and so
    the contacts, omit the pelvis's rest position. That shifts all joints equally and does not change speeds.
    6D is the first two rows of each matrix. Mirroring reflects across the plane x = 0.
    """

    default_contacts: ClassVar[str | None] = "velocity"
    skeleton: ClassVar[Skeleton] = SMPL24
    columns: ClassVar[Columns] = _LAYOUT.columns
    axes: ClassVar[str] = "right-handed, +Z up, metres"
    spatial: ClassVar[Spatial | None] = Spatial("z", ROLES)

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        rule = required_rule(contacts, _LAYOUT.name)
        motion = transfer(motion, self.skeleton)
        # Contacts are computed before the world is turned: speeds do not depend on it.
        joints = motion.joints(SMPL24_EDGE)
        matrices = motion.matrices
        packed = _LAYOUT.pack(rule(joints, motion.grid, SMPL24_EDGE), motion.translation @ _Z_UP.T, matrices)
        packed[:, 7:13] = rotation_6d(_Z_UP @ matrices[:, 0])
        return packed

    @override
    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        translation, matrices = _LAYOUT.unpack(array)
        matrices[:, 0] = _Z_UP.T @ matrices[:, 0]
        return Motion(translation @ _Z_UP, rotvec_from_matrix(matrices), grid, self.skeleton)
