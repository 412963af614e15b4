"""Joint positions of any skeleton."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SKELETONS, transfer
from dancedata.core.columns import Columns, Spatial
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.core.typing import override
from dancedata.representations import _columns as parts


@REPRESENTATIONS.register("joints")
@dataclass(frozen=True)
class Joints(Representation):
    """Positions of a skeleton's joints, metres, +Y up.

    They come from the motion's own bones if it has all of these joints (a body model with betas); otherwise, and if
    SMPL's 24 are transferred to SMPL-X, from those of the skeleton named here. They cannot be decoded: positions do
    not determine the rotation of a bone about its own axis. Mirroring reflects across the plane x = 0.

    Attributes
    ----------
    body
        The skeleton: the name of one that comes with the package, or a mapping as `Skeleton.to_json` returns it.
    """

    axes: ClassVar[str] = "right-handed, +Y up, metres"
    spatial: ClassVar[Spatial | None] = Spatial("y", {"position": "place"})

    body: str | Mapping[str, Any] = "smpl24"

    def __post_init__(self) -> None:
        object.__setattr__(self, "_skeleton", _skeleton(self.body))

    @property
    @override
    def skeleton(self) -> Skeleton:
        skeleton: Skeleton = self.__dict__["_skeleton"]
        return skeleton

    @property
    @override
    def columns(self) -> Columns:
        return parts.columns_of(parts.positions(self.skeleton))

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        """Encode a motion on the same joints, or on others if both are of the SMPL family."""
        parts.refuse_rule(contacts, "joints")
        return parts.packed_positions(transfer(motion, self.skeleton))


def _skeleton(body: str | Mapping[str, Any]) -> Skeleton:
    if isinstance(body, str):
        if body not in SKELETONS:
            raise UsageError(f"unknown skeleton {body!r}", fix=did_you_mean(body, SKELETONS))
        return SKELETONS[body]
    try:
        return Skeleton.from_json(body)
    except (LookupError, TypeError, ValueError) as error:
        raise UsageError(
            "body is not a valid skeleton",
            found=f"{type(error).__name__}: {error}",
            allowed="a name, or a mapping with name, joints, parents, offsets, pairs and feet, as Skeleton.to_json",
        ) from error
