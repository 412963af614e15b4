"""FACT's 219 columns."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import transfer
from dancedata.core.columns import Columns, Spatial
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import rotvec_from_matrix
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.typing import override
from dancedata.representations import _columns as parts

_WIDTH = 3 + 9 * SMPL24.n_joints
#: Tolerance of R R^T against the identity, entry by entry: float32 columns are within 1e-6.
_TOLERANCE = 1e-4


@REPRESENTATIONS.register("fact219")
@dataclass(frozen=True)
class Fact219(Representation):
    """Root translation 3 and 24 rotation matrices, row by row, +Y up, 60 per second (FACT, Li et al. 2021).

    The translation is SMPL's, in metres. FACT prepends six zeros for training (225 columns); they are
    omitted here. Mirroring reflects across the plane x = 0.
    """

    skeleton: ClassVar[Skeleton] = SMPL24
    columns: ClassVar[Columns] = parts.columns_of(parts.translation(), parts.rotations(SMPL24, n_rows=3))
    axes: ClassVar[str] = "right-handed, +Y up, metres"
    rate: ClassVar[Fraction | None] = Fraction(60)
    spatial: ClassVar[Spatial | None] = Spatial("y", {"translation": "place", "rotation_matrix": "root_rotation"})

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        parts.refuse_rule(contacts, "fact219")
        motion = transfer(motion, self.skeleton)
        out = np.empty((motion.n_frames, _WIDTH), dtype=np.float32)
        out[:, :3] = motion.translation
        out[:, 3:] = motion.matrices.reshape(motion.n_frames, -1)
        return out

    @override
    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode (T, 219) columns; see `Representation.decode`.

        Matrices are used as they are: the output of a network must be projected to the nearest rotations first, as
        FACT does by singular value decomposition.
        """
        numbers = parts.checked(array, _WIDTH, "fact219")
        rows = numbers[:, 3:].reshape(len(numbers), SMPL24.n_joints, 9)
        matrices = rows.reshape(*rows.shape[:2], 3, 3)
        off = np.abs(matrices @ matrices.swapaxes(-1, -2) - np.eye(3)).max(axis=(-2, -1))
        parts.refuse_rotations(
            (off > _TOLERANCE) | (np.linalg.det(matrices) < 0),
            rows,
            "not a valid rotation matrix",
            "decode columns that are not normalised, and project a network's output to the nearest rotations first",
            "fact219",
            SMPL24,
        )
        return Motion(numbers[:, :3], rotvec_from_matrix(matrices), grid, SMPL24)
