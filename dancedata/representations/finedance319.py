"""FineDance's 319 columns: body and hands."""

from dataclasses import dataclass
from typing import ClassVar

from dancedata.core.bodies import SMPLX52
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.representations._smplx_6d import SmplX6D


@REPRESENTATIONS.register("finedance319")
@dataclass(frozen=True)
class FineDance319(SmplX6D):
    """Contacts 4, root translation 3, 52 joint rotations in 6D, +Y up (FineDance, Li et al. 2023).

    The layout is that of `lodge319`, but the numbers differ: the heights are the source's, and contacts are speeds
    over the whole clip, on SMPL-X's joints. 6D is the first two rows of each matrix. FineDance copies the six numbers
    from its files: the same where those are orthonormal. Mirroring reflects across the plane x = 0.
    """

    skeleton: ClassVar[Skeleton] = SMPLX52
    default_contacts: ClassVar[str | None] = "velocity"
    axes: ClassVar[str] = "right-handed, +Y up, metres"
