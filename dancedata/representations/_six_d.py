"""The layout that EDGE, Lodge and FineDance share: contacts 4, root translation 3, J joint rotations in 6D."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import transfer_to
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion, grounded
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.rotations import Float64Array, matrix_from_6d, rotation_6d, rotvec_from_matrix
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.spatial import Role, Spatial
from dancedata.core.typing import override
from dancedata.representations import _columns as parts

#: Behaviour of the layout's columns under a turn or a shift.
ROLES: Mapping[str, Role] = MappingProxyType(
    {"contact": "unchanged", "translation": "place", "rotation_6d": "root_rotation"}
)


@dataclass(frozen=True)
class SixD:
    """Contacts 4, root translation 3, J x 6D (two rows, Zhou et al. 2019) of a skeleton; `name`, for messages."""

    name: str
    skeleton: Skeleton

    @property
    def width(self) -> int:
        """Number of columns."""
        return 7 + 6 * self.skeleton.n_joints

    @property
    def columns(self) -> Columns:
        """The columns and their mirror."""
        return parts.columns_of(
            parts.contacts(self.skeleton), parts.translation(), parts.rotations(self.skeleton, n_rows=2)
        )

    def pack(
        self, labels: npt.NDArray[np.float32], translation: Float64Array, matrices: Float64Array
    ) -> npt.NDArray[np.float32]:
        """Lay out contacts (T, 4), translation (T, 3) and matrices (T, J, 3, 3) as (T, D)."""
        out = np.empty((len(matrices), self.width), dtype=np.float32)
        out[:, :4] = labels
        out[:, 4:7] = translation
        out[:, 7:] = rotation_6d(matrices).reshape(len(matrices), -1)
        return out

    def unpack(self, array: npt.NDArray[Any]) -> tuple[Float64Array, Float64Array]:
        """Return translation (T, 3) and matrices (T, J, 3, 3) of (T, D) columns, not normalised, by Gram-Schmidt.

        Raises UsageError: The array has another shape.
        Raises DataError: "nan", or "bad_rotation" where six columns do not span a plane.
        """
        numbers = parts.checked(array, self.width, self.name, first=4)
        rows = numbers[:, 3:].reshape(len(numbers), self.skeleton.n_joints, 6)
        parts.refuse_rotations(
            np.linalg.norm(np.cross(rows[..., :3], rows[..., 3:]), axis=-1) < 1e-6,
            rows,
            "not a valid 6D rotation: its two rows do not span a plane",
            "decode columns that are not normalised: call the normaliser's unnormalize first",
            self.name,
            self.skeleton,
        )
        return numbers[:, :3], matrix_from_6d(rows)

    def encode(self, motion: Motion, rule: ContactRule) -> npt.NDArray[np.float32]:
        """Encode a motion on the layout's joints, +Y up; contacts from its own bones."""
        labels = rule(motion.joints(), motion.grid, motion.skeleton)
        return self.pack(labels, motion.translation, motion.matrices)

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode columns of `encode`; raises the errors of `unpack`."""
        translation, matrices = self.unpack(array)
        return Motion(translation, rotvec_from_matrix(matrices), grid, self.skeleton)


class SmplX6D(Representation):
    """Base of Lodge's and FineDance's columns: +Y up, on SMPL-X's joints, some of them grounded.

    Subclasses define `skeleton`, `default_contacts`, `axes` and whether they are `grounded`.
    """

    version: ClassVar[int] = 1
    spatial: ClassVar[Spatial | None] = Spatial("y", ROLES)

    @property
    def layout(self) -> SixD:
        """How the columns are laid out."""
        return SixD(self.name, self.skeleton)

    @property
    @override
    def columns(self) -> Columns:
        return self.layout.columns

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        """Encode a motion on the layout's own bones, those that `decode` uses.

        Fingers that the motion lacks are at rest. The pelvis stays where it is, except in Lodge's columns of SMPL's
        24 joints: there the translation keeps its numbers, as in Lodge's treatment of AIST++. So do rotations: those
        of SMPL are taken for SMPL-X's, whose limbs differ by up to 12.9 degrees. Limbs of a recording keep
        their directions (`bodies.transfer_to`). The contact rule gets the joints as they are encoded,
        grounded or not.
        """
        placed = self._placed(motion)
        return self.reencode(grounded(placed) if self.grounded else placed, contacts)

    @override
    def floor(self, motion: Motion) -> float:
        placed = self._placed(motion)
        return float(placed.translation[0, 1] - grounded(placed).translation[0, 1]) if self.grounded else 0.0

    @override
    def encode_above(
        self, motion: Motion, floor_m: float, contacts: ContactRule | None = None
    ) -> npt.NDArray[np.float32]:
        placed = self._placed(motion)
        return self.reencode(replace(placed, translation=placed.translation - (0.0, floor_m, 0.0)), contacts)

    def _placed(self, motion: Motion) -> Motion:
        """Put a motion on the layout's bones."""
        keeps_numbers = self.grounded and motion.skeleton.joints == SMPL24.joints
        return transfer_to(motion, self.skeleton, keep="translation" if keeps_numbers else "pelvis")

    @override
    def reencode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        return self.layout.encode(motion, parts.required_rule(contacts, self.layout.name))

    @override
    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode (T, D) columns; see `Representation.decode`.

        Not restored are contacts, `trim_start`, joints that the layout lacks and, if it is grounded, the height of
        the source (one number).
        """
        return self.layout.decode(array, grid)
