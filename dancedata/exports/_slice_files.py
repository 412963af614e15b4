"""Exports of slices in EDGE's folders, which POPDG and other descendants of EDGE read too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from shlex import quote
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.motion import Motion
from dancedata.core.text import counted
from dancedata.core.typing import override
from dancedata.exports import _slices as slices
from dancedata.exports.base.folder import ExportFolder
from dancedata.exports.base.job import Export, ExportJob

FOLDERS = ("motions_sliced", "wavs_sliced", "jukebox_feats")
Sound = Literal["cut", "silence"]


@dataclass(frozen=True)
class SliceExport(Export):
    """Base of exports of EDGE's folders.

    Attributes
    ----------
    feature
        Audio feature to write, of 35 or 4800 columns.
    sound
        ``cut``: wavs cut from the music of --source. ``silence``: silent wavs, without a source; training does not
        use them, only rendering does.
    guide_text
        Markdown of `guide`, with places for out, kind, feature, width and again.
    """

    recipe: ClassVar[Mapping[str, Any]] = {"motion": {"edge151": {}}, "audio": {"librosa35": {}}}
    listed_folders: ClassVar[tuple[str, ...]] = tuple(
        f"{part}/{name}" for part in ("train", "test") for name in FOLDERS
    )
    guide_text: ClassVar[str]

    feature: str = "librosa35"
    sound: Sound = "cut"

    @override
    def guide(self, job: ExportJob) -> str:
        width = job.store.fields[self.feature].width
        kind = slices.WIDTHS[width]
        again = ", and once more in `baseline_feats`" if kind == "baseline" else ""
        return self.guide_text.format(
            out=quote(str(job.out)), kind=kind, feature=self.feature, width=width, again=again
        )


@dataclass(frozen=True)
class SliceWriter:
    """Writes the slices of a dataset.

    Attributes
    ----------
    feature
        Audio feature.
    sound
        "cut": from the music; "silence".
    repeat
        How often each frame lies in a pickle: 2 where the loader keeps every second one.
    batch
        Batch size of the trainer, whose loaders drop the last, smaller batch.
    """

    job: ExportJob
    folder: ExportFolder
    feature: str
    sound: Sound
    repeat: int
    batch: int

    def write(
        self, part: str, splits: Sequence[str]
    ) -> tuple[list[slices.Slice], dict[str, npt.NDArray[np.float32]]]:
        """Write the folders of a part, "train" or "test"; returns its slices and their motion at 30 per second."""
        found = [item for split in splits for item in slices.slices_of(self.job, split, self.feature)]
        found.sort(key=lambda item: slices.sort_key(item.name))
        slices.note_rejects(self.job, splits, self.folder)
        if self.sound == "cut":
            found = slices.with_whole_sound(self.job, found, self.folder)
        for name in FOLDERS:
            self.folder.make_folder(f"{part}/{name}")
        if len(found) < self.batch:
            self.folder.note(
                f"{part} has {counted(len(found), 'window')}, fewer than the trainer's batch of {self.batch}, and "
                "its loaders drop smaller batches: pass a smaller --batch_size"
            )
        motion = self._write_motion(part, found)
        self._write_features(part, found)
        self._write_sounds(part, found)
        return found, motion

    def _write_motion(self, part: str, found: list[slices.Slice]) -> dict[str, npt.NDArray[np.float32]]:
        whole = {
            "pos": np.empty((len(found), slices.LENGTH, 3), np.float32),
            "q": np.empty((len(found), slices.LENGTH, 72), np.float32),
        }
        for number, item in enumerate(self.job.each(f"{part}: motion", found)):
            for key, array in pos_and_q(slices.slice_motion(self.job, item)).items():
                whole[key][number] = array
            repeated = {key: np.repeat(array[number], self.repeat, axis=0) for key, array in whole.items()}
            self.folder.write_pickle(f"{part}/motions_sliced/{item.name}.pkl", repeated)
        return whole

    def _write_features(self, part: str, found: list[slices.Slice]) -> None:
        names = ["jukebox_feats"]
        if slices.WIDTHS[self.job.store.fields[self.feature].width] == "baseline":
            names.append("baseline_feats")
        for item in self.job.each(f"{part}: {self.feature}", found):
            rows = self.job.store.read(item.window, self.feature).astype(np.float32)
            for name in names:
                self.folder.write_npy(f"{part}/{name}/{item.name}.npy", rows)

    def _write_sounds(self, part: str, found: list[slices.Slice]) -> None:
        if self.sound == "silence":
            self.folder.note("the wavs are silent: training does not use them, rendered videos have no music")
            silent = slices.silence()
            for item in found:
                self.folder.write_bytes(f"{part}/wavs_sliced/{item.name}.wav", silent)
            return
        for item, sound in slices.cut_sounds(self.job, found):
            self.folder.write_bytes(f"{part}/wavs_sliced/{item.name}.wav", sound)


def pos_and_q(motion: Motion) -> Mapping[str, npt.NDArray[Any]]:
    """Return a motion as EDGE's pickles hold it: ``pos`` (T, 3) metres, ``q`` (T, 72) axis-angle, +Y up, float32."""
    return {
        "pos": motion.translation.astype(np.float32),
        "q": motion.rotations.reshape(motion.n_frames, -1).astype(np.float32),
    }
