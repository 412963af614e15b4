"""InfiniteDance's 264 columns."""

from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Group, Mirror, Spatial
from dancedata.core.motion import Motion
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.core.typing import override
from dancedata.representations import _columns as parts
from dancedata.representations._columns import Part
from dancedata.representations.humanml263 import BODY, ROOT, SPATIAL, Humanml263

_TURN, _VELOCITY, _HEIGHT = ROOT
_ANGLE = Part(Group("root_angle", 1, "rad, half the angle"), Mirror((0,), (-1,)))


def with_root_angle(array: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return InfiniteDance's columns (T, 264) of HumanML3D's (T, 263)."""
    angle = np.zeros((len(array), 1))
    angle[1:, 0] = np.cumsum(array[:-1, 0], dtype=np.float64)
    return np.concatenate([array[:, 3:4], angle, array[:, :3], array[:, 4:]], axis=1).astype(np.float32)


@REPRESENTATIONS.register("humanml264")
@dataclass(frozen=True)
class Humanml264(Humanml263):
    """InfiniteDance's columns: HumanML3D's with the root's height first and its angle before the turn; 30 per second.

    The angle is the sum of the turns of the rows before, so like them half the angle, 0 in the first row; decoding
    does not use it. The limit of contacts remains 0.045 m per frame, whatever the rate. A turn past half a circle has
    the wrong sign in one row, as in HumanML3D.
    """

    columns: ClassVar[Columns] = parts.columns_of(_HEIGHT, _ANGLE, _TURN, _VELOCITY, *BODY)
    rate: ClassVar[Fraction | None] = Fraction(30)
    spatial: ClassVar[Spatial | None] = Spatial("y", {**SPATIAL.roles, "root_angle": "unchanged"})

    @override
    def _columns(self, motion: Motion, floor_m: float | None) -> npt.NDArray[np.float32]:
        return with_root_angle(super()._columns(motion, floor_m))

    @override
    def _humanml3d(self, array: Float64Array) -> Float64Array:
        return np.concatenate([array[:, 2:5], array[:, :1], array[:, 5:]], axis=1)
