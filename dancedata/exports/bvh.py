"""BVH files, one per clip, for Blender, Maya, MotionBuilder and other programs for animation."""

from dataclasses import dataclass
from typing import Literal

from dancedata.core.typing import override
from dancedata.exports._motions import MotionExport, decoded, field_name
from dancedata.exports.base.job import EXPORTS, ExportJob
from dancedata.files.atomic_folder import AtomicFolder
from dancedata.formats.bvh.write import motion_bvh


@EXPORTS.register("bvh")
@dataclass(frozen=True)
class BvhFiles(MotionExport):
    """One BVH file per clip, with the rest pose of the body; bvh_m/ in metres or bvh_cm/ in centimetres.

    Attributes
    ----------
    unit
        ``m``: metres, which Blender reads at a scale of 1. ``cm``: centimetres, as Maya and MotionBuilder expect.
    """

    unit: Literal["m", "cm"] = "m"

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        for clip, motion in decoded(job, self.field):
            folder.write_text(f"bvh_{self.unit}/{clip.id}.bvh", motion_bvh(motion, self.unit))

    @override
    def guide(self, job: ExportJob) -> str:
        name = field_name(job, self.field)
        scale = "1" if self.unit == "m" else "0.01"
        return (
            f"Decoded from `{name}`, {job.store.field(name).rate} frames per second, +Y up, "
            f"{'metres' if self.unit == 'm' else 'centimetres'}.\n\n"
            "In Blender: File, Import, Motion Capture (.bvh), Scale "
            f"{scale}, Forward -Z, Up Y, Update Scene FPS; or in its console:\n\n"
            "```python\nimport bpy\n\n"
            f'bpy.ops.import_anim.bvh(filepath="bvh_{self.unit}/{job.clips()[0].id}.bvh", global_scale={scale}, '
            'axis_forward="-Z", axis_up="Y", update_scene_fps=True)\n```\n\n'
            "The rest pose is that of the body: all angles 0. Joints without children end in a bone of half the "
            "length before it, which is no part of the motion.\n"
        )
