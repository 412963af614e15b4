"""FineDance's own trainer (FineNet): whole tracks of 319 columns."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dancedata.core.typing import override
from dancedata.exports._finedance import needs_tracks, note_missing
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing
from dancedata.files.atomic_folder import AtomicFolder

_MOTION, _FPS = "finedance319", 30
_GUIDE = """## Train

The loader reads `./data/finedance` below the working folder. In a checkout of FineDance:

```sh
mkdir -p data && ln -s {out}/finedance data/finedance
python train_seq.py
```

- vis.py, line 484, opens the rest joints of SMPL-X at an absolute path of its authors. The file `smplx_neu_J_1.npy`
  lies in the repository; link it to that place.
- Tracks are whole and not grounded. Lodge's `music_npynew` is cut, `music_npy` is not: do not exchange them.
- The loader subtracts the root of a window's first frame in a view of its array, so that overlapping windows of one
  batch change each other. Compare one window at a time.
"""


@EXPORTS.register("finedance")
@dataclass(frozen=True)
class FineDance(Export):
    """FineDance's motion_fea319 and music_npy, as its own trainer reads them (Li et al. 2023).

    Attributes
    ----------
    feature
        Audio feature of 35 columns.
    """

    recipe: ClassVar[Mapping[str, Any]] = {
        "dataset": {"finedance": {}},
        "motion": {_MOTION: {}},
        "audio": {"librosa35": {}},
    }
    reference: ClassVar[str] = "li-ronghui/FineDance, commit bb13fe8, dataset/FineDance_dataset.py"
    guide_text: ClassVar[str] = _GUIDE

    feature: str = "librosa35"

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        return needs_tracks(job, _MOTION, self.feature)

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        for clip in job.each("tracks", job.clips()):
            folder.write_npy(f"finedance/motion_fea319/{clip.id}.npy", clip.read(_MOTION))
            folder.write_npy(f"finedance/music_npy/{clip.id}.npy", clip.read(self.feature).astype(np.float32))
        note_missing(job, folder, "FineDance's loader", "ignored", "ignored.finenet")
