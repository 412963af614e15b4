"""AIOZ-GDANCE's files of groups, for GCD's own loader."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.exports._motions import MotionExport, groups_decoded, needs_motion, on_smpl
from dancedata.exports.base.job import EXPORTS, ExportJob, Missing
from dancedata.exports.base.needs import needs_field, needs_fps, needs_music_from_start
from dancedata.files.atomic_folder import AtomicFolder

_FPS = 30
_GUIDE = """GCD reads this folder as its `--data_path`:

```sh
python train.py --data_path {out}
```

- `motions_smpl/NAME.pkl` has all dancers of a group: smpl_poses (P, T, 72), root_trans (P, T, 3), +Y up, SMPL's
  translation; smpl_betas are 0, as datasets hold no shapes; meta has both keys that GCD needs.
- `jukebox_features/NAME.npy` are the rows of `{feature}`, at 30 per second from frame 0; GCD trains on Jukebox rows.
- NAME is VIDEO_SEGMENT_START_END with END - START frames: GCD filters and draws windows by the name. Groups of other
  datasets are named GROUP_00_0_FRAMES.
- `train_split_sequence_names.txt` and so on are the splits; `split_sequence_names.txt` has the names of all of them.
"""


@EXPORTS.register("gcd")
@dataclass(frozen=True)
class Gcd(MotionExport):
    """The layout of AIOZ-GDANCE from a dataset of groups, as GCD's loader reads it (Le et al. 2023).

    Attributes
    ----------
    feature
        Audio feature of `jukebox_features`, at 30 rows per second.
    """

    recipe: ClassVar[Mapping[str, Any]] = {
        "dataset": {"aioz-gdance": {}},
        "motion": {"edge151": {}},
        "audio": {"librosa35": {}},
    }
    reference: ClassVar[str] = "aioz-ai/GCD, commit b9524d8, data_loaders/gdance/gdance_dataset.py"
    guide_text: ClassVar[str] = _GUIDE

    feature: str = "librosa35"

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        missing = needs_fps(job, _FPS) + needs_motion(job, self.field)
        missing += needs_field(job, self.feature, kind="audio", rate=_FPS)
        missing += needs_music_from_start([clip for clip in job.clips() if clip.group])
        if not job.groups():
            missing.append(Missing("the dataset has no groups", "dataset: {aioz-gdance: {}}, or another with groups"))
        return missing

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        short: list[str] = []
        names: dict[str, list[str]] = {split: [] for split in job.store.splits}
        for group, members in groups_decoded(job, self.field, job.groups()):
            clip = members[0][0]
            # GCD draws windows by the length in the name, and takes as many rows of music.
            music = clip.read(self.feature)[: clip.n_frames].astype(np.float32)
            n = len(music)
            if n < clip.n_frames:
                short.append(group)
            name, start = sequence_name(group, n)
            dancers = [on_smpl(motion).part(0, n) for _, motion in members]
            folder.write_pickle(
                f"motions_smpl/{name}.pkl",
                {
                    "smpl_poses": np.stack([d.rotations.reshape(d.n_frames, 72) for d in dancers]).astype(np.float32),
                    "root_trans": np.stack([d.translation for d in dancers]).astype(np.float32),
                    "smpl_betas": np.zeros((len(dancers), 10), np.float32),
                    "meta": {"orig_start": start, "orig_end": start + n},
                },
            )
            folder.write_npy(f"jukebox_features/{name}.npy", music)
            names[clip.split].append(name)
        for split, of_split in names.items():
            folder.write_text(f"{split}_split_sequence_names.txt", "".join(f"{name}\n" for name in sorted(of_split)))
        all_names = sorted(name for of_split in names.values() for name in of_split)
        folder.write_text("split_sequence_names.txt", "".join(f"{name}\n" for name in all_names))
        if short:
            folder.note(f"{counted(len(short), 'group')} cut where the music ends: {listed(short)}")
        singles = sum(not clip.group for clip in job.clips())
        if singles:
            folder.note(f"{counted(singles, 'single dancer')} are not in the export: GCD reads groups")


def sequence_name(group: str, n_frames: int) -> tuple[str, int]:
    """Return a name of AIOZ-GDANCE, VIDEO_SEGMENT_START_END with so many frames, and START."""
    parts = group.rsplit("_", 3)
    if len(parts) == 4 and all(part.isdecimal() and part.isascii() for part in parts[1:]):
        start = int(parts[2])
        return f"{parts[0]}_{parts[1]}_{start}_{start + n_frames}", start
    return f"{group}_00_0_{n_frames}", 0
