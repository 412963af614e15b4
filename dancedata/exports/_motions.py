"""Clips of a dataset as motions again, for exports that write motion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from dancedata.exports.base.job import ExportJob, Lack
from dancedata.exports.base.needs import needs_field, needs_track_scope

if TYPE_CHECKING:
    from dancedata.core.motion import Motion
    from dancedata.store import ClipView
    from dancedata.store.motion_fields import ColumnsReader


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
    name = field_name(job, field)
    reader = _decodable(job)[name]
    for clip in job.each("clips", job.clips()):
        yield clip, reader.representation.decode(clip.read(name), reader.grid)


def field_name(job: ExportJob, field: str) -> str:
    """Return the name of the field that `decoded` reads."""
    return field or next(iter(_decodable(job)))


def _decodable(job: ExportJob) -> dict[str, ColumnsReader]:
    """Return the readers of fields that decode; last those that only give back positions."""
    from dancedata.store.motion_fields import motion_readers  # reads HDF5, which listing plug-ins need not

    readers = {name: r for name, r in motion_readers(job.store).items() if r.representation.decodes}
    return dict(sorted(readers.items(), key=lambda item: item[1].representation.positions_only))
