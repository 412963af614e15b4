"""Lodge's and FineDance's columns, on SMPL-X's joints, +Y up."""

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import transfer_to
from dancedata.core.columns import Columns, Spatial
from dancedata.core.grid import FrameGrid
from dancedata.core.ground import grounded
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.rotations import rotvec_from_matrix
from dancedata.core.skeleton import SMPL24
from dancedata.core.typing import override
from dancedata.representations._columns import required_rule
from dancedata.representations._six_d import ROLES, SixD


class SmplX6D(Representation):
    """Base of Lodge's and FineDance's columns: +Y up, on SMPL-X's joints, some of them grounded.

    Subclasses define `skeleton`, `default_contacts`, `axes` and whether they are `grounded`.
    """

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
        rule = required_rule(contacts, self.name)
        labels = rule(motion.joints(), motion.grid, motion.skeleton)
        return self.layout.pack(labels, motion.translation, motion.matrices)

    @override
    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode (T, D) columns; see `Representation.decode`.

        Not restored are contacts, `trim_start`, joints that the layout lacks and, if it is grounded, the height of
        the source (one number).
        """
        translation, matrices = self.layout.unpack(array)
        return Motion(translation, rotvec_from_matrix(matrices), grid, self.skeleton)
