"""FineDance's 319 columns: body and hands."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SMPLX52, carried_over
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.representations._columns import required_rule
from dancedata.representations._six_d import CONVENTION, SixD

_LAYOUT = SixD("finedance319", SMPLX52)


@REPRESENTATIONS.register("finedance319")
@dataclass(frozen=True)
class FineDance319:
    """Contacts 4, root translation 3, 52 joint rotations in 6D, +Y up (FineDance, Li et al. 2023).

    As wide as `lodge319` and laid out like it, but other numbers: the heights are the source's, and contacts
    are speeds over the whole clip, on SMPL-X's joints. 6D is the first two rows of each matrix. FineDance passes
    on the six numbers as its files have them: the same wherever those are orthonormal. Mirroring reflects across
    the plane x = 0.
    """

    version: ClassVar[int] = 1
    default_contacts: ClassVar[str | None] = "velocity"
    skeleton: ClassVar[Skeleton] = SMPLX52
    axes: ClassVar[str] = "right-handed, +Y up, metres"
    rotation_6d: ClassVar[str | None] = CONVENTION
    rate: ClassVar[Fraction | None] = None
    grounded: ClassVar[bool] = False

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
            Rule for the first four columns.

        Returns
        -------
        (T, 319) float32

        Raises
        ------
        UsageError
            For another family of bodies, or without a rule.
        """
        rule = required_rule(contacts, _LAYOUT.name)
        return _LAYOUT.encode(carried_over(motion, self.skeleton), rule)

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode columns (T, 319), not normalised, into a motion at the rate of `grid`.

        Axis-angle vectors come back with a length of at most pi. Contacts are not part of a motion.

        Raises
        ------
        UsageError
            For another shape.
        DataError
            "nan", or "bad_rotation" where six columns span no plane.
        """
        return _LAYOUT.decode(array, grid)
