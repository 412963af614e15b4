"""Lodge's 139 columns: the body without hands."""

from dataclasses import dataclass
from typing import ClassVar

from dancedata.core.bodies import SMPLX22
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.representations._smplx_6d import SmplX6D


@REPRESENTATIONS.register("lodge139")
@dataclass(frozen=True)
class Lodge139(SmplX6D):
    """Contacts 4, root translation 3, 22 joint rotations in 6D, +Y up, grounded (Lodge, Li et al. 2024).

    The first 139 columns of `lodge319`. The motion is moved so that it stands on the floor y = 0 in the first frame
    of the dance (`trim_start`); all frames are encoded, including those before it. Contacts are heights above that
    floor. The translation is SMPL-X's: the pelvis is at its rest position (y = -0.35 m) plus these columns. 6D is the
    first two rows of each matrix. Mirroring reflects across the plane x = 0.
    """

    skeleton: ClassVar[Skeleton] = SMPLX22
    default_contacts: ClassVar[str | None] = "height"
    axes: ClassVar[str] = "right-handed, +Y up, metres, floor at y = 0"
    grounded: ClassVar[bool] = True
