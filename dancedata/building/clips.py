"""The clips of a recipe and a source: what builds, plans and checks ask of `building`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from dancedata.building.compute import compute
from dancedata.building.groups import Groups, groups_of
from dancedata.building.measuring import takes_of
from dancedata.building.plugins import Annotator
from dancedata.building.result import Result
from dancedata.building.sources import Sources, identify
from dancedata.building.spine import Parts, build_clips
from dancedata.building.stored import BuiltClips
from dancedata.building.take import Transform
from dancedata.core.clip import FOUND, Reject, Scan
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Dataset
from dancedata.core.registry import STARTS
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs
from dancedata.files.documents import content_hashes
from dancedata.recipes.recipe import Recipe


def sources_of(cache: Cache, recipe: Recipe, scan: Scan, *, jobs: Jobs, progress: Progress, **inputs: Any) -> Sources:
    """Identify the files of a source, see `identify`; find the offsets of music that it leaves to the build."""
    scan = with_found_starts(cache, recipe.dataset, scan, jobs=jobs, progress=progress)
    fields = recipe.parts.fields
    sources = identify(cache, recipe.dataset, fields, scan, jobs=jobs, progress=progress, **inputs)
    content = {
        f"{name} {file}": sha256
        for name, plugin in recipe.plugins.items()
        for file, sha256 in content_hashes(plugin, cache.file_sha256).items()
    }
    return replace(sources, plugin_content=content)


def compute_clips(
    cache: Cache, recipe: Recipe, sources: Sources, *, jobs: Jobs, progress: Progress, networks: bool = True
) -> BuiltClips:
    """Compute all fields and segments, or all but those of networks; the rejects include those of the sources."""
    parts = recipe.parts
    groups = source_groups(recipe, parts, sources.scan)
    takes, unusable = takes_of(cache, recipe.dataset, sources, jobs=jobs, progress=progress)
    computed = [field for field in parts.fields if networks or not field.lane]
    clips, rejects, quality = build_clips(cache, takes, parts, groups, computed, jobs=jobs, progress=progress)
    return BuiltClips(clips, [*sources.rejects, *unusable, *rejects], quality)


def source_groups(recipe: Recipe, parts: Parts, scan: Scan) -> Groups:
    """Return the groups of a source; UsageError if a part of the recipe cannot be of groups."""
    groups = groups_of(scan.clips, recipe.incomplete_groups == "keep")
    reasons = {f"the transform {step.name}": step.not_for_groups for step in parts.transforms}
    reasons |= {f"the field {field.name}": field.not_for_groups(parts.fields) for field in parts.fields}
    for part, reason in reasons.items():
        if groups.sizes and reason:
            raise UsageError(f"groups cannot have {part}: {reason}",
                             found=f"groups in the source of {recipe.dataset.name}",
                             fix=f"leave out {part}, or choose another one")  # fmt: skip
    return groups


def with_found_starts(cache: Cache, dataset: Dataset, scan: Scan, *, jobs: Jobs, progress: Progress) -> Scan:
    """Return a scan with the offsets that its source leaves to the build; clips of unknown ones are rejects."""
    asked = [clip for clip in scan.clips if clip.audio_start_by == FOUND]
    return STARTS.only().find(cache, dataset, scan, asked, jobs=jobs, progress=progress) if asked else scan


def annotate_clips(
    cache: Cache,
    dataset: Dataset,
    scan: Scan,
    annotator: Annotator,
    steps: Sequence[Transform] = (),
    *,
    jobs: Jobs,
    progress: Progress,
) -> tuple[dict[str, Sequence[Any]], list[Reject]]:
    """Return an annotator's JSON rows of the clips of a scan, each dancer alone, after steps; and the rejects."""
    alone = replace(scan, clips=tuple(replace(ref, group="") for ref in scan.clips))  # each where his file has him
    sources = identify(cache, dataset, (), alone, jobs=jobs, progress=progress)
    takes, unusable = takes_of(cache, dataset, sources, jobs=jobs, progress=progress)
    results = [Result(replace(take, steps=tuple(steps)), (0,), (0,)) for take in takes]
    results = compute(cache, results, [annotator], jobs=jobs, progress=progress)
    rejects = [*sources.rejects, *unusable, *(reject for result in results for reject in result.rejects)]
    return {result.take.name: result.made[annotator.id][0] for result in results if result.stay}, rejects
