"""template_name: columns of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.core.bodies import transfer
from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Float32Array, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import SMPL24, Skeleton


@REPRESENTATIONS.register("template_name")
@dataclass(frozen=True)
class TemplateName(Representation):
    """Position of the pelvis, metres, +Y up."""

    version: ClassVar[int] = 1  # raise it whenever the columns change: it is part of the cache key
    axes: ClassVar[str] = "right-handed, +Y up, metres"

    @property
    def skeleton(self) -> Skeleton:
        """Skeleton of the columns' joints."""
        return SMPL24

    @property
    def columns(self) -> Columns:
        """The columns; mirroring reflects across the plane x = 0."""
        return Columns((Group("position", 3, "m", ("x", "y", "z")),), Mirror((0, 1, 2), (-1, 1, 1)))

    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> Float32Array:
        """Return (T, 3) of a motion on a body of the SMPL family; UsageError for others."""
        if contacts is not None:
            raise UsageError("template_name holds no contacts", found=contacts.name)
        # Without a `decode`, the representation is one that cannot be decoded.
        return transfer(motion, SMPL24).joints()[:, 0].astype(np.float32)
