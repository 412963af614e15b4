"""Bailando's 72 columns."""

from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import transfer
from dancedata.core.columns import Columns, Spatial
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.typing import override
from dancedata.representations import _columns as parts


@REPRESENTATIONS.register("bailando72")
@dataclass(frozen=True)
class Bailando72(Representation):
    """Positions of SMPL's 24 joints, metres, +Y up, 60 per second (Bailando, Siyao et al. 2022).

    The pelvis is SMPL's: its rest position plus the translation, unlike EDGE's. They cannot be decoded: positions do
    not determine the rotation of a bone about its own axis. Mirroring reflects across the plane x = 0.
    """

    skeleton: ClassVar[Skeleton] = SMPL24
    columns: ClassVar[Columns] = parts.columns_of(parts.positions(SMPL24))
    axes: ClassVar[str] = "right-handed, +Y up, metres"
    rate: ClassVar[Fraction | None] = Fraction(60)
    spatial: ClassVar[Spatial | None] = Spatial("y", {"position": "place"})

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        parts.refuse_rule(contacts, "bailando72")
        return parts.packed_positions(transfer(motion, self.skeleton))
