"""HumanML3D's folders: vectors, joints, mean and deviation, lists of splits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing
from dancedata.exports.base.needs import needs_field, needs_train
from dancedata.formats.humanml_texts import Caption, plain_tokens, texts_file

if TYPE_CHECKING:
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip

Floats = npt.NDArray[np.float32]

FIELD = "humanml263"
#: Borders of the columns whose deviations are averaged: turn, velocity and height of the root, positions, rotations,
#: velocities, contacts.
_GROUPS = (0, 1, 3, 4, 67, 193, 259, 263)
_LISTS = ("train", "val", "test")


@EXPORTS.register("humanml3d")
@dataclass(frozen=True)
class HumanML3D(Export):
    """HumanML3D's new_joint_vecs, new_joints, texts, Mean.npy, Std.npy and lists of splits (Guo et al. 2022).

    Attributes
    ----------
    scaler
        ``all``: mean and deviation over all splits, test included, as in HumanML3D. ``train``: over train.
    layer
        Layer of the segments whose texts are the captions of ``texts/``.
    tokens
        ``stored``: ``word/POS`` as the source states them. ``plain``: ``word/OTHER`` where there are none.
    """

    recipe: ClassVar[Mapping[str, Any]] = {"motion": {"humanml263": {}}}
    reference: ClassVar[str] = (
        "EricGuo5513/HumanML3D, commit 9176e8f, motion_representation.ipynb and cal_mean_variance.ipynb"
    )
    listed_folders: ClassVar[tuple[str, ...]] = ("new_joint_vecs", "new_joints")

    scaler: Literal["all", "train"] = "all"
    layer: str = "description"
    tokens: Literal["stored", "plain"] = "stored"

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        missing = needs_field(job, FIELD, kind="motion", width=263, rate=20)
        missing += needs_train(job, self.scaler, "mean and deviation") + self._untagged(job)
        return missing or _short(job)

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        representation: Any = REPRESENTATIONS.get(FIELD)()
        for clip in job.each("clips", job.clips()):
            rows = vectors(clip)
            folder.write_npy(f"new_joint_vecs/{clip.id}.npy", rows)
            folder.write_npy(f"new_joints/{clip.id}.npy", representation.positions(rows).astype(np.float32))
        splits = job.store.splits if self.scaler == "all" else ("train",)
        mean, std = _mean_and_std(lambda: map(vectors, job.clips(*splits)))
        folder.write_npy("Mean.npy", mean)
        folder.write_npy("Std.npy", std)
        if not std.all():
            folder.note("Std.npy has zeros: columns that do not change in these clips; a loader divides by them")
        for split in (*_LISTS, *(s for s in job.store.splits if s not in _LISTS)):
            names = [clip.id for clip in job.clips(split)] if split in job.store.splits else []
            folder.write_text(f"{split}.txt", "".join(f"{name}\n" for name in names))
            if not names:
                folder.note(f"{split}.txt is empty: the dataset has no clips in {split}")
        self._write_texts(job, folder)
        folder.write_text("all.txt", "".join(f"{clip.id}\n" for clip in job.clips()))

    def _captions(self, job: ExportJob, clip: Clip) -> list[Caption]:
        """Return text, tokens and seconds of the captions of a clip; 0 to 0 for the whole clip."""
        if self.layer not in {layer.name for layer in job.store.layers}:
            return []
        captions = []
        for segment in job.store.segments(clip.id, self.layer):
            is_whole = segment.frames(job.store.grid, clip.n_frames) == (0, clip.n_frames)
            start, end = (Fraction(0), Fraction(0)) if is_whole else (max(segment.start, Fraction(0)), segment.end)
            tokens = segment.tokens or ("",) * len(segment.texts)
            captions += [Caption(t, k, start, end) for t, k in zip(segment.texts, tokens, strict=True)]
        return captions

    def _untagged(self, job: ExportJob) -> list[Missing]:
        untagged = [c.id for c in job.clips() if any(not caption.tokens for caption in self._captions(job, c))]
        if self.tokens == "plain" or not untagged:
            return []
        problem = f"captions without tokens (word/POS), which the loaders read: {listed(untagged)}"
        return [Missing(problem, "--set tokens=plain, which writes word/OTHER")]

    def _write_texts(self, job: ExportJob, folder: AtomicFolder) -> None:
        silent = []
        for clip in job.clips():
            captions = self._captions(job, clip)
            if captions:
                lines = [c if c.tokens else c._replace(tokens=plain_tokens(c.text)) for c in captions]
                folder.write_text(f"texts/{clip.id}.txt", texts_file(lines))
            else:
                silent.append(clip.id)
        if silent and len(silent) < len(job.clips()):
            folder.note(f"no captions for {counted(len(silent), 'clip')}, which a loader drops: {listed(silent)}")

    def _texts(self, job: ExportJob) -> str:
        if any(self._captions(job, clip) for clip in job.clips()):
            return (
                f"`texts/<id>.txt` has the captions of the layer `{self.layer}`: `caption#word/POS ...#start#end`, "
                "seconds, 0.0 to 0.0 for the whole clip."
            )
        return (
            "Text-to-motion loaders need `texts/<id>.txt` as well. This dataset has no captions, so there are none. "
            "Without them such a loader drops every clip. Loaders of motion alone do not need them."
        )

    @override
    def guide(self, job: ExportJob) -> str:
        over = "all splits, test included, as HumanML3D's are" if self.scaler == "all" else "train alone"
        return (
            "Put the folder, or a link to it, where the trainer looks for `HumanML3D/`: T2M, MDM and MLD read "
            "`new_joint_vecs`, `Mean.npy`, `Std.npy` and the lists; `new_joints` are positions, for plots.\n\n"
            "- 20 rows per second; a clip of T frames has T - 1 rows.\n"
            f"- Mean and deviation are over {over}; the deviation is averaged within root turn, root velocity, root "
            "height, positions, rotations, velocities and contacts, as in cal_mean_variance.ipynb.\n"
            f"- {self._texts(job)}\n- Remove caches of earlier data, and an evaluator's own mean and deviation "
            "(`checkpoints/*/meta/{mean,std}.npy` in T2M) where it was trained on HumanML3D itself.\n"
        )


def _short(job: ExportJob) -> list[Missing]:
    short = [clip.id for clip in job.clips() if len(clip.read(FIELD)) < 2]
    if not short:
        return []
    return [Missing(f"clips of one row, which has no velocity: {listed(short)}", "leave them out of the source")]


def vectors(clip: Clip) -> Floats:
    """Return a clip's rows as HumanML3D has them, (T - 1, 263): the last of the stored ones has no velocity."""
    return np.asarray(clip.read(FIELD)[:-1], np.float32)


def _mean_and_std(parts: Callable[[], Iterable[Floats]]) -> tuple[Floats, Floats]:
    """Return mean and grouped deviation (263,) of arrays (T, 263), which `parts()` gives twice."""
    count, total = 0, np.zeros(263)
    for rows in parts():
        count, total = count + len(rows), total + rows.sum(axis=0, dtype=np.float64)
    mean = total / max(count, 1)
    squares = sum((((rows - mean) ** 2).sum(axis=0) for rows in parts()), np.zeros(263))
    std = np.sqrt(squares / max(count, 1))
    for first, last in pairwise(_GROUPS):
        std[first:last] = std[first:last].mean()
    return mean.astype(np.float32), std.astype(np.float32)
