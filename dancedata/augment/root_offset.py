"""A random shift over the floor."""

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


@AUGMENTATIONS.register("root_offset")
@dataclass(frozen=True)
class RootOffset(CopyAugmentation, SampleAugmentation):
    """The whole dance, shifted over the floor by one random vector; heights, and with them contacts, stay.

    Copies work for every representation; samples for those that define `spatial`. Columns that do not depend on the
    place, such as velocities, are unchanged. Music is unchanged.

    Attributes
    ----------
    max_m
        The shift is uniform over the disc with this radius, in metres.
    seed
        Seed of the copies: what is drawn for each is a pure function of (seed, clip id).
    """

    acts_on: ClassVar[Literal["world", "body"]] = "world"

    max_m: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        require_number("root_offset: max_m", self.max_m, 0, 100, "metres")
        require_seed(self.seed)

    @override
    def change_motion(self, motion: Motion, clip: str, about: Float64Array | None = None) -> Motion:
        return moved(motion, self._shift(Draw.of_clip(self.seed, clip)))

    @override
    def check_sample(self, field: SampleField) -> None:
        spatial_of(field)

    @override
    def change_sample(
        self, rows: Float32Array, field: SampleField, draw: Draw, about: Float64Array | None = None
    ) -> Float32Array:
        spatial = spatial_of(field)
        return rows if spatial is None else moved_rows(spatial, rows, field.columns, self._shift(draw))

    @override
    def scaler_bounds(
        self, low: Float64Array, high: Float64Array, field: SampleField
    ) -> tuple[Float64Array, Float64Array]:
        spatial = spatial_of(field)
        if spatial is None:
            return low, high
        return moved_bounds(spatial, low, high, field.columns, turns=False, shift_m=self.max_m)

    def _shift(self, draw: Draw) -> Placement:
        radius, angle = self.max_m * math.sqrt(draw.uniform()), draw.uniform(0.0, 2 * math.pi)
        return Placement(x_m=radius * math.cos(angle), z_m=radius * math.sin(angle))
