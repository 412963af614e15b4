"""The meaning of the columns of an array: their permutation by mirroring, and their roles in a turn or a shift."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError, did_you_mean


@dataclass(frozen=True)
class Mirror:
    """Mirroring as a signed permutation, its own inverse: column j becomes signs[j] * column permutation[j]."""

    permutation: tuple[int, ...]
    signs: tuple[int, ...]

    def __repr__(self) -> str:
        moved = sum(k != j for j, k in enumerate(self.permutation))
        return f"Mirror({len(self.permutation)} columns, {moved} swapped, {self.signs.count(-1)} negated)"

    def apply(self, x: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the mirror image of x, (..., D), in x's dtype."""
        image: npt.NDArray[Any] = x[..., list(self.permutation)] * np.asarray(self.signs, dtype=x.dtype)
        return image

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {"permutation": list(self.permutation), "signs": list(self.signs)}

    @classmethod
    def from_json(cls, obj: Mapping[str, Any]) -> Mirror:
        """Read the result of `to_json`."""
        return cls(tuple(obj["permutation"]), tuple(obj["signs"]))


@dataclass(frozen=True)
class Group:
    """Adjacent columns that belong together.

    Attributes
    ----------
    unit
        "m", "rad", "1" for numbers without a unit, ...
    parts
        Names of the columns; () for numbered columns.
    """

    name: str
    width: int
    unit: str
    parts: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Group({self.name!r}, width={self.width}, unit={self.unit!r})"

    def __post_init__(self) -> None:
        if self.width < 1 or (self.parts and len(self.parts) != self.width):
            raise UsageError(f"column group {self.name!r}: width and number of names differ",
                             found=f"width {self.width}, {len(self.parts)} names")  # fmt: skip


@dataclass(frozen=True)
class Columns:
    """The columns of an array, in order."""

    groups: tuple[Group, ...]
    mirror: Mirror | None = None

    def __post_init__(self) -> None:
        if self.mirror is None:
            return
        order, signs = self.mirror.permutation, self.mirror.signs
        lengths = {len(order), len(signs)}  # checked first: a file may announce a huge width
        if lengths != {self.width} or sorted(order) != list(range(self.width)) or set(signs) - {1, -1}:
            raise UsageError("a mirror must be a signed permutation of the columns", found=f"{len(order)} entries")
        if any(order[order[j]] != j or signs[j] != signs[order[j]] for j in range(self.width)):
            raise UsageError("mirroring twice must restore the columns")

    def __repr__(self) -> str:
        groups = ", ".join(f"{g.name} {g.width}" for g in self.groups)
        return f"Columns({self.width}: {groups}{'; has a mirror image' if self.mirror is not None else ''})"

    @property
    def width(self) -> int:
        """Number of columns D."""
        return sum(g.width for g in self.groups)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the groups."""
        return tuple(g.name for g in self.groups)

    @property
    def labels(self) -> tuple[str, ...]:
        """One name per column, such as "contact.left_ankle" or "mfcc.3"."""
        return tuple(
            g.name if g.width == 1 and not g.parts else f"{g.name}.{g.parts[k] if g.parts else k}"
            for g in self.groups
            for k in range(g.width)
        )

    def slice(self, name: str) -> slice:
        """Return the columns of a group."""
        start = 0
        for group in self.groups:
            if group.name == name:
                return slice(start, start + group.width)
            start += group.width
        raise UsageError(f"no column group {name!r}", fix=did_you_mean(name, self.names))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        groups = [
            {"name": g.name, "width": g.width, "unit": g.unit, **({"parts": list(g.parts)} if g.parts else {})}
            for g in self.groups
        ]
        return {"groups": groups, "mirror": self.mirror.to_json() if self.mirror else None}

    @classmethod
    def from_json(cls, obj: Mapping[str, Any]) -> Columns:
        """Read the result of `to_json`."""
        groups = tuple(Group(g["name"], g["width"], g["unit"], tuple(g.get("parts", ()))) for g in obj["groups"])
        return cls(groups, Mirror.from_json(obj["mirror"]) if obj.get("mirror") else None)


#: What becomes of a group of columns when the dancer is turned about a vertical axis, or shifted.
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
