"""POPDG: EDGE's folders at 30 frames per second."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation
from dancedata.core.typing import override
from dancedata.exports._slices import SliceExport, SliceWriter, needs_slices
from dancedata.exports.base.job import EXPORTS, ExportJob, Missing
from dancedata.files.atomic_folder import AtomicFolder

_BATCH = 128
#: What the loader adds to positions, in our axes.
_ADDED = (0.0, 1.0, 5.0)
_GUIDE = """## Train

In a checkout of POPDG, with its requirements installed:

```sh
python train.py --data_path {out}/ --processed_data_dir NEW_FOLDER/ --feature_type {kind}
```

- The loader opens a file `high_quality_dataset` in the working folder. The repository has one, and the empty one of
  this export does as well: windows of every clip are read either way.
- `NEW_FOLDER` has to be new: `processed_{{train,test}}_data.pkl` and `{{train,test}}_tensor_dataset.pkl` in it win
  over the data. After another export remove them, or pass `--force_reload --no_cache`.
- train.py does not pass `--feature_type` on to its dataset: it reads `jukebox_feats` whatever the flag says, which
  only sizes the model. So `{feature}` ({width} columns) lies in `jukebox_feats`{again}.
- Its loaders drop batches smaller than `--batch_size` (128 by default), of test too.
- Motion is in a camera's axes, as in PopDanceSet: the loader turns it to +Z up and adds (0, -5, 1) m, which was
  subtracted here, so its columns are those of `edge151`.
"""


@EXPORTS.register("popdg")
@dataclass(frozen=True)
class Popdg(SliceExport):
    """POPDG's folders motions_sliced (30 frames per second), wavs_sliced and features (Luo et al. 2024).

    Motion is in the axes of a camera, +Y down, from which POPDG's loader turns it.
    """

    version: ClassVar[int] = 2
    reference: ClassVar[str] = "Luke-Luo1/POPDG, commit ec57d87, dataset/load_popdanceset.py"
    guide_text: ClassVar[str] = _GUIDE

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        return needs_slices(job, self.feature, ("train", "test"), sound=self.sound == "cut")

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        writer = SliceWriter(job, folder, self.feature, self.sound, repeat=1, batch=_BATCH, place=_to_camera)
        for part in ("train", "test"):
            writer.write(part, (part,))
            clips = dict.fromkeys(clip.slice_of or clip.id for clip in job.clips(part))
            folder.write_text(f"splits/{part}.txt", "".join(f"{clip}\n" for clip in clips))
        folder.write_text("high_quality_dataset", "")


def _to_camera(motion: Motion) -> Motion:
    """Return a motion, +Y up, as POPDG's loader takes it: half a turn about x, without the place that it adds."""
    rotations = motion.rotations.copy()
    rotations[:, 0] = (rotation(np.array([np.pi, 0.0, 0.0])) * rotation(rotations[:, 0])).as_rotvec()
    translation = (motion.translation - _ADDED) * (1.0, -1.0, -1.0)
    return replace(motion, translation=translation, rotations=rotations)
