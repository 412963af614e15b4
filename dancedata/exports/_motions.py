"""Clips of a dataset as motions again, for exports that write motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from dancedata.core.bodies import transfer_to
from dancedata.core.skeleton import SMPL24
from dancedata.core.typing import override
from dancedata.exports.base.job import Export, ExportJob, Missing
from dancedata.exports.base.needs import needs_field

if TYPE_CHECKING:
    from dancedata.core.motion import Motion
    from dancedata.kernel import Clip
    from dancedata.scene.poses import ColumnsReader


_FIX = "motion: {edge151: {}}, or another representation that decodes"


def needs_motion(job: ExportJob, field: str) -> list[Missing]:
    """Check that clips can be decoded; `field` is "" for any field that can be."""
    if field:
        missing = needs_field(job, field, kind="motion")
        if not missing and field not in _decodable(job):
            missing = [Missing(f"{field} holds positions, which do not determine rotations", _FIX)]
        return missing
    if _decodable(job):
        return []
    return [Missing(f"the dataset has no field with rotations (it has {', '.join(job.store.fields)})", _FIX)]


def decoded(job: ExportJob, field: str, clips: Sequence[Clip] | None = None) -> Iterator[tuple[Clip, Motion]]:
    """Yield clips and their motions, from `field`, or from the first field that decodes to the motion itself."""
    name = field_name(job, field)
    reader = _decodable(job)[name]
    for clip in job.each("clips", job.clips() if clips is None else clips):
        yield clip, reader.representation.decode(clip.read(name), reader.grid)


def groups_decoded(
    job: ExportJob, field: str, groups: Mapping[str, Sequence[Clip]]
) -> Iterator[tuple[str, list[tuple[Clip, Motion]]]]:
    """Yield the name of each group, and its clips with their motions, as `decoded`."""
    motions = decoded(job, field, [clip for members in groups.values() for clip in members])
    for name, members in groups.items():
        yield name, [next(motions) for _ in members]


def on_smpl(motion: Motion) -> Motion:
    """Return a motion on SMPL's joints; one of them keeps its numbers, as in the file that it came from."""
    return motion if motion.skeleton.joints == SMPL24.joints else transfer_to(motion, SMPL24)


def field_name(job: ExportJob, field: str) -> str:
    """Return the name of the field that `decoded` reads."""
    return field or next(iter(_decodable(job)))


def _decodable(job: ExportJob) -> dict[str, ColumnsReader]:
    """Return the readers of fields that decode; last those that only give back positions, or that clips may lack."""
    from dancedata.scene.poses import motion_readers  # reads HDF5, which listing plug-ins need not

    readers = {name: r for name, r in motion_readers(job.store).items() if r.representation.decodes}
    optional = job.store.optional_fields
    return dict(
        sorted(readers.items(), key=lambda item: (item[1].representation.positions_only, item[0] in optional))
    )


@dataclass(frozen=True, kw_only=True)
class MotionExport(Export):
    """Base of exports of decoded motion.

    Attributes
    ----------
    field
        Motion field to decode; "" takes the first with rotations.
    """

    recipe: ClassVar[Mapping[str, Any]] = {"motion": {"edge151": {}}}

    field: str = ""

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        return needs_motion(job, self.field)

    @override
    def reads(self, job: ExportJob) -> tuple[str, ...]:
        """Return the field that `decoded` reads; () if the dataset lacks it."""
        decodable = _decodable(job)
        return (self.field,) if self.field in decodable else tuple(decodable)[:1] if not self.field else ()
