"""The parts of a recipe: the only place that reads one."""

from __future__ import annotations

from dancedata.building.annotators.facts import Facts
from dancedata.building.annotators.faults import Faults
from dancedata.building.annotators.stated import Stated
from dancedata.building.annotators.vitals import Vitals
from dancedata.building.fields.files import FileField
from dancedata.building.fields.motion import MotionRows
from dancedata.building.fields.music import MusicRows
from dancedata.building.plugins import Annotator, Field, WindowRule
from dancedata.building.rules.curate import Curate
from dancedata.building.rules.filter import Filtered
from dancedata.building.spine import Parts
from dancedata.building.take import Transform
from dancedata.building.transforms.copy import Copy
from dancedata.building.transforms.repair import Repair
from dancedata.building.transforms.retarget import Retarget
from dancedata.recipes.recipe import Recipe


def parts_of(recipe: Recipe) -> Parts:
    """Return the parts of a checked recipe."""
    return Parts(
        _transforms(recipe), _fields(recipe), _annotators(recipe), _rules(recipe), recipe.windows,
        recipe.segments.lexicons,
    )  # fmt: skip


def _transforms(recipe: Recipe) -> list[Transform]:
    repairs, other_side = recipe.curation.repairs, tuple(recipe.skeleton.other_side.items())
    chain: list[Transform] = [Repair(**repairs.key())] if repairs else []
    chain += [] if recipe.retarget is None else [Retarget(recipe.retarget)]
    return [*chain, *(Copy(spec, other_side) for spec in recipe.augment)]


def _fields(recipe: Recipe) -> list[Field]:
    motion = [MotionRows(f, () if f.repaired else (Repair.name,)) for f in recipe.motion]
    keys = [MotionRows(f) for f in recipe.keymotion]
    audio = [FileField(job) if job.feature.from_files else MusicRows(job) for job in recipe.audio]
    return [*motion, *keys, *audio]


def _annotators(recipe: Recipe) -> list[Annotator]:
    facts = recipe.segments.facts
    annotators: list[Annotator] = [Stated(recipe.segments.genre), Vitals()]
    annotators += [] if facts is None else [Facts(**{**facts.document(), "kinds": facts.kinds})]
    return annotators + ([Faults()] if recipe.curation.rules else [])


def _rules(recipe: Recipe) -> list[WindowRule]:
    of_clips_first = sorted(recipe.curation.rules, key=lambda rule: rule.leave_out != "clip")
    rules: list[WindowRule] = [Curate(r.score, r.limit, r.leave_out, r.splits or ()) for r in of_clips_first]
    return rules + ([] if recipe.windows.filter is None else [Filtered(recipe.windows.filter)])
