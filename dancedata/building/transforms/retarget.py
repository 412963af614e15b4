"""Motion of every take on one skeleton."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from dancedata.building.plugins import TRANSFORMS
from dancedata.building.take import Scene, Transform
from dancedata.recipes.retarget import RetargetSpec
from dancedata.retarget.transfer import VERSION


@TRANSFORMS.register("retarget")
@dataclass(frozen=True)
class Retarget(Transform):
    """Moves motion to a skeleton of the SMPL family; residuals are flagged.

    Attributes
    ----------
    spec
        The skeleton, and how joints are mapped.
    """

    version: ClassVar[int] = VERSION

    spec: RetargetSpec

    def scene(self, scene: Scene) -> Scene:
        """Retarget the motion of each dancer; DataError (``bad_skeleton``) if its skeleton cannot be mapped."""
        pairs = zip(scene.motions, scene.refs, strict=True)
        done = [self.spec.apply(m, where=str(ref.motion_path), grouped=bool(ref.group)) for m, ref in pairs]
        return scene.with_motions([d.motion for d in done], [d.flags() for d in done])

    def key(self) -> list[Any]:
        """Return what decides the numbers."""
        return [self.name, self.version, self.spec.document()]
