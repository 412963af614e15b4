"""A checked recipe: what shapes a dataset, its plug-ins made. `recipe_file` reads one from YAML.

Every worker process imports this; what checks documents is imported by the process that reads them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import json_sha256
from dancedata.core.movement import Movement
from dancedata.core.windows import WindowGrid
from dancedata.recipes.documents import document_of


@dataclass(frozen=True)
class WindowSpec(WindowGrid):
    """Windows in frames at the recipe's rate; order as in the store's format; which are kept."""

    order: Literal["time", "name"]
    filter: Movement | None = None

    def document(self) -> dict[str, Any]:
        """Return all keys, defaults included."""
        chosen = None if self.filter is None else {"movement": document_of(self.filter)}
        return {
            "length_frames": self.length,
            "stride_frames": self.stride,
            "order": self.order,
            "filter": chosen,
        }


@dataclass(frozen=True)
class MotionSlot:
    """A representation and the contact rule it is given."""

    representation: Any
    contacts: Any | None

    @property
    def name(self) -> str:
        """Name of the field."""
        return str(self.representation.name)

    def document(self) -> dict[str, Any]:
        """Return all parameters, defaults included."""
        document = document_of(self.representation)
        if self.contacts is not None:
            document["contacts"] = {self.contacts.name: document_of(self.contacts)}
        return document


@dataclass(frozen=True)
class Recipe:
    """A checked recipe, its plug-ins made."""

    name: str
    description: str
    dataset: Any
    grid: FrameGrid
    scope: Literal["track", "window"]
    windows: WindowSpec
    motion: tuple[MotionSlot, ...]
    audio: tuple[Any, ...]
    keymotion: tuple[Any, ...]
    mirror: bool
    shard_mb: int

    def __repr__(self) -> str:
        """Show name, dataset, rate and fields; `document` has every key."""
        fields = ", ".join(plugin.name for plugin in (*self.motion, *self.keymotion, *self.audio))
        about = f"dataset {self.dataset.name}, {self.grid} FPS, {self.scope} scope, fields: {fields}"
        return f"Recipe({self.name!r}, {about})"

    @property
    def fps(self) -> Fraction:
        """Frames a second of the store."""
        return self.grid.rate

    def grid_of(self, slot: MotionSlot) -> FrameGrid:
        """Return the grid of a motion field: the representation's own rate, else the recipe's."""
        rate = slot.representation.rate
        return self.grid if rate is None else FrameGrid(rate)

    @cached_property
    def document(self) -> dict[str, Any]:
        """The recipe with every default spelled out, as JSON; without paths, which are no part of its hash."""
        return {
            "recipe": 1,
            "name": self.name,
            "description": self.description,
            "dataset": {self.dataset.name: document_of(self.dataset)},
            "fps": str(self.grid),
            "scope": self.scope,
            "windows": self.windows.document(),
            "motion": {slot.name: slot.document() for slot in self.motion},
            "audio": {feature.name: document_of(feature) for feature in self.audio},
            "keymotion": {plugin.name: document_of(plugin) for plugin in self.keymotion},
            "augment": {"mirror": self.mirror},
            "store": {"shard_mb": self.shard_mb},
        }

    @cached_property
    def sha256(self) -> str:
        """Hash of all that shapes the result: not the name or description."""
        shaping = {k: v for k, v in self.document.items() if k not in ("name", "description")}
        return json_sha256(shaping)


def resolve(recipe: Recipe, hash_file: Callable[[Path], str]) -> Recipe:
    """Return the recipe with everything fixed that depends on this machine, such as the precision of a network.

    Parameters
    ----------
    hash_file
        Gives the SHA-256 of a file, such as `Cache.file_sha256`.
    """
    return replace(recipe, audio=tuple(resolve_feature(feature, hash_file) for feature in recipe.audio))


def resolve_feature(feature: Any, hash_file: Callable[[Path], str]) -> Any:
    """Return an audio feature that is ready to compute; most are as they are."""
    return feature.resolved(hash_file) if hasattr(feature, "resolved") else feature
