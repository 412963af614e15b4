"""Duolando's folders: joints and rotation matrices of follower and leader, and 54 columns of their music."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from dancedata.core.bodies import SMPLX52, SMPLX55, transfer_to
from dancedata.core.rotations import matrix_from_rotvec
from dancedata.core.text import counted
from dancedata.core.typing import override
from dancedata.exports._motions import MotionExport, decoded, field_name, needs_motion
from dancedata.exports.base.job import EXPORTS, ExportJob, Missing
from dancedata.exports.base.needs import needs_field, needs_fps, needs_music_from_start, needs_names, needs_splits
from dancedata.files.atomic_folder import AtomicFolder
from dancedata.formats.motion_files import smplx_arrays

if TYPE_CHECKING:
    from dancedata.kernel import Clip

_FPS, _WIDTH = 30, 54
_PARTS = ("train", "test")
_ROLES = ("follower", "leader")
_KINDS = ("motion/pos3d", "motion/rotmat", "music/feature")
_GUIDE = """Duolando reads this folder as `./data`, as its configurations say. In a checkout, without its own `data`:

```sh
ln -s {out} data
python -u main_mix.py --config configs/sep_vqvaexm_full_final.yaml --train
```

- `motion/pos3d/SPLIT/PAIR_00.npy` (T, 165) are the joints of the follower, `PAIR_01.npy` of the leader: SMPL-X's 55
  in metres, +Z up, both dancers in one world. `motion/rotmat` (T, 498) has translation and 55 rotation matrices.
- They are decoded from `{source}`, on the neutral body: Duolando's script takes betas and gender of each file, which
  datasets do not hold. Jaw and eyes do not turn.
- `music/feature/SPLIT/PAIR.npy` (T, 54) is `{feature}`, which is computed without essentia's resampler; at 15,360 Hz
  both have the same samples.
- Both dancers have the frames of the shorter one, to which the loader cuts them. It leaves out windows without music,
  but not with `interval: None`: there the music may end before the motion.
- `utils/metrics.py` and `utils/metrics_duet.py` compare with a folder `all`, which is not here, as it would hold the
  other splits once more. They split names at `_`: GENRE_CHOREO_TAKE.
"""


@EXPORTS.register("duolando")
@dataclass(frozen=True)
class Duolando(MotionExport):
    """Duolando's folders motion/pos3d, motion/rotmat and music/feature from a dataset of duets (Siyao et al. 2024).

    Attributes
    ----------
    feature
        Audio feature of 54 columns at 30 rows per second.
    """

    recipe: ClassVar[Mapping[str, Any]] = {
        "dataset": {"dd100": {}},
        "motion": {"finedance319": {}},
        "audio": {"bailando54": {}},
    }
    reference: ClassVar[str] = "lisiyao21/Duolando, commit abb93e6, datasets/dd100lf_all2.py"
    guide_text: ClassVar[str] = _GUIDE
    listed_folders: ClassVar[tuple[str, ...]] = tuple(f"{kind}/{part}" for kind in _KINDS for part in _PARTS)

    feature: str = "bailando54"

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        missing = needs_fps(job, _FPS) + needs_motion(job, self.field) + needs_splits(job, *_PARTS)
        missing += needs_field(job, self.feature, kind="audio", width=_WIDTH, rate=_FPS)
        dancers = [clip for duet in _duets(job) for clip in duet]
        if not dancers:
            missing.append(Missing("the dataset has no duets", "dataset: {dd100: {}}, or another with groups of two"))
        form = "without pos3d, which the loader replaces by rotmat"
        return missing + needs_music_from_start(dancers) + needs_names(dancers, lambda id: "pos3d" not in id, form)

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        for name in self.listed_folders:
            folder.make_folder(name)
        duets = _duets(job)
        for duet in duets:
            clip = duet[0]  # clips of a group have the same frames and music
            rows = clip.read(self.feature).astype(np.float32)
            folder.write_npy(f"music/feature/{clip.split}/{clip.group}.npy", rows)
        dancers = [clip for duet in duets for clip in duet]
        for number, (clip, motion) in enumerate(decoded(job, self.field, dancers)):
            y_up, arrays = transfer_to(motion, SMPLX55).joints(), smplx_arrays(motion)
            joints = np.stack([y_up[..., 0], -y_up[..., 2], y_up[..., 1]], axis=-1)
            matrices = matrix_from_rotvec(arrays["poses"].reshape(len(joints), -1, 3))
            rotmat = np.concatenate([arrays["trans"], matrices.reshape(len(joints), -1)], axis=1)
            for kind, columns in (("pos3d", joints.reshape(len(joints), -1)), ("rotmat", rotmat)):
                name = f"motion/{kind}/{clip.split}/{clip.group}_0{number % 2}.npy"
                folder.write_npy(name, columns.astype(np.float32))
            if not set(SMPLX52.joints) <= set(motion.skeleton.joints):
                folder.note("the motion field has no fingers: hands are at rest")
            if clip.role not in _ROLES:
                folder.note("the dataset has no followers: the first member of each pair is the follower")
        others = len(job.clips()) - len(dancers)
        if others:
            folder.note(f"{counted(others, 'dancer')} outside pairs are not in the export: Duolando reads duets")

    @override
    def guide_values(self, job: ExportJob) -> Mapping[str, object]:
        return {"source": field_name(job, self.field)}


def _duets(job: ExportJob) -> "list[list[Clip]]":
    """Return the groups of two by name, the follower before the leader."""
    pairs = (group for group in job.groups().values() if len(group) == 2)
    return [sorted(pair, key=lambda clip: clip.role == "leader") for pair in pairs]
