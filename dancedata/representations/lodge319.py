"""Lodge's 319 columns: body and hands."""

from dataclasses import dataclass
from typing import ClassVar

from dancedata.core.bodies import SMPLX52
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.representations._smplx_6d import SmplX6D


@REPRESENTATIONS.register("lodge319")
@dataclass(frozen=True)
class Lodge319(SmplX6D):
    """Contacts 4, root translation 3, 52 joint rotations in 6D, +Y up, grounded (Lodge, Li et al. 2024).

    The layout is that of `finedance319`, but the numbers differ: the motion is moved so that it stands on the floor
    y = 0 in the first frame of the dance (`trim_start`), and contacts are heights above that floor. All frames are
    encoded, including those before `trim_start`. 6D is the first two rows of each matrix, made orthonormal again.
    Mirroring reflects across the plane x = 0.
    """

    skeleton: ClassVar[Skeleton] = SMPLX52
    default_contacts: ClassVar[str | None] = "height"
    axes: ClassVar[str] = "right-handed, +Y up, metres, floor at y = 0"
    grounded: ClassVar[bool] = True
