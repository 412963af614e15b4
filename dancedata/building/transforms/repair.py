"""Repairs of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from dancedata.building.plugins import TRANSFORMS
from dancedata.building.take import Scene, Transform
from dancedata.curation.repair import VERSION, Repairs


@TRANSFORMS.register("repair")
@dataclass(frozen=True)
class Repair(Transform):
    """Mends spikes, gaps, the floor and jitter; what is repaired is flagged.

    Attributes
    ----------
    spikes, gaps, floor, smoothing
        Limits above which motion is repaired, see `curation.repair.Repairs`; None: not.
    """

    version: ClassVar[int] = VERSION

    spikes: float | None = None
    gaps: float | None = None
    floor: float | None = None
    smoothing: float | None = None

    def scene(self, scene: Scene) -> Scene:
        """Repair the motion of each dancer."""
        repairs = Repairs(self.spikes, self.gaps, self.floor, self.smoothing)
        done = [repairs.apply(motion) for motion in scene.motions]
        return scene.with_motions([d.motion for d in done], [d.flags for d in done])

    def key(self) -> list[Any]:
        """Return the limits."""
        return [self.name, self.version, self.spikes, self.gaps, self.floor, self.smoothing]
