"""A build, stage by stage: takes, transforms, windows, fields and segments, rules, groups, clips to store."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dancedata.building.compute import compute
from dancedata.building.groups import Groups, whole
from dancedata.building.judging import judged
from dancedata.building.plugins import Annotator, Field, WindowRule
from dancedata.building.segments import annotated
from dancedata.building.stored import BuiltClips, stored
from dancedata.building.take import Take, Transform
from dancedata.building.windows import cut_windows
from dancedata.core.errors import SourceError, UsageError, error_note
from dancedata.core.grid import WindowSpec
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs


class Parts(NamedTuple):
    """The parts of a recipe, in the order in which a build uses them."""

    transforms: Sequence[Transform]
    fields: Sequence[Field]
    annotators: Sequence[Annotator]
    rules: Sequence[WindowRule]
    windows: WindowSpec


def build_clips(
    cache: Cache,
    takes: Sequence[Take],
    parts: Parts,
    groups: Groups,
    computed: Sequence[Field],
    *,
    jobs: Jobs,
    progress: Progress,
) -> BuiltClips:
    """Return the clips of a source's takes, with rows of the fields `computed`, which in a build are all fields."""
    transforms, fields, annotators, rules, windows = parts
    results = cut_windows(expand(takes, transforms), fields, windows)
    results = compute(cache, results, [*computed, *annotators], jobs=jobs, progress=progress)
    results = judged(results, rules, fields, annotators, windows)
    results = whole(results, groups)
    results = annotated(results, annotators, windows.grid)
    return stored(results, computed, annotators, groups.sizes, windows.grid)


def expand(takes: Sequence[Take], transforms: Sequence[Transform]) -> list[Take]:
    """Return the takes that transforms make, parents before copies; SourceError for names that are there twice."""
    for transform in transforms:
        with error_note(f"dancedata: while the transform {transform.name} expanded takes"):
            takes = [expanded for take in takes for expanded in transform.expand(take)]
    named: dict[str, Take] = {}
    for take in takes:
        if take.parent is not None and (take.parent.parent, len(take.steps)) != (None, len(take.parent.steps) + 1):
            raise UsageError("a transform that makes copies has to be the last one", where=f"clip {take.name}",
                             found=", ".join(step.name for step in take.steps),
                             fix="put it last in transforms; copies are not copied again")  # fmt: skip
        for name in [*([f"group {take.group}"] if take.group else []), *(f"clip {d.id}" for d in take.dancers)]:
            if named.setdefault(name, take) is not take:
                raise SourceError("two clips or groups would get the same name", where=name,
                                  found=f"{take.origin.name} and its copies, or another one",
                                  fix="rename one, or leave out the transform that makes the copy")  # fmt: skip
    return sorted(takes, key=lambda take: take.parent is not None)
