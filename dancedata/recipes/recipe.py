"""A checked recipe with its plug-ins. Worker processes import this, but not `recipes.parse`, which reads YAML."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dancedata.building.fields.motion import RepresentationField
from dancedata.building.fields.music import FeatureField
from dancedata.building.plugins import Annotator, Field, WindowRule
from dancedata.building.spine import Parts
from dancedata.building.take import Transform
from dancedata.core.grid import FrameGrid, WindowSpec
from dancedata.core.hashing import recipe_hash
from dancedata.core.plugin_files import PluginFile, plugin_file
from dancedata.core.plugins import Dataset, Plugin
from dancedata.core.skeleton import Skeleton
from dancedata.files.documents import document_of

if TYPE_CHECKING:
    from dancedata.building.transforms.copy import Copy


@dataclass(frozen=True)
class Recipe:
    """A checked recipe and its plug-ins."""

    name: str
    description: str
    dataset: Dataset
    grid: FrameGrid
    windows: WindowSpec
    transforms: tuple[Transform, ...]
    fields: tuple[Field, ...]
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
    def motion(self) -> tuple[RepresentationField, ...]:
        """The fields with a representation."""
        return tuple(field for field in self.fields if isinstance(field, RepresentationField))

    @property
    def audio(self) -> tuple[FeatureField, ...]:
        """The fields with an audio feature."""
        return tuple(field for field in self.fields if isinstance(field, FeatureField))

    @cached_property
    def parts(self) -> Parts:
        """What the stages of a build read; annotators whose segments a rule reads are there without being named."""
        needed = (annotator for rule in self.rules for annotator in rule.annotators)
        annotators = {annotator.name: annotator for annotator in (*self.annotators, *needed)}
        chain = [*(step.on(self.grid) for step in self.transforms), *self.augment]
        return Parts(chain, self.fields, [*annotators.values()], self.rules, self.windows)

    @property
    def skeleton(self) -> Skeleton:
        """The body of the motion field with the most joints, which is the dataset's."""
        return max((motion_field.representation.skeleton for motion_field in self.motion), key=lambda s: s.n_joints)

    def notes(self, splits: Collection[str]) -> list[str]:
        """Return what its transforms and rules do, for a source with these splits."""
        parts: list[Transform | WindowRule] = [*self.transforms, *self.rules]
        return [note for part in parts for note in part.notes(splits)]

    @property
    def plugins(self) -> dict[str, Plugin]:
        """Its plug-ins other than the dataset, by the kind and name of each, as "motion edge151"."""
        used: dict[str, Plugin] = {name: plugin for field in self.fields for name, plugin in field.plugins.items()}
        used |= {f"transform {step.name}": step for step in self.transforms}
        used |= {f"augment {copy.name}": copy.augmentation for copy in self.augment}
        used |= {f"annotator {annotator.name}": annotator for annotator in self.annotators}
        return used | {f"rule {rule.name}": rule.parameters for rule in self.rules}

    @property
    def plugin_files(self) -> dict[str, PluginFile]:
        """Files of its local plug-ins, by the kind and name of each."""
        used = {f"dataset {self.dataset.name}": self.dataset, **self.plugins}
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
            **{slot: self._fields(slot) for slot in ("motion", "audio", "keymotion", "fields")},
            "augment": {copy.name: document_of(copy.augmentation) for copy in self.augment},
            "annotators": {annotator.name: document_of(annotator) for annotator in self.annotators},
            "rules": {rule.name: document_of(rule.parameters) for rule in self.rules},
            "store": {"shard_mb": self.shard_mb},
            "groups": {"incomplete": self.incomplete_groups},
        }

    def _fields(self, slot: str) -> dict[str, Any]:
        return {field.name: field.document() for field in self.fields if field.slot == slot and not field.without}

    @cached_property
    def sha256(self) -> str:
        """Hash of all that shapes the result: not the name or description."""
        return recipe_hash(self.document)


def resolve(recipe: Recipe, hash_file: Callable[[Path], str]) -> Recipe:
    """Return the recipe with everything fixed that depends on this machine, such as the precision of a network."""
    return replace(recipe, fields=tuple(field.resolved(hash_file) for field in recipe.fields))
