"""template_name: foot contacts by the height of the feet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import ContactRule, Float32Array
from dancedata.core.registry import CONTACTS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton


@CONTACTS.register("template_name")
@dataclass(frozen=True)
class TemplateName(ContactRule):
    """A foot joint is in contact while it is near the lowest point that it reaches.

    Attributes
    ----------
    height_m
        Limit in metres, exclusive.
    """

    version: ClassVar[int] = 1  # raise it whenever the labels change: it is part of the cache key

    height_m: float = 0.05

    def __post_init__(self) -> None:
        """Check the parameters; an error here is a problem of the recipe."""
        if not self.height_m > 0:
            raise UsageError("height_m must be above 0", found=self.height_m, allowed="metres, > 0")

    def __call__(self, joints: Float64Array, grid: FrameGrid, skeleton: Skeleton) -> Float32Array:
        """Return labels (T, 4), 0 or 1, for `skeleton.feet` from joint positions (T, J, 3) in metres."""
        heights: Float64Array = joints[:, list(skeleton.feet), 1]
        lowest: Float64Array = heights.min(axis=0)
        return (heights - lowest < self.height_m).astype(np.float32)
