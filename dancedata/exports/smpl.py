"""AMASS-like and SMPL-X files, one per clip, for Blender's SMPL add-ons and tools that read AMASS."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from dancedata.core.typing import override
from dancedata.exports._motions import MotionExport, decoded, field_name
from dancedata.exports.base.job import EXPORTS, ExportJob
from dancedata.files.atomic_folder import AtomicFolder
from dancedata.formats.motion_files import amass_arrays, smplx_arrays

_GUIDE = """Decoded from `{name}`, {rate} frames per second. Both folders have every clip:

| folder | arrays |
|---|---|
| `amass` | poses (T, 156) on SMPL-H, trans, betas, gender, mocap_framerate |
| `smplx` | poses (T, 165), its parts (root_orient, pose_body, ...), trans, betas, gender, mocap_frame_rate |

+Z up as in AMASS, metres, axis-angle. betas are 0, the mean body, as datasets hold no shapes. The pelvis is where it
was; `trans` differs between the folders by the bodies' own rest positions. SMPL's two hand joints are left out:
SMPL-H and SMPL-X have fingers in their place, which stay at rest if the dataset has none.

In Blender: the SMPL-X add-on, Add Animation, with the files of `smplx` (format AMASS); the SMPL add-on with those of
`amass`. dancedata reads both as its dataset `folder`.
"""


@EXPORTS.register("smpl")
@dataclass(frozen=True)
class SmplFiles(MotionExport):
    """amass/<clip>.npz on SMPL-H's joints and smplx/<clip>.npz on SMPL-X's, +Z up, metres.

    Attributes
    ----------
    gender
        Written into the files: the body model that a viewer takes. AIST++ was fitted with the male one.
    """

    reference: ClassVar[str] = "AMASS's and SMPL-X's .npz (amass.is.tue.mpg.de)"

    gender: Literal["neutral", "male", "female"] = "neutral"

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        for clip, motion in decoded(job, self.field):
            folder.write_npz(f"amass/{clip.id}.npz", amass_arrays(motion, self.gender))
            folder.write_npz(f"smplx/{clip.id}.npz", smplx_arrays(motion, self.gender))

    @override
    def guide(self, job: ExportJob) -> str:
        name = field_name(job, self.field)
        return _GUIDE.format(name=name, rate=job.store.field(name).rate)
