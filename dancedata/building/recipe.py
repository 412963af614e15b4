"""The parts of a recipe: the only place that reads one."""

from __future__ import annotations

from dancedata.building.fields.files import audio_field
from dancedata.building.fields.motion import MotionRows
from dancedata.building.plugins import Field
from dancedata.building.spine import Parts
from dancedata.recipes.recipe import Recipe


def parts_of(recipe: Recipe) -> Parts:
    """Return the parts of a checked recipe; annotators whose segments a rule reads are there without being named."""
    needed = (annotator for rule in recipe.rules for annotator in rule.annotators)
    annotators = {annotator.name: annotator for annotator in (*recipe.annotators, *needed)}
    chain = [*(step.on(recipe.grid) for step in recipe.transforms), *recipe.augment]
    return Parts(chain, _fields(recipe), [*annotators.values()], recipe.rules, recipe.windows)


def _fields(recipe: Recipe) -> list[Field]:
    motion = [MotionRows(f, f.without) for f in recipe.motion]
    keys = [MotionRows(f) for f in recipe.keymotion]
    return [*motion, *keys, *map(audio_field, recipe.audio)]
