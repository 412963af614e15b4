"""ClipDataset: the clips of a built dataset, whole or cropped at random, as a map-style torch dataset."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch

from dancedata.core.arguments import whole
from dancedata.core.clip import Reject, Window
from dancedata.core.errors import UsageError
from dancedata.core.sample_steps import Augment
from dancedata.core.typing import override
from dancedata.readers.batch_reader import Request, blank_of
from dancedata.readers.clip_collate import pack_clips, pad_clips
from dancedata.readers.music_beats import StartAt, beat_labels, beat_starts, no_start, require_start_at
from dancedata.readers.scalers import ScalerLike
from dancedata.readers.segments import MirrorWords, SegmentChoice
from dancedata.readers.selection import FilterLike, no_window_error
from dancedata.readers.split_dataset import Changes, SplitDataset, crop_choices, mirrored_samples
from dancedata.store.dataset import Store
from dancedata.store.window_list import WindowList


class ClipDataset(SplitDataset):
    """Clips of one split, each a dict of tensors and metadata, as `WindowDataset` has them.

    A sample is a whole clip, all frames for which every field has whole rows; or, with `crop_s` or `crop_frames`, a
    piece of that length from a random place, a new one in every epoch::

        clips = ClipDataset(out, fields=("edge151", "librosa35"))
        loader = DataLoader(clips, batch_size=8, collate_fn=pad_clips, sampler=EpochSampler(clips, seed=0))

        crops = ClipDataset(out, crop_s=5, crops=4)     # all of one length: default_collate is enough

    Whole clips differ in length: `pad_clips` or `pack_clips` make batches of them, and `BucketSampler` puts clips of
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
    Random changes and scalers are those of `WindowDataset`; a store of window scope does not hold whole clips.
    """

    #: For ``DataLoader(collate_fn=...)``.
    pad, pack = staticmethod(pad_clips), staticmethod(pack_clips)

    def __init__(
        self,
        store: str | Path | Store,
        split: str | Sequence[str] = "train",
        fields: Sequence[str] | None = None,
        *,
        crop_s: float | str | None = None,
        crop_frames: int | None = None,
        crops: int = 1,
        normalize: bool | Sequence[str] | None = None,
        mirror: float = 0.0,
        augment: Augment | None = None,
        preset: str | None = None,
        trim: bool | None = None,
        ignore: Sequence[str] | None = None,
        protocol: str | None = None,
        filter: FilterLike = None,
        start_at: StartAt | None = None,
        normalizer_covers_mirror: bool = False,
        normalizer_covers: Augment = (),
        normalizer_over: Literal["train", "all"] = "train",
        scaler: ScalerLike = None,
        clip: bool | None = None,
        segments: bool | str = False,
        min_share: float = 0.5,
        empty: float = 0.0,
        mirror_words: MirrorWords = "error",
        columns: Sequence[str] = (),
        where: Mapping[str, Any] | None = None,
        seed: int = 0,
    ) -> None:
        """Open a split of a built dataset; parameters that are not named here are those of `WindowDataset`.

        Parameters
        ----------
        crop_s, crop_frames
            Length of random crops, at most one of the two. Default: whole clips.
        crops
            Crops of each clip in an epoch.
        augment
            As for a `WindowDataset`, except "crop": give `crop_s` or `crop_frames`.
        preset
            Fields, trim, lists and normalising of a trainer; its windows and its filter are not used.
        filter
            A filter of whole clips, as for windows.
        start_at
            "downbeat" or "beat": each crop begins at a random one, found as for a `WindowDataset`.

        Raises
        ------
        StoreError
            If there is no finished dataset at `store`, or it is of window scope.
        UsageError
            For an unknown split or field, invalid numbers, or if no clip is long enough.
        """
        super().__init__(store, split, fields, preset, protocol)
        if self._with_primitives:
            raise UsageError("primitives are parts of windows, not of clips", fix="read them with a WindowDataset")
        self.crop_frames = self._crop(crop_s, crop_frames)
        self.crops = whole("crops", crops)
        if not self.crops or (self.crops > 1 and self.crop_frames is None):
            raise UsageError("crops is the number of crops of each clip", found=crops, fix="give crop_s with it")
        self.start_at = require_start_at(start_at)
        if self.start_at is not None and self.crop_frames is None:
            raise UsageError("start_at is the place of crops", found=start_at, fix="give crop_s with it")
        self._starts: dict[str, npt.NDArray[np.int64]] = {}
        selection = self._select({"whole": True}, trim, ignore, filter, None, where)
        spans, self.rejects = self._long_enough(selection.windows, selection.rejects)
        if not spans:
            raise no_window_error(self.store, self.split, self.rejects, self.start_at)
        self.windows = spans.take(np.repeat(np.arange(len(spans)), self.crops))
        changes = Changes(
            mirror=mirror, augment=augment, normalize=normalize, normalizer_covers_mirror=normalizer_covers_mirror,
            normalizer_covers=normalizer_covers, normalizer_over=normalizer_over, scaler=scaler, clip=clip, seed=seed,
            words=SegmentChoice(segments, min_share, empty, mirror_words), columns=columns,
        )  # fmt: skip
        self._prepare(changes, allow_crop=False)
        self._is_random |= self.crop_frames is not None

    @property
    def lengths(self) -> npt.NDArray[np.int64]:
        """Frames of each sample, (N,), at the store's fps."""
        if self.crop_frames is None:
            return np.asarray(self.windows.length, dtype=np.int64)
        return np.full(len(self), self.crop_frames, dtype=np.int64)

    def __getitem__(self, index: int) -> dict[str, Any]:
        return self.samples([index])[0]

    @override
    def samples(self, indices: Sequence[int], epoch: int | None = None) -> list[dict[str, Any]]:
        epoch = self._drawn_epoch(epoch)
        places = [self._place(index) for index in indices]
        mirrored = mirrored_samples(self.seed, epoch, places, self.mirror)
        shifts = self._random_starts(epoch, places) - self.windows.start[places]
        request = Request(tuple(places), tuple(mirrored.tolist()), tuple(shifts.tolist()), epoch)
        cuts = replace(self.windows, length=self.lengths)
        metadata = self._metadata(request, cuts, () if self.crop_frames is None else ("crop",))
        return [
            {name: self._rows(request, nth, name) for name in self.fields}
            | self._labels(request, nth)
            | {name: values[nth] for name, values in metadata.items()}
            for nth in range(len(places))
        ]

    def __repr__(self) -> str:
        kind = "whole clips" if self.crop_frames is None else f"crops of {self.crop_frames} frames"
        return (
            f"ClipDataset({str(self.store.path)!r}, split={self.split!r}, {len(self):,} {kind}, "
            f"fields: {', '.join(self.fields)}; normalised: {', '.join(self._normalizers) or 'nothing'}; "
            f"mirror={self.mirror:g})"
        )

    def _crop(self, crop_s: float | str | None, crop_frames: int | None) -> int | None:
        if crop_s is not None and crop_frames is not None:
            raise UsageError("both crop_s and crop_frames are given", fix="give one of them")
        frames = self.store.grid.frames(crop_s, what="crop_s") if crop_s is not None else crop_frames
        if frames is None:
            return None
        if whole("crop_frames", frames) < 1 or frames % self._period():
            raise UsageError("the length of a crop is not a whole number of rows of all fields",
                             found=f"{frames} frames", allowed=f"multiples of {self._period()}")  # fmt: skip
        return int(frames)

    def _period(self) -> int:
        """Return the least number of frames that is a whole number of rows of every field."""
        grid = self.store.grid
        return int(np.lcm.reduce([grid.common_period(self.store.field(name).grid)[0] for name in self.fields]))

    def _long_enough(self, spans: WindowList, rejects: tuple[Reject, ...]) -> tuple[WindowList, tuple[Reject, ...]]:
        """Return the clips that hold a crop, with a reject for each of the others."""
        least = self.crop_frames or 1
        short = [span for span in spans if span.length < least]
        too_short = [
            Reject("too_short", span.clip, detail=f"{span.length} frames: a crop has {least}") for span in short
        ]
        spans = spans.take(spans.length >= least)
        if self.start_at is None:
            return spans, (*rejects, *too_short)
        possible = np.array([len(self._beat_starts(span.clip)) > 0 for span in spans], dtype=np.bool_)
        too_short += [no_start(span.clip, least, self.start_at) for span in spans.take(~possible)]
        return spans.take(possible), (*rejects, *too_short)

    def _beat_starts(self, clip: str) -> npt.NDArray[np.int64]:
        """Return the frames (N,) at which a crop of a clip can begin on a beat."""
        if clip not in self._starts:
            at, length, trim = self.start_at or "beat", self.crop_frames or 1, self._choice.trim
            self._starts[clip] = beat_starts(self.store, clip, length, at=at, fields=self.fields, trim=trim)
        return self._starts[clip]

    def _random_starts(self, epoch: int, places: list[int]) -> npt.NDArray[np.int64]:
        """Return the first frames of the samples at `places` in an epoch, (len(places),)."""
        if self.start_at is None:
            period = self._period()
            n_choices = ((self.windows.length - self.lengths) // period + 1)[places]
            return self.windows.start[places] + period * crop_choices(self.seed, epoch, places, n_choices)
        beats = [self._beat_starts(self.windows[place].clip) for place in places]
        choices = crop_choices(
            self.seed, epoch, places, np.array([len(of_clip) for of_clip in beats], dtype=np.int64)
        )
        return np.array([of_clip[nth] for of_clip, nth in zip(beats, choices, strict=True)], dtype=np.int64)

    def _labels(self, request: Request, nth: int) -> dict[str, torch.Tensor]:
        """Return the labels of beats of a sample; empty if no field has them."""
        labels = beat_labels(self.store, self.fields)
        if labels is None:
            return {}
        rows = self.store.read(self._window(request, nth), labels.field)
        return {name: torch.from_numpy(values) for name, values in labels.of(rows).items()}

    def _window(self, request: Request, nth: int) -> Window:
        place = request.places[nth]
        span = self.windows[place]
        return Window(span.clip, span.start + request.shifts[nth], int(self.lengths[place]))

    def _rows(self, request: Request, nth: int, field: str) -> torch.Tensor:
        """Read the rows of a sample: mirrored and augmented first, then normalised; 0 where they are masked."""
        place = request.places[nth]
        rows = self.store.read(self._window(request, nth), field)
        if request.mirrored[nth] and field in self._mirrors:
            rows = self._mirrors[field].apply(rows)
        rows = self._augmenter.rows(field, rows, request.epoch, place)
        if field in self._normalizers:
            rows = self._normalizers[field].normalize(rows, clip=self.clip).astype(np.float32, copy=False)
        if field in self._augmenter.dropped(request.epoch, place):
            rows = np.full_like(rows, blank_of(self.store, field))
        return torch.from_numpy(rows)
