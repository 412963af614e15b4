"""What the stages of `pipeline` read of the transform `retarget`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dancedata.core.bodies import SKELETONS
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.retarget.maps import Names
from dancedata.retarget.transfer import VERSION, Retargeted, retargeted

_KEYS = ("skeleton", "joint_map", "scale", "feet")


@dataclass(frozen=True)
class RetargetSpec:
    """What a recipe asks for.

    `skeleton`: Name of a skeleton of the SMPL family.
    `joint_map`: SMPL joint -> names; None for the map of the package that matches most joints.
    `scale`: Of the world; None for the ratio of the legs.
    `feet`: Whether feet are kept where they stand.
    """

    skeleton: str
    joint_map: Names | None = None
    scale: float | None = None
    feet: bool = True

    def document(self) -> dict[str, Any]:
        """Return JSON data with every default and the names of the joint map, not its path."""
        joint_map = None if self.joint_map is None else {k: list(v) for k, v in sorted(self.joint_map.items())}
        return {
            "skeleton": self.skeleton,
            "joint_map": joint_map or "auto",
            "scale": "auto" if self.scale is None else self.scale,
            "feet": self.feet,
        }

    def key(self, *, grouped: bool) -> dict[str, Any]:
        """Return the part of a cache key; `grouped` tells whether the clip is a dancer of a group."""
        return {**self.document(), "version": VERSION, "scale": self._scale(grouped)}

    def note(self) -> str:
        """Return a note on the source: what the stage does, and what it cannot map."""
        scale = "the ratio of the legs" if self.scale is None else self.scale
        return (
            f"every clip is retargeted to {self.skeleton} (scale of the world: {scale}; feet "
            f"{'kept where they stand' if self.feet else 'not corrected'}); fingers and spine joints that it lacks "
            "are dropped, twists of limbs are copied"
        )

    def apply(self, motion: Motion, *, where: str, grouped: bool) -> Retargeted:
        """Retarget the motion of one clip; DataError (``bad_skeleton``) if its skeleton cannot be mapped."""
        scale = self._scale(grouped)
        try:
            return retargeted(motion, SKELETONS[self.skeleton], self.joint_map, scale=scale, feet=self.feet)
        except UsageError as error:
            raise DataError(f"the motion cannot be retargeted to {self.skeleton}", reason="bad_skeleton", where=where,
                            found=str(error), fix="give a joint map: retarget.joint_map") from error  # fmt: skip

    def _scale(self, grouped: bool) -> float | None:
        return 1.0 if grouped and self.scale is None else self.scale
