"""ClipDataset: the clips of a built dataset, whole or cropped at random, as a map-style torch dataset."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from dancedata.core.arguments import whole
from dancedata.core.clip import Reject, Window
from dancedata.core.errors import UsageError
from dancedata.core.sample_id import SampleId
from dancedata.core.sample_steps import Augment
from dancedata.core.typing import override
from dancedata.store.columns import MAX_ROWS
from dancedata.store.dataset import Store
from dancedata.store.window_cuts import whole_period
from dancedata.torch.batch_reader import BatchPlan, blank_of
from dancedata.torch.clip_collate import pad_clips
from dancedata.torch.draws import crop_choices, mirrored_samples
from dancedata.torch.music_beats import beat_labels
from dancedata.torch.options import Item, Scale, ScalerLike, Select, Windows, clash
from dancedata.torch.selection import no_window_error
from dancedata.torch.split_dataset import SplitDataset


class ClipDataset(SplitDataset):
    """Clips of one split, each a dict of tensors and metadata, as `WindowDataset` has them.

    A sample is a whole clip, all frames for which every field has whole rows; or, with a length in `windows`, a
    piece of that length from a random place, a new one in every epoch::

        clips = ClipDataset(out, fields=("edge151", "librosa35"))
        loader = DataLoader(clips, batch_size=8, collate_fn=pad_clips, sampler=EpochSampler(clips, seed=0))

        crops = ClipDataset(out, windows=Windows(length_s=5), crops=4)  # of one length: default_collate is enough

    Whole clips differ in length: `pad_clips` makes batches of them, and `BucketSampler` puts clips of
    similar length together.

    Attributes
    ----------
    windows
        (N) the frames that each sample is taken from: whole clips, `crops` times each.
    lengths
        (N,) frames of each sample.
    rejects
        The clips that were left out, and why: "ignored", "too_short" for a crop.

    Notes
    -----
    Random changes and scalers are those of `WindowDataset`.
    """

    #: For ``DataLoader(collate_fn=...)``.
    pad = staticmethod(pad_clips)

    def __init__(
        self,
        store: str | Path | Store,
        split: str | Sequence[str] = "train",
        fields: Sequence[Item] | None = None,
        *,
        windows: Windows | None = None,
        crops: int = 1,
        select: Select | None = None,
        scale: Scale | ScalerLike | None = Scale(),
        augment: Augment = (),
        seed: int = 0,
    ) -> None:
        """Open a split of a built dataset; parameters that are not named here are those of `WindowDataset`.

        Parameters
        ----------
        windows
            A length makes random crops of it. A stride is not used. Default: whole clips.
        crops
            Crops of each clip in an epoch.
        select
            Its filter is one of whole clips.
        augment
            As for a `WindowDataset`, except "crop".

        Raises
        ------
        StoreError, UsageError
            Without a finished dataset; for an unknown split or field, invalid numbers, values that do not go
            together, or if no clip is long enough.
        """
        super().__init__(store, split, fields, select, scale)
        self._items.require_plain("ClipDataset")
        cut = Windows.taken(windows)
        self.crop_frames, self.crops = self._crop(cut), whole("crops", crops, 1, MAX_ROWS)
        if cut.start_at is not None:
            raise clash(cut, "ClipDataset", "crops begin anywhere; windows of a WindowDataset begin on beats")
        if self.crop_frames is None and self.crops > 1:
            raise clash(cut, f"crops={self.crops}", "whole clips have no crops; give Windows(length_s=...)")
        chosen, least = self._choose(cut, {"whole": True}), self.crop_frames or 1
        details = {s.clip: f"{s.length} frames: a crop has {least}" for s in chosen.windows if s.length < least}
        self.rejects = (*chosen.rejects, *(Reject("too_short", clip, detail=d) for clip, d in details.items()))
        spans = chosen.windows.take(chosen.windows.length >= least)
        if not spans:
            raise no_window_error(self.store, self.split, self.rejects, None)
        self.windows = spans.take(np.repeat(np.arange(len(spans)), self.crops))
        self._prepare(augment, seed, allow_crop=False)
        self._is_random |= self.crop_frames is not None

    @property
    @override
    def lengths(self) -> npt.NDArray[np.int64]:
        """Frames of each sample, (N,), at the store's fps."""
        if self.crop_frames is None:
            return super().lengths
        return np.full(len(self), self.crop_frames, dtype=np.int64)

    def __getitem__(self, index: int | str | SampleId) -> dict[str, Any]:
        return self._read_again(index) if isinstance(index, str | SampleId) else self.samples([index])[0]

    @override
    def samples(self, indices: Sequence[int], epoch: int | None = None) -> list[dict[str, Any]]:
        epoch = self._drawn_epoch(epoch)
        places = [self._place(index) for index in indices]
        mirrored = mirrored_samples(self.seed, epoch, places, self.mirror)
        shifts = self._random_starts(epoch, places) - self.windows.start[places]
        plan = BatchPlan(tuple(places), tuple(mirrored.tolist()), tuple(shifts.tolist()), epoch)
        cuts = replace(self.windows, length=self.lengths)
        metadata = self._metadata(plan, cuts, () if self.crop_frames is None else ("crop",))
        return [
            {name: self._rows(plan, nth, name) for name in self.fields}
            | self._labels(plan, nth)
            | {name: values[nth] for name, values in metadata.items()}
            for nth in range(len(places))
        ]

    @override
    def _samples_text(self) -> str:
        kind = "whole clips" if self.crop_frames is None else f"crops of {self.crop_frames} frames"
        return f"{len(self):,} {kind}"

    def _crop(self, cut: Windows) -> int | None:
        if cut.length_s is None and cut.length is None:
            return None
        frames = self.store._window_grid(length_s=cut.length_s, length=cut.length).length
        if frames % self._period():
            raise UsageError("the length of a crop is not a whole number of rows of all fields",
                             found=f"{frames} frames", allowed=f"multiples of {self._period()}")  # fmt: skip
        return frames

    def _period(self) -> int:
        return whole_period(self.store._description, [self.store.field(name) for name in self.fields])

    def _random_starts(self, epoch: int, places: list[int]) -> npt.NDArray[np.int64]:
        """Return the first frames of the samples at `places` in an epoch, (len(places),)."""
        period = self._period()
        n_choices = ((self.windows.length - self.lengths) // period + 1)[places]
        return self.windows.start[places] + period * crop_choices(self.seed, epoch, places, n_choices)

    def _labels(self, plan: BatchPlan, nth: int) -> dict[str, torch.Tensor]:
        labels = beat_labels(self.store, self.fields)
        if labels is None:
            return {}
        rows = self.store.read(self._window(plan, nth), labels.field)
        return {name: torch.from_numpy(values) for name, values in labels.of(rows).items()}

    def _window(self, plan: BatchPlan, nth: int) -> Window:
        place = plan.places[nth]
        span = self.windows[place]
        return Window(span.clip, span.start + plan.shifts[nth], int(self.lengths[place]))

    def _rows(self, plan: BatchPlan, nth: int, field: str) -> torch.Tensor:
        """Read the rows of a sample: mirrored and augmented first, then normalised; 0 where they are masked."""
        place = plan.places[nth]
        rows = self.store.read(self._window(plan, nth), field)
        if plan.mirrored[nth] and field in self._mirrors:
            rows = self._mirrors[field].apply(rows)
        rows = self._augmenter.rows(field, rows, plan.epoch, place)
        if field in self._normalizers:
            rows = self._normalizers[field].normalize(rows, clamp=self.clamp).astype(np.float32, copy=False)
        if field in self._augmenter.dropped(plan.epoch, place):
            rows = np.full_like(rows, blank_of(self.store, field))
        return torch.from_numpy(rows)
