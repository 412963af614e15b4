"""SplitDataset: what `WindowDataset` and `ClipDataset` have in common."""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import names, whole
from dancedata.core.clip import Reject, Window
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.sample_id import SampleId, id_text
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.files.addresses import prefetch
from dancedata.store.clip_choice import require_where
from dancedata.store.dataset import Store, open_store, reopen
from dancedata.store.normalize import Scaler
from dancedata.store.schema import sort_splits
from dancedata.store.shard_reader import ShardReader
from dancedata.store.window_list import WindowList
from dancedata.torch.batch_reader import BatchPlan, blank_of
from dancedata.torch.clip_values import require_columns, value_of
from dancedata.torch.epochs import EpochDataset, require_scalers
from dancedata.torch.music_beats import StartAt
from dancedata.torch.options import Item, Scale, ScalerLike, Select, Windows
from dancedata.torch.sample_changes import SampleChanges, steps_named
from dancedata.torch.sample_items import SampleItems
from dancedata.torch.scalers import mirrors_of, named_scalers, normalized_fields, scaler_of
from dancedata.torch.selection import (
    SelectedWindows,
    WindowQuery,
    list_names,
    require_lists,
    select,
    window_filter,
)

if TYPE_CHECKING:
    from torch import Tensor

    from dancedata.core.sample_steps import Augment, Step
    from dancedata.torch.segments import SegmentReader

#: A warning is logged if augmentations need more than this many times the range of the scaler.
_FAR = 10.0
_log = logging.getLogger(__name__)


