"""A checked recipe with its plug-ins. Worker processes import this, but not `recipes.parse`, which reads YAML."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from dancedata.building.plugins import Annotator, WindowRule
from dancedata.building.take import Transform
from dancedata.building.transforms.copy import Copy
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import recipe_hash
from dancedata.core.plugin_files import PluginFile, plugin_file
from dancedata.core.plugins import Dataset, Plugin
from dancedata.core.skeleton import Skeleton
from dancedata.recipes.documents import document_of
from dancedata.recipes.fields import FeatureJob, FieldSpec, KeyMotionField, MotionField, WindowSpec


@dataclass(frozen=True)
class Recipe:
    """A checked recipe, its plug-ins made."""

    name: str
    description: str
    dataset: Dataset
    grid: FrameGrid
    windows: WindowSpec
    transforms: tuple[Transform, ...]
    motion: tuple[MotionField, ...]
    audio: tuple[FeatureJob, ...]
    keymotion: tuple[KeyMotionField, ...]
    augment: tuple[Copy, ...]
    annotators: tuple[Annotator, ...]
    rules: tuple[WindowRule, ...]
    shard_mb: int
    incomplete_groups: Literal["set_aside", "keep"] = "set_aside"

    def __repr__(self) -> str:
        fields = ", ".join(field.name for field in self.fields)
        summary = f"dataset {self.dataset.name}, {self.grid} FPS, fields: {fields}"
        return f"Recipe({self.name!r}, {summary})"

    @property
    def fields(self) -> tuple[FieldSpec, ...]:
        """All fields: motion, key motions, audio."""
        return (*self.motion, *self.keymotion, *self.audio)

    @property
    def skeleton(self) -> Skeleton:
        """The body of the motion field with most joints, that of the dataset."""
        return max((motion_field.representation.skeleton for motion_field in self.motion), key=lambda s: s.n_joints)

    def notes(self, splits: Collection[str]) -> list[str]:
        """Return what its transforms and rules do, for a source with these splits."""
        parts: list[Transform | WindowRule] = [*self.transforms, *self.rules]
        return [note for part in parts for note in part.notes(splits)]

    @property
    def plugin_files(self) -> dict[str, PluginFile]:
        """Files of its local plug-ins, by the kind and name of each, as "motion edge151"."""
        used: dict[str, Plugin] = {f"dataset {self.dataset.name}": self.dataset}
        used |= {f"motion {field.name}": field.representation for field in self.motion}
        used |= {f"contacts {field.contacts.name}": field.contacts for field in self.motion if field.contacts}
        used |= {f"audio {job.name}": job.feature for job in self.audio}
        used |= {f"keymotion {field.name}": field.finder for field in self.keymotion}
        used |= {f"transform {step.name}": step for step in self.transforms}
        used |= {f"augment {copy.name}": copy.augmentation for copy in self.augment}
        used |= {f"annotator {annotator.name}": annotator for annotator in self.annotators}
        used |= {f"rule {rule.name}": rule.parameters for rule in self.rules}
        files = {name: plugin_file(type(plugin)) for name, plugin in used.items()}
        return {name: file for name, file in files.items() if file is not None}

    @property
    def fps(self) -> Fraction:
        """Frames per second."""
        return self.grid.rate

    @cached_property
    def document(self) -> dict[str, Any]:
        """The recipe with every default spelled out, as JSON; without paths, which are not part of its hash."""
        return {
            "recipe": 1,
            "name": self.name,
            "description": self.description,
            "dataset": {self.dataset.name: document_of(self.dataset)},
            "fps": str(self.grid),
            "windows": self.windows.document(),
            "transforms": [{step.name: document_of(step)} for step in self.transforms],
            "motion": {field.name: field.document() for field in self.motion if not field.without},
            "audio": {field.name: field.document() for field in self.audio},
            "keymotion": {field.name: field.document() for field in self.keymotion},
            "augment": {copy.name: document_of(copy.augmentation) for copy in self.augment},
            "annotators": {annotator.name: document_of(annotator) for annotator in self.annotators},
            "rules": {rule.name: document_of(rule.parameters) for rule in self.rules},
            "store": {"shard_mb": self.shard_mb},
            "groups": {"incomplete": self.incomplete_groups},
        }

    @cached_property
    def sha256(self) -> str:
        """Hash of all that shapes the result: not the name or description."""
        return recipe_hash(self.document)


def resolve(recipe: Recipe, hash_file: Callable[[Path], str]) -> Recipe:
    """Return the recipe with everything fixed that depends on this machine, such as the precision of a network.

    `hash_file`: Function that returns the SHA-256 of a file, such as `Cache.file_sha256`.
    """
    return replace(recipe, audio=tuple(replace(job, feature=job.feature.resolved(hash_file)) for job in recipe.audio))
