"""template_name: smooths the path of each dancer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dancedata.building.take import Scene, Transform
from dancedata.core.errors import UsageError
from dancedata.core.registry import TRANSFORMS


@TRANSFORMS.register("template_name")
@dataclass(frozen=True)
class TemplateName(Transform):
    """Replaces the place of the root by its mean over neighbouring frames.

    Attributes
    ----------
    seconds
        Length of the mean.
    """

    version: ClassVar[int] = 1  # raise it whenever the same motion gives other numbers

    seconds: float = 0.1

    def __post_init__(self) -> None:
        """Check the parameters; an error here is a problem of the recipe."""
        if not 0 < self.seconds < 10:
            raise UsageError("seconds: must be above 0 and below 10", found=self.seconds)

    def scene(self, scene: Scene) -> Scene:
        """Change the motion of all dancers of a take; as many frames, at the same rate."""
        smoothed = []
        for motion in scene.motions:
            half = round(self.seconds * float(motion.grid.rate) / 2)
            padded = np.pad(motion.translation, ((half, half), (0, 0)), mode="edge")
            windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
            smoothed.append(replace(motion, translation=windows.mean(axis=2)))
        return scene.with_motions(smoothed)
