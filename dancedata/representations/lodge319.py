"""Lodge's 319 columns: body and hands."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SMPLX52, carried_over
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid
from dancedata.core.grounding import grounded
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.representations._columns import required_rule
from dancedata.representations._six_d import CONVENTION, SixD

_LAYOUT = SixD("lodge319", SMPLX52)


@REPRESENTATIONS.register("lodge319")
@dataclass(frozen=True)
class Lodge319:
    """Contacts 4, root translation 3, 52 joint rotations in 6D, +Y up, grounded (Lodge, Li et al. 2024).

    As wide as `finedance319` and laid out like it, but other numbers: the motion is put on the floor y = 0 as it
    stands in its first frame that belongs to the dance (`trim_start`), and contacts are heights above that
    floor. All frames are encoded, those before `trim_start` too. 6D is the first two rows of each matrix, made
    orthonormal again. Mirroring reflects across the plane x = 0.
    """

    version: ClassVar[int] = 1
    default_contacts: ClassVar[str | None] = "height"
    skeleton: ClassVar[Skeleton] = SMPLX52
    axes: ClassVar[str] = "right-handed, +Y up, metres, floor at y = 0"
    rotation_6d: ClassVar[str | None] = CONVENTION
    rate: ClassVar[Fraction | None] = None
    grounded: ClassVar[bool] = True

    @property
    def columns(self) -> Columns:
        """The 319 columns."""
        return _LAYOUT.columns

    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        """Encode a motion.

        Parameters
        ----------
        motion
            On a body of the SMPL family, +Y up; fingers that it lacks do not turn, jaw and eyes are left out.
        contacts
            Rule for the first four columns; it sees the grounded joints.

        Returns
        -------
        (T, 319) float32

        Raises
        ------
        UsageError
            For another family of bodies, or without a rule.
        """
        rule = required_rule(contacts, _LAYOUT.name)
        return _LAYOUT.encode(grounded(carried_over(motion, self.skeleton)), rule)

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode columns (T, 319), not normalised, into a grounded motion at the rate of `grid`.

        What is lost: the source's own height (one number) and `trim_start`. Axis-angle vectors come back with a
        length of at most pi.

        Raises
        ------
        UsageError
            For another shape.
        DataError
            "nan", or "bad_rotation" where six columns span no plane.
        """
        return _LAYOUT.decode(array, grid)