class SplitDataset(EpochDataset):
    """Samples of one split of a built dataset, normalised, mirrored and augmented on reading."""

    windows: WindowList  # (N) the frames that each sample is taken from
    rejects: tuple[Reject, ...]  # what was left out, and why
    _words: SegmentReader | None
    #: Name in the `Mix` that made this copy.
    _source = ""
    #: Whether a sample has a list of values of each free column.
    _lists_columns: ClassVar[bool] = False

    def __init__(
        self,
        store: str | Path | Store,
        split: str | Sequence[str],
        fields: Sequence[Item] | None,
        select: Select | None,
        scale: Scale | ScalerLike | None,
    ) -> None:
        """Open the store and settle the fields. Subclasses then call `_choose` and `_prepare`."""
        super().__init__()
        self._store: Store | None = store if isinstance(store, Store) else open_store(store)
        self._reference = self._store.__reduce__()[1]
        self._asked, self._scale = Select.taken(select), Scale.of(scale)
        require_lists(self.store, self._asked)
        self.splits = self._splits_named(split)
        self.split = "+".join(self.splits)
        self._items = SampleItems.of(self.store, fields)
        self.fields = self._items.fields
        self._scaled = normalized_fields(self.store, self.fields, self._scale.fields)
        self._tempos: dict[str, float] = {}

    def _choose(
        self, cut: Windows, windows: Mapping[str, Any], start_at: StartAt | None = None, also: str | None = None
    ) -> SelectedWindows:
        """Return the windows of the split whose clips have all fields, and the field `also`."""
        if cut.fps is not None and self.store.fps != cut.fps:
            raise UsageError(
                f"these windows are for {cut.fps} frames per second", where=str(self.store.path),
                found=f"{self.store.fps} frames per second",
                fix=f"build with fps: {cut.fps}, or give windows in seconds",
            )  # fmt: skip
        asked = self._asked
        self._choice = WindowQuery(
            fields=self.fields if also is None or also in self.fields else (*self.fields, also),
            windows=windows,
            trim=cut.trim,
            ignore=asked.ignore,
            protocol=asked.protocol,
            filter=window_filter(asked.filter),
            start_at=start_at,
            where=require_where(self.store, asked.where),
        )
        parts = [select(self.store, split, self._choice) for split in self.splits]
        self._split_of_clip = np.zeros(self.store._tables.n_clips, dtype=np.int16)
        for number in reversed(range(len(parts))):
            self._split_of_clip[parts[number].windows.clip] = number
        joined = WindowList.joined(self.split, [part.windows for part in parts])
        return SelectedWindows(joined, tuple(reject for part in parts for reject in part.rejects))

    def _splits_named(self, split: str | Sequence[str]) -> tuple[str, ...]:
        if split == "all" and self._asked.protocol is not None:
            lists = list_names(self.store)
            prefix = f"{self._asked.protocol}."
            return sort_splits({name.removeprefix(prefix) for name in lists if name.startswith(prefix)})
        if split == "all" and "all" not in self.store.splits:
            return self.store.splits
        splits = names("split", split)
        if not splits or len(set(splits)) < len(splits):
            raise UsageError("split names no split, or one of them twice", found=listed(splits) or "nothing")
        return splits

    def _prepare(self, augment: Augment, seed: int, *, allow_crop: bool = True) -> None:
        """Prepare what changes samples, of the windows that were chosen."""
        chosen = [self.windows.clip_ids[k] for k in np.unique(self.windows.clip)] if self._items.columns else []
        self.columns = require_columns(self.store, self._items.columns, chosen, lists=self._lists_columns)
        self.seed, self.augment = whole("seed", seed), augment
        steps = steps_named(augment)
        # A mirror that comes first is a permutation of columns as they are read.
        leading = bool(steps) and steps[0].mirrors
        self.mirror = steps[0].p if leading else 0.0
        self._augmenter = SampleChanges()
        if steps[leading:]:
            from dancedata.torch.augmenting import Augmenter

            mirrored = self.mirror > 0
            self._augmenter = Augmenter.of(
                self.store, self.fields, steps[leading:], seed=self.seed, mirrored=mirrored, allow_crop=allow_crop
            )
        self._mirrors = mirrors_of(self.store, self.fields) if self.mirror else {}
        self._is_random = bool(0 < self.mirror < 1 or self._augmenter.steps)
        self._words, self._draws = None, False
        if self._items.words is not None:
            from dancedata.torch.segments import SegmentReader

            mirrors = any(step.mirrors and step.p for step in steps)
            self._words = SegmentReader(self.store, self._items.words, mirrors=mirrors, seed=self.seed)
            self._draws = self._words.draws
            self._is_random |= self._draws
        self.clamp, self._covers = self._scale.clamp, steps_named(self._scale.covers)
        if self._covers:
            from dancedata.torch.augmenting import check_steps

            check_steps(self._covers, self.fields, self.store)
        self._named_scalers = named_scalers(self.store, self.fields, self._scale.scaler)
        self._normalizers = {name: self._scaler(name) for name in self._scaled}
        for name, scaler in self._normalizers.items():
            scaler.require_range(self.clamp)
            if self.clamp or scaler.kind != "minmax":
                continue
            needed, stored_range = self._covering(name, scaler, self._augmenter.steps).data_range, scaler.data_range
            times = needed / np.where(stored_range > 1e-5, stored_range, np.inf)  # constant columns are not stretched
            if times.max() > _FAR:
                label = self.store.fields[name].labels[int(times.argmax())]
                _log.warning(
                    "augment= takes scaled values of %s far beyond [-1, 1], those of %s furthest; name what the "
                    "scaler has to cover, Scale(covers=...), or cut values, Scale(clamp=True)", name, label,
                )  # fmt: skip

    @property
    def store(self) -> Store:
        """The built dataset; opened again in every process that receives a copy of this object.

        Raises StoreError: if it was replaced by another dataset in the meantime.
        """
        if self._store is None:
            self._store = reopen(*self._reference)
        return self._store

    @override
    def __len__(self) -> int:
        return len(self.windows)

    def __repr__(self) -> str:
        steps = [(step.name, getattr(step.augmentation, "p", step.p)) for step in self._augmenter.steps]
        steps = [("mirror", self.mirror)] * bool(self.mirror) + steps
        augment = "".join(f", augment: {name} p={p:g}" for name, p in steps)
        return (
            f"{type(self).__name__}({str(self.store.path)!r}, split={self.split!r}, {self._samples_text()}{augment})"
        )

    def __str__(self) -> str:
        """Return what a sample is: the shape and type of each entry, and what scales it."""
        lines = [repr(self)]
        for name in self.fields:
            scaler = self._normalizers.get(name)
            shape, dtype = self._shape(name), self.store.field(name).dtype if scaler is None else "float32"
            how = "as stored" if scaler is None else f"{scaler.kind} scaler {scaler.sha256[:12]}"
            how += ", cut to [-1, 1]" if scaler is not None and self.clamp else ""
            lines.append(f"  {name}: ({', '.join(map(str, shape))}) {dtype}, {how}")
        items = [item for item in (self._items.primitives, self._items.words) if item is not None]
        lines += [f"  {type(item).__name__.lower()}: {item!r}" for item in items]
        return "\n".join(lines + [f"  {name}: of the clip" for name in self.columns])

    def _samples_text(self) -> str:
        return f"{len(self):,} windows"

    def _shape(self, name: str) -> tuple[int | str, ...]:
        """Return the shape of a sample's rows of a field; rows that differ in number are "T"."""
        field, lengths = self.store.field(name), np.unique(self.lengths)
        return self.store.grid.rows(int(lengths[0]), of=field.grid) if len(lengths) == 1 else "T", field.columns.width

    def save_samples(
        self, folder: str | Path, ids: Sequence[str], samples: npt.ArrayLike | Tensor, *, overwrite: bool = False
    ) -> list[Path]:
        """Write a model's samples (B, L, D) to ``ID.npz``, for evaluate, view, report and decode without an option.

        They are of the motion field that is read, normalised as it is; padded ones are cut to the length of their id.

        Raises UsageError, DataError: for ids that are not of the dataset or differ in case alone, samples shorter
            than their ids state or of another width, files that exist, and a folder of samples of another dataset.
        """
        names = [name for name in self.fields if self.store.field(name).kind == "motion"]
        width = np.shape(samples)[-1]
        fitting = [name for name in names if self.store.field(name).columns.width == width]
        if len(fitting) != 1:
            widths = listed(f"{name} ({self.store.field(name).columns.width})" for name in names)
            raise UsageError("no motion field that is read, or not one alone, has this width", found=str(width),
                             allowed=widths)  # fmt: skip
        scaler = self._normalizers.get(fitting[0])
        for name in ids:
            self._id(name)
        from dancedata.samples.saved import save_samples

        return save_samples(self.store, folder, ids, samples, field=fitting[0], scaler=scaler, overwrite=overwrite)

    def _read_again(self, name: str | SampleId) -> dict[str, Any]:
        """Read the sample that an id names, with its changes and draw; UsageError if it is not of this dataset."""
        from dancedata.samples import Samples

        of = replace(self._id(name), take=0, source="")
        seed, epoch, place = of.draw or (self.seed, None, -1)
        if of.draw is None:
            sample = Samples(self.store).require(of)
            at = (self.windows.start == sample.start) & (self.windows.length == sample.length)
            numbers = np.flatnonzero(at & (self.windows.clip == self.windows.clip_ids.index(sample.clip.id)))
            place = int(numbers[0]) if len(numbers) else -1
        reader = self._unchanged() if of.draw is None and self._is_random else self
        item = {} if seed != self.seed or not 0 <= place < len(self) else reader.samples([place], epoch)[0]
        if item.get("id") != str(of):
            raise UsageError("this dataset does not read this sample", where=str(name),
                             found=item.get("id", f"split {self.split}, seed {self.seed}"),
                             fix="give the arguments of the dataset that gave the id")  # fmt: skip
        return item

    def _unchanged(self) -> Self:
        """Return a copy without augmentations, as ids without a draw name samples that none has changed."""
        other = self.rescaled({}, self._source)
        other.mirror, other._augmenter = 0.0, SampleChanges()
        return other

    def _id(self, name: str | SampleId) -> SampleId:
        """Return an id; UsageError for one of another source of a mix, where a clip may have the same name."""
        of = SampleId.parse(name)
        if of.source not in ("", self._source):
            raise UsageError("this sample belongs to another source of the mix", where=str(name), found=of.source,
                             allowed=self._source or "an id without SOURCE=",
                             fix="take the mix, or mix.datasets[k] of its source")  # fmt: skip
        return of

    @property
    def lengths(self) -> npt.NDArray[np.int64]:
        """Frames of each sample, (N,), at the store's fps."""
        return np.asarray(self.windows.length, dtype=np.int64)

    def __getstate__(self) -> dict[str, Any]:
        # A store that cannot be opened again is an error of the first batch, and does not end a DataLoader's worker.
        return {k: v for k, v in self.__dict__.items() if k != "_shards_of_samples"} | {"_store": None}

    def scaler(self, field: str) -> Scaler:
        """Return the scaler that a field of this dataset is normalised with.

        For a field that is not scaled, it is the scaler that ``Scale(fields=(field,))`` would use.

        Raises UsageError: for a field that this dataset does not read.
        """
        if field not in self.fields:
            raise UsageError(f"this dataset does not read field {field!r}", allowed=", ".join(self.fields),
                             fix=did_you_mean(field, self.fields))  # fmt: skip
        return self._normalizers.get(field) or self._scaler(field)

    def rescaled(self, scalers: Mapping[str, Scaler], source: str) -> Self:
        """Return a copy for a mix, normalised with other scalers, by field; it has an epoch of its own."""
        other = copy.copy(self)
        other._source = source
        EpochDataset.__init__(other)
        other._store = self._store
        other._normalizers = self._normalizers | {name: s for name, s in scalers.items() if name in self._normalizers}
        other._named_scalers = {**self._named_scalers, **scalers}
        return other

    @property
    def normalized(self) -> tuple[str, ...]:
        """Names of the fields that are normalised."""
        return tuple(self._normalizers)

    @property
    def blanks(self) -> dict[str, int]:
        """Value of the rows of absent dancers and masked columns, by field: 0, or the pad of codes."""
        return {name: blank_of(self.store, name) for name in self.fields}

    def state_dict(self) -> dict[str, Any]:
        """Return the hashes of the scalers, {"scalers": {field: hash}}, for a checkpoint.

        They are those of the fields that are normalised, or whose scaler was named.
        """
        widened = self._scale.covers or self._scale.over != "train"
        fields = [self.store.field(name) for name in self.fields] if widened else []
        motion = [field.name for field in fields if field.kind == "motion" and field.codebook is None]
        names = dict.fromkeys((*self._normalizers, *self._named_scalers, *motion))
        return {"scalers": {name: self.scaler(name).sha256 for name in names}}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Check that the model of a checkpoint was trained with the scalers of this reader; changes nothing.

        Raises UsageError: for the state of a reader with other scalers.
        """
        require_scalers(state, self.state_dict(), "name the scaler of that training: WindowDataset(..., scale=FILE)")

    @property
    def shard_starts(self) -> npt.NDArray[np.int64]:
        """First samples (S,) of the shards, for an `EpochSampler` that reads neighbours together."""
        return np.flatnonzero(np.diff(self._shards_of_samples[1], prepend=-1))

    def prefetch(self, blocks: Sequence[npt.NDArray[np.int64]]) -> None:
        """Ask for the shards of the next blocks of samples of an address, in the background."""
        if self._fetches_shards:
            shards, numbers = self._shards_of_samples
            order = dict.fromkeys(numbers[np.concatenate(blocks)].tolist())
            prefetch([shards[number].path for number in order])

    @cached_property
    def _fetches_shards(self) -> bool:
        """Whether shards come from an address; asked once, as the answer is in a file."""
        return self.store.origin is not None

    @cached_property
    def _shards_of_samples(self) -> tuple[tuple[ShardReader, ...], npt.NDArray[np.int32]]:
        return self.store._shards_of(self.windows)

    def _scaler(self, field: str) -> Scaler:
        if field in self._named_scalers:
            return self._named_scalers[field]
        scaler = scaler_of(self.store, field, self._choice, self._scale)
        return self._covering(field, scaler, self._covers)

    def _covering(self, field: str, scaler: Scaler, steps: Sequence[Step]) -> Scaler:
        if not steps:
            return scaler
        from dancedata.store.motion_fields import sample_field

        return scaler.covering(sample_field(self.store, field), steps)

    @cached_property
    def genre_ids(self) -> Mapping[str, int]:
        """The number of each genre: as the dataset numbers them, else 0, 1, ... by name, over all splits."""
        numbers: Mapping[str, int] = self.store.info.get("genre_ids") or {}
        if numbers:
            return numbers
        # The column, not the clips: there may be a million.
        genres = self.store._tables.columns.get("genre")
        return {name: k for k, name in enumerate(sorted(genres.distinct() - {""} if genres is not None else ()))}

    def _metadata(
        self, plan: BatchPlan, windows: WindowList | None = None, changes: Sequence[str] = ()
    ) -> dict[str, list[Any]]:
        """Return the values of samples beside their arrays, (B,) by name; `changes` are those of every sample."""
        places, epoch = np.asarray(plan.places, dtype=np.int64), plan.epoch
        windows = (self.windows if windows is None else windows).take(places)
        starts = (windows.start + np.asarray(plan.shifts, dtype=np.int64)).tolist()
        lengths = windows.length.tolist()
        copies = [
            (*changes, *["mirror"] * flag, *self._augmenter.changes(epoch, place))
            for place, flag in zip(plan.places, plan.mirrored, strict=True)
        ]
        marks = [
            "".join(f"~{mark}" for mark in (*m, f"draw{self.seed}.{epoch}.{k}")) if m or self._draws else ""
            for m, k in zip(copies, places, strict=True)
        ]
        droppable = self._augmenter.droppable
        dropped = [self._augmenter.dropped(epoch, place) for place in plan.places] if droppable else []
        attributes = ("id", "genre", "music", "dancer", "tempo_bpm", *["columns"] * bool(self.columns))
        of_clips = self.store._clip_values(windows, attributes)
        clips, genres, stated = of_clips["id"], of_clips["genre"], of_clips["tempo_bpm"]
        tempos = [self._estimated_tempo(c) if bpm is None else bpm for c, bpm in zip(clips, stated, strict=True)]
        mirrored = [names.count("mirror") % 2 == 1 for names in copies]
        return {
            "id": [id_text(*of) for of in zip(clips, starts, lengths, marks, strict=True)],
            "clip": clips,
            "start": starts,
            "length": lengths,
            "split": [self.splits[k] for k in self._split_of_clip[windows.clip]],
            "genre": genres,
            "genre_id": [int(self.genre_ids.get(genre, -1)) for genre in genres],
            "music": of_clips["music"],
            "dancer": of_clips["dancer"],
            "tempo_bpm": tempos,
            "tempo_estimated": [a is None and not math.isnan(b) for a, b in zip(stated, tempos, strict=True)],
            "mirrored": mirrored,
            **{f"{name}_dropped": [name in of_sample for of_sample in dropped] for name in droppable},
            "index": [int(place) for place in plan.places],
            **{name: [value_of(self.store, free, name) for free in of_clips["columns"]] for name in self.columns},
            **self._segment_values(plan, zip(clips, starts, lengths, strict=True), mirrored),
        }

    def _segment_values(
        self, plan: BatchPlan, windows: Iterable[tuple[str, int, int]], mirrored: Sequence[bool]
    ) -> dict[str, list[Any]]:
        if self._words is None:
            return {}
        return self._words.values(self.store, list(starmap(Window, windows)), mirrored, plan.epoch, plan.places)

    def _estimated_tempo(self, clip: str) -> float:
        """Return the tempo of a clip for which the dataset states none, by its beats; nan without any."""
        if clip not in self._tempos:
            from dancedata.torch.beat_starts import estimated_tempo

            self._tempos[clip] = estimated_tempo(self.store, clip, self.fields)
        return self._tempos[clip]
