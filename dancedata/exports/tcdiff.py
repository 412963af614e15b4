"""TCDiff's folders: five-second slices of groups, their sound and 438 columns of each slice."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from dancedata.core.audio_signal import AudioSignal, pcm16
from dancedata.core.clip import Window, slice_name
from dancedata.core.grid import FrameGrid, WindowGrid
from dancedata.core.registry import FEATURES
from dancedata.core.text import counted
from dancedata.core.typing import override
from dancedata.exports._motions import MotionExport, groups_decoded, needs_motion, on_smpl
from dancedata.exports._slices import FPS, LENGTH, STRIDE, Slice, cut_sounds, quantised_wav, with_whole_sound
from dancedata.exports.base.job import EXPORTS, ExportJob, Missing
from dancedata.exports.base.needs import needs_field, needs_fps, needs_music, needs_splits
from dancedata.files.atomic_folder import AtomicFolder

if TYPE_CHECKING:
    from dancedata.core.motion import Motion

#: TCDiff trains on the official train list, and calls the val list test.
_PARTS = {"train": "train", "test": "val"}
_FEATURE, _RATE, _WIDTH = "bailando438", 60, 438
_FOLDERS = ("motions_sliced", "wavs_sliced", "feats438")
_GUIDE = """TCDiff reads this folder as the `data_path` of its `AIOZDataset`:

```python
names = open("{out}/split_dancerNum_3.txt").read().split()
AIOZDataset("{out}", "NEW_FOLDER", train=True, required_dancer_num=3, split_file=names)
```

- `train` has the train split, `test` the val split: TCDiff reports on AIOZ-GDANCE's val list.
- `motions_sliced/GROUP_sliceK.pkl`: pos (P, 150, 3) and q (P, 150, 72), +Y up, which the loader turns to +Z up;
  windows of 5 s each 0.5 s, as many as motion and music allow. `wavs_sliced` is their sound.
- `feats438/GROUP_sliceK.npy`: {features}
- `split_dancerNum_N.txt` lists the groups of N dancers of both parts; the loader takes those of one N at a time.
- The loader fits its scaler on each train window by itself, and keeps the last one's for test (its own behaviour).
  Its cache in NEW_FOLDER wins over the data.
"""
_OF_SLICE = "301 rows of 438 columns, computed from the sound of each slice by itself, as TCDiff's scripts do."
_STORED = "300 rows of `{feature}`, of the whole song. TCDiff computes each slice by itself, which has 301."


@EXPORTS.register("tcdiff")
@dataclass(frozen=True)
class Tcdiff(MotionExport):
    """TCDiff's folders motions_sliced, wavs_sliced and feats438 from a dataset of groups (Dai et al. 2025).

    Attributes
    ----------
    feature
        Audio feature of 438 columns at 60 rows per second to take from the dataset; "" computes them from the sound
        of each slice, as TCDiff does.
    """

    recipe: ClassVar[Mapping[str, Any]] = {
        "dataset": {"aioz-gdance": {}},
        "motion": {"edge151": {}},
        "audio": {"librosa35": {}},
    }
    reference: ClassVar[str] = "Da1yuqin/TCDiff, commit 9afee32, dataset/group_dataset.py"
    guide_text: ClassVar[str] = _GUIDE
    listed_folders: ClassVar[tuple[str, ...]] = tuple(f"{part}/{name}" for part in _PARTS for name in _FOLDERS)

    feature: str = ""

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        missing = needs_fps(job, FPS) + needs_motion(job, self.field) + needs_splits(job, *_PARTS.values())
        if self.feature:
            missing += needs_field(job, self.feature, kind="audio", width=_WIDTH, rate=_RATE)
        for part, split in _PARTS.items() if not missing else ():
            if not _slices(job, split):
                fix = "dataset: {aioz-gdance: {}}, or another with groups in train and val"
                missing.append(Missing(f"{split}, of which {part} is made, has no group of five seconds", fix))
        return missing + needs_music(job, [clip for clip in job.clips(*_PARTS.values()) if clip.group])

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        sizes: dict[int, list[str]] = {n: [] for n in range(2, 8)}
        for part, split in _PARTS.items():
            for name in _FOLDERS:
                folder.make_folder(f"{part}/{name}")
            slices = with_whole_sound(job, _slices(job, split), folder)
            slices = self._with_rows(job, slices, folder) if self.feature else slices
            self._write_sounds(job, folder, part, slices)
            by_group = {name: list(of_group) for name, of_group in groupby(slices, key=lambda s: s.clip.group)}
            groups = {name: clips for name, clips in job.groups(split).items() if name in by_group}
            for group, dancers in groups_decoded(job, self.field, groups):
                sizes.setdefault(len(dancers), []).append(group)
                _write_motion(folder, part, by_group[group], [on_smpl(motion) for _, motion in dancers])
        for size, names in sorted(sizes.items()):
            folder.write_text(f"split_dancerNum_{size}.txt", "".join(f"{name}\n" for name in sorted(names)))
        singles = sum(not clip.group for clip in job.clips(*_PARTS.values()))
        if singles:
            folder.note(f"{counted(singles, 'single dancer')} are not in the export: TCDiff reads groups")

    def _with_rows(self, job: ExportJob, slices: list[Slice], folder: AtomicFolder) -> list[Slice]:
        ends = {clip: job.store._starts(clip, LENGTH, fields=(self.feature,)) for clip in {s.clip.id for s in slices}}
        whole = [s for s in slices if s.window.start in ends[s.clip.id]]
        if len(whole) < len(slices):
            lacking = counted(len(slices) - len(whole), "window")
            folder.note(f"{lacking} left out, which {self.feature} does not cover")
        return whole

    def _write_sounds(self, job: ExportJob, folder: AtomicFolder, part: str, slices: list[Slice]) -> None:
        feature = FEATURES.make(_FEATURE, {"onset_fmax": "nyquist"})  # as in today's librosa, which TCDiff calls
        for item, sound in cut_sounds(job, slices):
            folder.write_bytes(f"{part}/wavs_sliced/{item.name}.wav", quantised_wav(sound))
            if self.feature:
                rows = job.store.read(item.window, self.feature)
            else:  # of the wav, which has 16 bits
                rows = feature.extract(AudioSignal(pcm16(sound.samples), sound.sample_rate), FrameGrid.of(_RATE))
            folder.write_npy(f"{part}/feats438/{item.name}.npy", rows.astype(np.float32))

    @override
    def guide_values(self, job: ExportJob) -> Mapping[str, object]:
        return {"features": _STORED.format(feature=self.feature) if self.feature else _OF_SLICE}


def _slices(job: ExportJob, split: str) -> list[Slice]:
    """Return the windows of the groups of a split, each with the group's first dancer, in the loader's order."""
    grid = WindowGrid(LENGTH, STRIDE)
    return [
        Slice(slice_name(group, k), clip, Window(clip.id, grid.start(k), LENGTH))
        for group, (clip, *_) in job.groups(split).items()
        for k in range(grid.count(clip.n_frames))
    ]


def _write_motion(folder: AtomicFolder, part: str, slices: list[Slice], motions: "list[Motion]") -> None:
    pos = np.stack([motion.translation for motion in motions]).astype(np.float32)
    q = np.stack([motion.rotations.reshape(motion.n_frames, -1) for motion in motions]).astype(np.float32)
    for item in slices:
        rows = slice(item.window.start, item.window.start + LENGTH)
        folder.write_pickle(f"{part}/motions_sliced/{item.name}.pkl", {"pos": pos[:, rows], "q": q[:, rows]})
