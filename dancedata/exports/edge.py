"""EDGE: sliced folders for its loader, and the loader's own cache."""

from dataclasses import dataclass
from typing import ClassVar

from dancedata.core.text import counted
from dancedata.core.typing import override
from dancedata.exports._slices import SliceExport, SliceWriter, needs_slices
from dancedata.exports.base.job import EXPORTS, ExportJob, Missing
from dancedata.files.atomic_folder import AtomicFolder

_BATCH = 64
_GUIDE = """## Train

In a checkout of EDGE, with its requirements installed:

```sh
accelerate launch train.py --data_path {out}/ --processed_data_dir NEW_FOLDER/ --feature_type {kind}
```

- `NEW_FOLDER` has to be new. The loader takes `processed_train_data.pkl` and `processed_test_data.pkl` from it, and
  train.py `train_tensor_dataset.pkl` and `test_tensor_dataset.pkl`, before they look at the data. After another
  export remove these four, or pass `--force_reload --no_cache`.
- train.py does not pass `--feature_type` on to its dataset: it reads `jukebox_feats` whatever the flag says, which
  only sizes the model. So `{feature}` ({width} columns) lies in `jukebox_feats`{again}.
- `cache/` is the loader's cache of the same windows at 30 frames per second: copy it, and give the copy as
  `--processed_data_dir`, to start without reading the pickles one by one. It holds absolute paths below
  `{out}`: export again after moving the folder.
- The first render, in epoch 100, dies where there are fewer test windows than `--batch_size` (64 by default).
- The loader sorts windows as text, slice10 before slice2, and keeps every second of the 300 frames of a pickle, so
  each frame at 30 per second lies there twice.
"""


@EXPORTS.register("edge")
@dataclass(frozen=True)
class Edge(SliceExport):
    """EDGE's folders motions_sliced, wavs_sliced, jukebox_feats, baseline_feats, and its cache (Tseng et al. 2023).

    Attributes
    ----------
    val_as_test
        Write the split val to the test folder too: EDGE has no validation split.
    """

    reference: ClassVar[str] = "Stanford-TML/EDGE, commit 17c3428, dataset/dance_dataset.py"
    guide_text: ClassVar[str] = _GUIDE

    val_as_test: bool = False

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        splits = [split for part in self._splits.values() for split in part]
        return needs_slices(job, self.feature, splits, sound=self.sound == "cut")

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        if "val" in job.store.splits and not self.val_as_test:
            n = counted(len(job.clips("val")), "clip")
            folder.note(f"the split val ({n}) is not exported: --set val_as_test=true adds it to test")
        if job.store.slice_length is None:
            folder.note(
                "the music was computed over whole songs, where EDGE's scripts take five seconds at a time: for "
                "their numbers build the recipe aist++-edge-exact"
            )
        writer = SliceWriter(job, folder, self.feature, self.sound, repeat=2, batch=_BATCH)
        for part, splits in self._splits.items():
            slices, motion = writer.write(part, splits)
            paths = {
                "filenames": [str(folder.final / part / "jukebox_feats" / f"{item.name}.npy") for item in slices],
                "wavs": [str(folder.final / part / "wavs_sliced" / f"{item.name}.wav") for item in slices],
            }
            folder.write_pickle(f"cache/processed_{part}_data.pkl", {**motion, **paths})

    @property
    def _splits(self) -> dict[str, tuple[str, ...]]:
        return {"train": ("train",), "test": ("test", "val") if self.val_as_test else ("test",)}
