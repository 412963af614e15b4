"""WindowDataset: the windows of a built dataset as a map-style torch dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch.utils.data import get_worker_info

from dancedata.core.errors import UsageError
from dancedata.core.sample_id import SampleId
from dancedata.core.typing import override
from dancedata.store.dataset import Store
from dancedata.store.window_list import WindowList
from dancedata.torch.batch_reader import (
    Array,
    BatchPlan,
    BatchReader,
    FieldReader,
    Layout,
    MemoryPool,
    ReadBatch,
    shared_tensor,
)
from dancedata.torch.collate import Batch, Sample, collate
from dancedata.torch.draws import mirrored_samples, primitive_bias
from dancedata.torch.music_beats import beat_labels
from dancedata.torch.options import Item, Scale, ScalerLike, Select, Windows, clash
from dancedata.torch.scalers import root_columns
from dancedata.torch.selection import SelectedWindows, WindowQuery, no_window_error
from dancedata.torch.split_dataset import SplitDataset

if TYPE_CHECKING:
    from dancedata.core.sample_steps import Augment


class WindowDataset(SplitDataset):
    """Windows of one split, each a dict of tensors and metadata that torch's default collate can batch.

    ``dataset[i]`` is ``{field: tensor (rows, D), ..., "id": name of the sample, "clip": id, "start": first frame in
    the clip at the store's fps, "length": frames, "split", "genre", "music", "dancer": str, "genre_id": int (see
    `genre_ids`; -1 without a genre), "tempo_bpm": float (nan if unknown), "tempo_estimated": bool, "mirrored": bool,
    "index": int}``. Rows of a field are length * field rate / fps. Tensors have the stored dtype, or float32 where
    they are normalised, and are the caller's own.

    Pickling copies no data: each process opens the files itself, so fork, spawn and forkserver all work.

    Parameters
    ----------
    store
        The built dataset's folder, or a store that `dancedata.open` returned.
    split
        One of ``store.splits``, several, ``("train", "val")``, or "all". A sample has its own split's name; the
        scaler is that of train.
    fields
        What a sample holds: names of fields; "x/NAME", a free column, of which a sample has its clip's value, a list
        where the column holds lists, "" and nan where a clip has no text or number; `Relative`, `Primitives`, `Text`,
        `Segments`. Default: edge151 and librosa35, else all fields of the dataset.
    windows
        `Windows`: length, stride and first frames; or a list of one's own, some of ``store.windows(split)``. Default:
        as stored.
    select
        `Select`: which clips and windows.
    scale
        `Scale`; a scaler, its file, either by field, or a reader that has one; None: values as they are stored.
    augment
        Augmentations of samples, in their order: plug-ins, names, or mappings of names to parameters as in
        recipes, ``["yaw", {"noise": {"std_degrees": 1}}]`` or ``{"mirror": 0.5, "crop": True}``. ``"p"`` among
        the parameters is the probability that a sample is changed; default: 1.
    seed
        Whole number >= 0, of everything that is drawn.

    Raises
    ------
    StoreError, UsageError
        Without a finished dataset; for an unknown split or field, a field that cannot be augmented, windows that this
        store cannot give, and for two values that do not go together.

    Attributes
    ----------
    windows
        (N) the windows, in the order of the store.
    rejects
        Clips and windows that were left out, and why: "ignored", "too_short", "still", "filtered".

    Notes
    -----
    Changes are pure functions of (seed, epoch, index) once an epoch is set, as an `EpochSampler` of this dataset
    does: the same in every worker, on every rank, and after a resume. Without an epoch each reading draws from
    torch's generator.

    With `Primitives` among the fields a sample also holds Lodge's ``"primitives"`` (K, 8, D), ``"primitive_start"``,
    ``"primitive_hard"`` and ``"primitive_filled"`` (K,); for windows of one local segment ``"primitives"`` (8, D)
    alone. With a field that has beats it holds the labels ``"beat"`` and ``"downbeat"``, (rows,) bool.

    ``print(dataset)`` says what a sample is, and ``dataset[ID]`` reads that of a ``batch["id"]`` again, with its
    changes and their draw. See docs/guides/batches.md and docs/guides/training.md.

    Examples
    --------
    >>> from dancedata.torch import WindowDataset
    >>> ds = WindowDataset("data/aistpp", "train", fields=["edge151"])
    >>> ds[0]["edge151"].shape
    torch.Size([150, 151])
    """

    #: For ``DataLoader(collate_fn=...)``; default_collate does the same with samples of this dataset.
    collate = staticmethod(collate)

    def __init__(
        self,
        store: str | Path | Store,
        split: str | Sequence[str] = "train",
        fields: Sequence[Item] | None = None,
        *,
        windows: Windows | WindowList | None = None,
        select: Select | None = None,
        scale: Scale | ScalerLike | None = Scale(),
        augment: Augment = (),
        seed: int = 0,
    ) -> None:
        super().__init__(store, split, fields, select, scale)
        cut = Windows.taken(None if isinstance(windows, WindowList) else windows)
        spec = None
        if self._items.primitives is not None:
            from dancedata.torch.primitives import primitive_spec

            grid = self.store._window_grid(**cut.length_and_stride)
            length = int(windows.length[0]) if isinstance(windows, WindowList) and len(windows) else grid.length
            spec = primitive_spec(self.store, self.fields, length, self._items.primitives, self._scaled)
        self._primitives, also = spec, spec.key_motion if spec is not None else None
        if isinstance(windows, WindowList):
            selection = self._listed(windows, also)
        else:
            selection = self._choose(cut, cut.length_and_stride, cut.start_at, also)
        self.windows, self.rejects = selection.windows, selection.rejects
        if not self.windows:
            raise no_window_error(self.store, self.split, self.rejects, cut.start_at)
        self._prepare(augment, seed)
        if cut.start_at is not None and self._augmenter.crops:
            raise clash(cut, "the augmentation crop", "both choose where windows begin")
        self._draws |= spec is not None and spec.variant == "code"
        self._is_random |= self._draws
        self._roots = root_columns(self.store, self._items.relative, self._scaled)
        self._stride = self.store._window_grid(**self._choice.windows).stride
        self._starts: dict[str, range] = {}
        self._cached_reader: BatchReader | None = None
        self._pool = MemoryPool()

    def _listed(self, windows: WindowList, also: str | None) -> SelectedWindows:
        """Take windows of the caller's; UsageError for those of another split, or that are selected once more."""
        if self._asked != Select():
            raise clash(self._asked, windows, "windows of one's own are selected already")
        if windows.split != self.split:
            raise clash(f"split={self.split!r}", windows, "they are of another split")
        self._choice = WindowQuery(fields=self.fields if also is None else (*self.fields, also))
        if not windows:
            raise UsageError("the list of windows is empty", where=str(self.store.path), found=windows)
        for name in self._choice.fields:
            self.store._window_rows(windows, name)  # which checks them
        self._split_of_clip = np.zeros(self.store._tables.n_clips, dtype=np.int16)
        return SelectedWindows(windows, ())

    def __getitem__(self, index: int | str | SampleId) -> dict[str, Any]:
        """Return one window; negative indices count from the end, and an id is read again as it was.

        Raises IndexError: for an index outside the split.
        Raises UsageError: for an id that this dataset does not read.
        """
        if isinstance(index, str | SampleId):
            return self._read_again(index)
        plan, reader = self._plan([index]), self._batch_reader()
        arrays = {name: np.empty((1, *shape), dtype=dtype) for name, (shape, dtype) in reader.layout.items()}
        reader(plan, arrays)
        tensors = {name: torch.from_numpy(array[0]) for name, array in arrays.items()}
        return tensors | {name: values[0] for name, values in self._metadata(plan).items()}

    @override
    def samples(self, indices: Sequence[int], epoch: int | None = None) -> list[dict[str, Any]]:
        """Return many windows, as of an epoch that is given here; their tensors are rows of a batch of its own."""
        plan, reader = self._plan(indices, epoch), self._batch_reader()
        if not len(plan):
            return []
        tensors = {name: self._pool.tensor((len(plan), *s), dtype) for name, (s, dtype) in reader.layout.items()}
        reader(plan, {name: tensor.numpy() for name, tensor in tensors.items()})
        if get_worker_info() is not None:
            tensors = {name: shared_tensor(tensor.numpy()) for name, tensor in tensors.items()}
        batch, metadata = Batch.of(len(plan), tensors), self._metadata(plan)
        return [
            Sample({n: rows[nth] for n, rows in batch.rows.items()} | {k: v[nth] for k, v in metadata.items()}, batch)
            for nth in range(len(plan))
        ]

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_cached_reader": None, "_pool": MemoryPool()}

    def _bias(self, place: int, epoch: int | None = None) -> int:
        return primitive_bias(self.seed, self._drawn_epoch(epoch), place)

    def _plan(self, indices: Sequence[int], epoch: int | None = None) -> BatchPlan:
        """Return the windows at some indices, and which of them are mirrored in an epoch, or in the current one."""
        epoch = self._drawn_epoch(epoch)
        places = tuple(self._place(index) for index in indices)
        mirrored = tuple(mirrored_samples(self.seed, epoch, places, self.mirror).tolist())
        shifts = tuple(self._shift(place, epoch) for place in places) if self._augmenter.crops else (0,) * len(places)
        return BatchPlan(places, mirrored, shifts, epoch)

    def _shift(self, place: int, epoch: int) -> int:
        """Return by how many frames the window that is read begins later than the listed one."""
        window = self.windows[place]
        if window.clip not in self._starts:
            fields, trim = self._choice.fields, self._choice.trim
            self._starts[window.clip] = self.store._starts(window.clip, window.length, fields=fields, trim=trim)
        starts = self._starts[window.clip]
        start = self._augmenter.start(window.start, starts, self._stride, epoch, place)
        if start != window.start and start not in starts:
            raise UsageError("an augmentation chooses a window that its clip does not have",
                             where=f"clip {window.clip}", found=f"frame {start}", allowed=starts)  # fmt: skip
        return start - window.start

    @property
    def _layout(self) -> Layout:
        return self._batch_reader().layout

    def _planned(self, indices: Sequence[int], epoch: int | None = None) -> ReadBatch:
        """Return a reader of the samples at some indices; random numbers are drawn now, files are read later."""
        plan, reader = self._plan(indices, epoch), self._batch_reader()

        def read(out: Mapping[str, Array]) -> dict[str, list[Any]]:
            reader(plan, out)
            return self._metadata(plan)

        return read

    def _batch_reader(self) -> BatchReader:
        if self._cached_reader is None:
            self._cached_reader = self._new_reader()
        return self._cached_reader

    def _new_reader(self) -> BatchReader:
        fields = [self._field_reader(name, self.windows) for name in self.fields]
        spec = self._primitives
        keys = None if spec is None or spec.key_motion is None else self._field_reader(spec.key_motion, self.windows)
        labels = beat_labels(self.store, self.fields)
        return BatchReader(self.store, fields, self._augmenter, labels, spec, keys, self._bias)

    def _field_reader(self, name: str, windows: WindowList) -> FieldReader:
        rows = self.store._window_rows(windows, name)
        period = self.store.grid.common_period(self.store.field(name).grid)
        mirror, root = self._mirrors.get(name), self._roots.get(name)
        return FieldReader(name, rows, period, mirror, root, self._normalizers.get(name), self.clamp)
