"""template_name: key motions of a clip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.motion import Motion
from dancedata.core.plugins import Float32Array, KeyMotionFinder
from dancedata.core.registry import KEYMOTIONS


@KEYMOTIONS.register("template_name")
@dataclass(frozen=True)
class TemplateName(KeyMotionFinder):
    """Mean speed of the joints, metres per frame; the first frame has none before it and counts as 0."""

    version: ClassVar[int] = 1  # raise it whenever the rows change: it is part of the cache key

    @property
    def columns(self) -> Columns:
        """The columns, and how mirroring permutes them: here not at all."""
        return Columns((Group("speed", 1, "m/frame"),), mirror=Mirror((0,), (1,)))

    def analyse(self, motion: Motion) -> Float32Array:
        """Return (T, 1) rows of a clip at the recipe's rate."""
        joints = motion.joints()
        speed = np.zeros((motion.n_frames, 1))
        speed[1:, 0] = np.linalg.norm(np.diff(joints, axis=0), axis=-1).mean(axis=-1)
        return speed.astype(np.float32)
