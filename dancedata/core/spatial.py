"""What becomes of a representation's columns when the dancer is turned about a vertical axis, or shifted."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

Role = Literal["place", "direction", "root_rotation", "unchanged"]


@dataclass(frozen=True)
class Spatial:
    """The roles of a representation's columns when a `placement.Placement` moves the dancer.

    Attributes
    ----------
    up
        The vertical axis of the columns' world. A world with +Z up is one with +Y up after (x, y, z) -> (x, -z, y).
    roles
        Of every group, by name. "place": points (x, y, z) in metres, the root's first; SMPL's translation counts,
        as the rest position of the pelvis is the same before and after a turn about the vertical through the pelvis.
        "direction": vectors (x, y, z), such as velocities. "root_rotation": the first two or three rows of each
        joint's matrix, row by row, joint 0 being the root, the others relative to their parents. "unchanged":
        columns that do not depend on the dancer's place and direction, such as contacts.
    """

    up: Literal["y", "z"]
    roles: Mapping[str, Role] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def placeless(self) -> bool:
        """Whether the columns hold neither place nor facing: those of two dancers anywhere are equal."""
        return set(self.roles.values()) == {"unchanged"}
