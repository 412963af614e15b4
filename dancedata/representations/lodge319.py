"""Lodge's 319 columns: body and hands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dancedata.core.bodies import SMPLX52
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.representations._six_d import SixD, SmplX6D


@REPRESENTATIONS.register("lodge319")
@dataclass(frozen=True)
class Lodge319(SmplX6D):
    """Contacts 4, root translation 3, 52 joint rotations in 6D, +Y up, grounded (Lodge, Li et al. 2024).

    As wide as `finedance319` and laid out like it, but other numbers: the motion is put on the floor y = 0 as it
    stands in its first frame that belongs to the dance (`trim_start`), and contacts are heights above that
    floor. All frames are encoded, those before `trim_start` too. 6D is the first two rows of each matrix, made
    orthonormal again. Mirroring reflects across the plane x = 0.
    """

    layout: ClassVar[SixD] = SixD("lodge319", SMPLX52)
    skeleton: ClassVar[Skeleton] = SMPLX52
    default_contacts: ClassVar[str | None] = "height"
    axes: ClassVar[str] = "right-handed, +Y up, metres, floor at y = 0"
    grounded: ClassVar[bool] = True
