"""Contacts by speed, as EDGE and FineDance label them."""

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


@CONTACTS.register("velocity")
@dataclass(frozen=True)
class Velocity(ContactRule):
    """A foot joint is in contact while it moves slower than a limit (EDGE, Tseng et al. 2023, section 3.2).

    The speed of a frame is the 3-D displacement to the next one. The last frame has no next one: its displacement is
    taken as 0 and its labels are always 1, as in EDGE, whose clips are slices.

    Attributes
    ----------
    max_speed_m_s
        Limit in metres per second, exclusive. EDGE's 0.01 m per frame at 30 FPS is 0.3 m/s.
    """

    max_speed_m_s: float = 0.3

    def __post_init__(self) -> None:
        if not (self.max_speed_m_s > 0 and math.isfinite(self.max_speed_m_s)):
            raise UsageError(
                "max_speed_m_s must be above 0", found=self.max_speed_m_s, allowed="metres per second, > 0"
            )

    @override
    def __call__(self, joints: Float64Array, grid: FrameGrid, skeleton: Skeleton) -> npt.NDArray[np.float32]:
        feet = joints[:, list(skeleton.feet)]
        displacement = np.zeros(feet.shape[:2])
        displacement[:-1] = np.linalg.norm(np.diff(feet, axis=0), axis=-1)
        return (displacement < self.max_speed_m_s / float(grid.rate)).astype(np.float32)
