"""template_name: how far dancers are from each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.building.fields.motion import SceneField
from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.motion import Motion
from dancedata.core.plugins import Float32Array
from dancedata.core.registry import FIELDS


@FIELDS.register("template_name")
@dataclass(frozen=True)
class TemplateName(SceneField):
    """Distance of each dancer from the centre of the group, seen from above; 0 for a dancer alone.

    Attributes
    ----------
    scale
        Factor of the values.
    """

    version: ClassVar[int] = 1  # raise it whenever the same motion gives other numbers

    scale: float = 1.0

    @property
    def columns(self) -> Columns:
        """The columns; a mirrored dancer is as far away."""
        return Columns((Group("distance", 1, "m"),), mirror=Mirror((0,), (1,)))

    def encode(self, motions: Sequence[Motion]) -> Sequence[Float32Array]:
        """Return rows (T, 1) for each dancer; the motions have the rate of the field."""
        places = np.stack([motion.translation[:, [0, 2]] for motion in motions])
        distances = np.linalg.norm(places - places.mean(axis=0), axis=-1)
        return [(self.scale * row).astype(np.float32)[:, None] for row in distances]
