"""A random turn about the vertical axis."""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from dancedata.augment._parameters import require_number, require_seed, spatial_of
from dancedata.core.draw import Draw
from dancedata.core.motion import Motion
from dancedata.core.placement import Placement, moved, moved_bounds, moved_rows
from dancedata.core.plugins import CopyAugmentation, Float32Array, SampleAugmentation, SampleField
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.core.typing import override


@AUGMENTATIONS.register("yaw")
@dataclass(frozen=True)
class Yaw(CopyAugmentation, SampleAugmentation):
    """The whole dance, turned by a random angle about the vertical through the root in the first frame.

    The first frame is that of the clip for stored copies, of the window for samples. All joints turn about the same
    axis, so that contacts, heights and key motions are unchanged. Music is unchanged.

    Copies work for every representation; samples for those that define `spatial`.

    Attributes
    ----------
    max_degrees
        The angle is uniform between minus and plus this.
    seed
        Seed of the copies: what is drawn for each is a pure function of (seed, clip id).
    """

    acts_on: ClassVar[Literal["world", "body"]] = "world"

    max_degrees: float = 180.0
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("yaw: max_degrees", self.max_degrees, 0, 180, "degrees")
        require_seed(self.seed)

    @override
    def change_motion(self, motion: Motion, clip: str, about: Float64Array | None = None) -> Motion:
        return moved(motion, self._turn(Draw.of_clip(self.seed, clip)), about)

    @override
    def check_sample(self, field: SampleField) -> None:
        spatial_of(field)

    @override
    def change_sample(
        self, rows: Float32Array, field: SampleField, draw: Draw, about: Float64Array | None = None
    ) -> Float32Array:
        spatial = spatial_of(field)
        return rows if spatial is None else moved_rows(spatial, rows, field.columns, self._turn(draw), about)

    @override
    def scaler_bounds(
        self, low: Float64Array, high: Float64Array, field: SampleField
    ) -> tuple[Float64Array, Float64Array]:
        spatial = spatial_of(field)
        if spatial is None or not self.max_degrees:
            return low, high
        return moved_bounds(spatial, low, high, field.columns, turns=True, shift_m=0.0)

    def _turn(self, draw: Draw) -> Placement:
        limit = math.radians(self.max_degrees)
        return Placement(turn_rad=draw.uniform(-limit, limit))
