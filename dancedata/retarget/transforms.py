"""Motion of every take on one skeleton."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from dancedata.core.bodies import SKELETONS, has_body
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.registry import TRANSFORMS
from dancedata.core.text import shown
from dancedata.core.typing import override
from dancedata.kernel import Scene, Transform
from dancedata.retarget.maps import load_map
from dancedata.retarget.transfer import VERSION, Retargeted, retargeted


@TRANSFORMS.register("retarget")
@dataclass(frozen=True)
class Retarget(Transform):
    """Puts the motion of every clip on one skeleton; what is left between their joints is flagged.

    Attributes
    ----------
    skeleton
        Name of a skeleton of the SMPL family.
    joint_map
        "auto", the map of the package that matches most joints; its name; the path of a .json file; or SMPL joint ->
        names.
    scale
        Scale of the world; "auto" for the ratio of the legs.
    feet
        Whether feet are kept where they stand.
    """

    version: ClassVar[int] = VERSION
    not_for_groups: ClassVar[str] = "each dancer is lifted onto the floor by a height of his own"

    skeleton: str = "smpl24"
    joint_map: Any = "auto"
    scale: Any = "auto"
    feet: bool = True

    def __post_init__(self) -> None:
        targets = [name for name, body in SKELETONS.items() if has_body(body)]
        if self.skeleton not in targets:
            raise UsageError("skeleton: not a skeleton of the SMPL family", found=shown(repr(self.skeleton)),
                             allowed=", ".join(targets))  # fmt: skip
        number = isinstance(self.scale, int | float) and not isinstance(self.scale, bool)
        if self.scale != "auto" and not (number and 0.01 <= self.scale <= 100):
            raise UsageError("scale: must be auto or a number", found=shown(repr(self.scale)), allowed="0.01 to 100")
        object.__setattr__(self, "scale", float(self.scale) if number else "auto")
        if not isinstance(self.joint_map, str | Mapping):
            raise UsageError("joint_map: must be a name, a path or a mapping", found=shown(repr(self.joint_map)))
        try:
            names = "auto" if self.joint_map == "auto" else load_map(self.joint_map)
        except UsageError as error:
            raise UsageError(f"joint_map: {error}") from error
        object.__setattr__(self, "joint_map", names)  # its names, not its path, are what it is known by

    @override
    def scene(self, scene: Scene) -> Scene:
        done = [self._retargeted(motion, ref) for motion, ref in zip(scene.motions, scene.refs, strict=True)]
        return scene.with_motions([d.motion for d in done], [d.flags() for d in done])

    def _retargeted(self, motion: Motion, ref: ClipRef) -> Retargeted:
        names = None if self.joint_map == "auto" else self.joint_map
        of_body = 1.0 if ref.group else None  # a group has one world
        scale = of_body if self.scale == "auto" else self.scale
        try:
            return retargeted(motion, SKELETONS[self.skeleton], names, scale=scale, feet=self.feet)
        except UsageError as error:
            raise DataError(f"the motion cannot be retargeted to {self.skeleton}", reason="bad_skeleton",
                            where=ref.motion_path, found=str(error),
                            fix="give a joint map: transforms.retarget.joint_map") from error  # fmt: skip

    @override
    def notes(self, splits: Collection[str]) -> list[str]:
        scale = "the ratio of the legs" if self.scale == "auto" else self.scale
        feet = "kept where they stand" if self.feet else "not corrected"
        return [
            f"every clip is retargeted to {self.skeleton} (scale of the world: {scale}; feet {feet}); fingers and "
            "spine joints that it lacks are dropped, twists of limbs are copied"
        ]
