"""Quality flags of motion, and the extent of the dancer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from dancedata.building.plugins import Annotator, Ask
from dancedata.building.take import Scene, Take
from dancedata.core.motion import Motion
from dancedata.core.quality import quality_flags
from dancedata.core.registry import ANNOTATORS
from dancedata.core.segments import Segment


@ANNOTATORS.register("vitals")
@dataclass(frozen=True)
class Vitals(Annotator):
    """Measures the dancer's height, metres, and flags suspicious frames and what transforms changed."""

    version: ClassVar[int] = 3
    copies: ClassVar[Literal["own", "parent", "none"]] = "own"
    stored: ClassVar[bool] = False

    def asks(self, take: Take) -> Sequence[Ask]:
        """Return what is asked for each dancer: of slices by themselves."""
        return [self.motion_ask(take, k, take.motion_steps) for k in range(len(take.dancers))]

    def annotate(self, scene: Scene) -> list[list[Any]]:
        """Return height and flags of each dancer."""
        pairs = zip(scene.motions, scene.flags, strict=True)
        return [[_vertical_extent(m), *(f.to_json() for f in [*quality_flags(m), *done])] for m, done in pairs]

    def flags(self, rows: Sequence[Any]) -> Sequence[dict[str, Any]]:
        """Return the flags."""
        return rows[1:]

    def measured(self, rows: Sequence[Any]) -> Mapping[str, Any]:
        """Return the height."""
        return {"height_m": rows[0]}

    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        """Return no segments."""
        return []


#: Place of its rows in a result.
VITALS = Vitals().id


def _vertical_extent(motion: Motion) -> float:
    """Return the distance of the highest joint from the lowest along y, median over frames, metres."""
    heights = motion.joints()[..., 1]
    return round(float(np.median(heights.max(axis=1) - heights.min(axis=1))), 4)
