"""Lodge's key motions."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SMPLX22, SMPLX55, transfer_to
from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import KeyMotionFinder
from dancedata.core.registry import KEYMOTIONS
from dancedata.core.skeleton import Skeleton
from dancedata.core.typing import override
from dancedata.metrics.key_motion import SIGMA_FRAMES, key_motion

_GROUPS = (Group("speed", 1, "m/frame"), Group("minimum", 1, "0/1"), Group("prominence", 1, "m/frame"))


@KEYMOTIONS.register("lodge")
@dataclass(frozen=True)
class Lodge(KeyMotionFinder):
    """Kinetic curve over SMPL-X's 55 joints, and its minima (Lodge, Li et al. 2024).

    All 55 joints count, with hands, jaw and eyes at rest, as in Lodge; but the minima are those of the whole clip,
    including frames before `trim_start`, whereas Lodge's code finds those of each window. Columns: the smoothed curve
    in metres per frame, 1 at a strict local minimum, the prominence of the minimum. Mirroring does not change them.

    Attributes
    ----------
    sigma_frames
        Width of the Gaussian, in frames of the recipe; Lodge's 5 are for 30 frames per second.
    """

    columns: ClassVar[Columns] = Columns(_GROUPS, mirror=Mirror((0, 1, 2), (1, 1, 1)))
    skeleton: ClassVar[Skeleton] = SMPLX55

    sigma_frames: float = SIGMA_FRAMES

    def __post_init__(self) -> None:
        if not (self.sigma_frames > 0 and math.isfinite(self.sigma_frames)):
            raise UsageError("sigma_frames must be above 0", found=self.sigma_frames, allowed="frames, > 0")

    @override
    def analyse(self, motion: Motion) -> npt.NDArray[np.float32]:
        # Through the 22 body joints, so that fingers, jaw and eyes are at rest.
        body = transfer_to(transfer_to(motion, SMPLX22, keep="translation"), self.skeleton, keep="translation")
        return key_motion(body.joints(), self.sigma_frames).to_rows()
