"""Clips of a dataset as motions again, for exports that write motion."""

from __future__ import annotations

from collections.abc import Iterator

from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.exporting.job import ExportJob, Lack
from dancedata.exporting.needs import needs_field, needs_track_scope
from dancedata.recipes.plugins import split_instance
from dancedata.store import ClipView


def motion_lacks(job: ExportJob, field: str) -> list[Lack]:
    """Return what a dataset lacks for its clips to be decoded; `field` is "" for any field that can be."""
    lacks = needs_track_scope(job)
    if not field:
        return lacks if _decodable(job) else [*lacks, _no_motion(job)]
    missing = needs_field(job, field, kind="motion")
    if not missing and field not in _decodable(job):
        missing = [Lack(f"{field} holds positions, which do not determine rotations", _FIX)]
    return lacks + missing


_FIX = "motion: {edge151: {}}, or another representation that decodes"


def _no_motion(job: ExportJob) -> Lack:
    return Lack(f"the dataset has no field with rotations (it has {', '.join(job.store.fields)})", _FIX)


def decoded(job: ExportJob, field: str) -> Iterator[tuple[ClipView, Motion]]:
    """Yield clips and their motions, from `field`, or from the first field that decodes to the motion itself."""
    name = field or _decodable(job)[0]
    grid, plugin = FrameGrid(job.store.field(name).rate), _representation(name)()
    for clip in job.each("clips", job.clips()):
        yield clip, plugin.decode(clip.read(name), grid)


def field_name(job: ExportJob, field: str) -> str:
    """Return the name of the field that `decoded` reads."""
    return field or _decodable(job)[0]


def _decodable(job: ExportJob) -> list[str]:
    """Return the fields that decode; last those that only give back positions."""
    names = [name for name in job.store.fields if job.store.field(name).kind == "motion"]
    known = [name for name in names if split_instance(REPRESENTATIONS, name)[0] in REPRESENTATIONS.names()]
    return sorted((n for n in known if _representation(n).decodes), key=lambda n: _representation(n).fits)


def _representation(name: str) -> type[Representation]:
    return REPRESENTATIONS.get(split_instance(REPRESENTATIONS, name)[0])
