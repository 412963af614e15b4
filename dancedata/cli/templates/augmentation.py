"""template_name: copies of train clips, a step to the side."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import CopyAugmentation
from dancedata.core.registry import AUGMENTATIONS


@AUGMENTATIONS.register("template_name")
@dataclass(frozen=True)
class TemplateName(CopyAugmentation):
    """The same dance, moved along x.

    Attributes
    ----------
    step_m
        Distance in metres.
    """

    acts_on: ClassVar[Literal["world", "body"]] = "world"  # in a group: the same change for all dancers
    version: ClassVar[int] = 1  # raise it whenever the copies change: it is part of the cache key of changed motion

    step_m: float = 0.5

    def __post_init__(self) -> None:
        """Check the parameters; an error here is a problem of the recipe."""
        if not math.isfinite(self.step_m):
            raise UsageError("step_m must be finite", found=self.step_m, allowed="metres")

    def change_motion(self, motion: Motion, clip: str, about: object = None) -> Motion:
        """Return the motion of the copy; frames, rate and trim_start are unchanged."""
        return replace(motion, translation=np.add(motion.translation, (self.step_m, 0.0, 0.0)))
