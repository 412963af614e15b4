"""Contacts by height, as Lodge labels them."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import ContactRule
from dancedata.core.registry import CONTACTS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton
from dancedata.core.typing import override


@CONTACTS.register("height")
@dataclass(frozen=True)
class Height(ContactRule):
    """A foot joint is in contact while it is lower than a limit, however fast it moves (Lodge, Li et al. 2024).

    Heights are those of the joints above y = 0. `lodge139` and `lodge319` ground the motion first; in representations
    that do not (`edge151`, `finedance319`) y = 0 is that of the source.

    Attributes
    ----------
    ankle_m
        Limit of both ankles in metres, exclusive.
    toe_m
        Limit of both toes in metres, exclusive.
    """

    ankle_m: float = 0.12
    toe_m: float = 0.05

    def __post_init__(self) -> None:
        for name in ("ankle_m", "toe_m"):
            limit = getattr(self, name)
            if not (limit > 0 and math.isfinite(limit)):
                raise UsageError(f"{name} must be above 0", found=limit, allowed="metres above the floor, > 0")

    @override
    def __call__(self, joints: Float64Array, grid: FrameGrid, skeleton: Skeleton) -> npt.NDArray[np.float32]:
        heights = joints[:, list(skeleton.feet), 1]
        return (heights < (self.ankle_m, self.ankle_m, self.toe_m, self.toe_m)).astype(np.float32)
