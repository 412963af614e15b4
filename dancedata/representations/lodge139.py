"""Lodge's 139 columns: the body without hands."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SMPLX22, carried_over
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid
from dancedata.core.grounding import grounded
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.representations._columns import required_rule
from dancedata.representations._six_d import CONVENTION, SixD

_LAYOUT = SixD("lodge139", SMPLX22)


@REPRESENTATIONS.register("lodge139")
@dataclass(frozen=True)
class Lodge139:
    """Contacts 4, root translation 3, 22 joint rotations in 6D, +Y up, grounded (Lodge, Li et al. 2024).

    The first 139 columns of `lodge319`. The motion is put on the floor y = 0 as it stands in its first frame that
    belongs to the dance (`trim_start`); all frames are encoded, those before it too. Contacts are heights above
    that floor. The translation is SMPL-X's: the pelvis lies at its rest position (y = -0.35 m) plus these columns.
    6D is the first two rows of each matrix. Mirroring reflects across the plane x = 0.
    """

    version: ClassVar[int] = 1
    default_contacts: ClassVar[str | None] = "height"
    skeleton: ClassVar[Skeleton] = SMPLX22
    axes: ClassVar[str] = "right-handed, +Y up, metres, floor at y = 0"
    rotation_6d: ClassVar[str | None] = CONVENTION
    rate: ClassVar[Fraction | None] = None
    grounded: ClassVar[bool] = True

    @property
    def columns(self) -> Columns:
        """The 139 columns."""
        return _LAYOUT.columns

    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        """Encode a motion.

        Parameters
        ----------
        motion
            On a body of the SMPL family, +Y up; joints beyond the 22 of the body are left out.
        contacts
            Rule for the first four columns; it sees the grounded joints.

        Returns
        -------
        (T, 139) float32

        Raises
        ------
        UsageError
            For another family of bodies, or without a rule.
        """
        rule = required_rule(contacts, _LAYOUT.name)
        return _LAYOUT.encode(grounded(carried_over(motion, self.skeleton)), rule)

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode columns (T, 139), not normalised, into a grounded motion at the rate of `grid`.

        What is lost: the source's own height (one number), `trim_start`, joints beyond the 22. Axis-angle vectors
        come back with a length of at most pi.

        Raises
        ------
        UsageError
            For another shape.
        DataError
            "nan", or "bad_rotation" where six columns span no plane.
        """
        return _LAYOUT.decode(array, grid)
