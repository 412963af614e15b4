"""WindowDataset: the windows of a built dataset as a map-style torch dataset."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch.utils.data import get_worker_info

from dancedata.core.errors import UsageError
from dancedata.core.sample_steps import Augment
from dancedata.core.typing import override
from dancedata.readers.batch_reader import (
    Array,
    BatchReader,
    FieldReader,
    Layout,
    MemoryPool,
    ReadBatch,
    Request,
    shared_tensor,
)
from dancedata.readers.clip_collate import Batch, Sample, collate
from dancedata.readers.music_beats import StartAt, beat_labels, require_start_at
from dancedata.readers.presets import PrimitiveSpec, preset_windows, primitive_spec, value_or_preset
from dancedata.readers.scalers import ScalerLike, root_columns
from dancedata.readers.segments import MirrorWords, SegmentChoice
from dancedata.readers.selection import FilterLike, no_window_error
from dancedata.readers.split_dataset import Changes, SplitDataset, mirrored_samples, primitive_bias
from dancedata.store.dataset import Store

_log = logging.getLogger(__name__)


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
        Names of the fields to read, and "primitives" if wanted. Default: the preset's, else edge151 and
        librosa35, else all fields of the dataset.
    normalize
        True: motion fields only. A sequence of field names: those. False: none. Default: the preset's, else
        True.
    mirror
        Probability in [0, 1] that a sample is mirrored.
    augment
        Augmentations of samples, in their order: plug-ins, names, or mappings of names to parameters as in
        recipes, ``["yaw", {"noise": {"std_degrees": 1}}]`` or ``{"mirror": 0.5, "crop": True}``. ``"p"`` among
        the parameters is the probability that a sample is changed; default: 1.
    preset
        "edge", "lodge-global", "lodge-local" or "finenet": fields, windows, trim, lists, filter and root as
        that trainer uses them. Other arguments take precedence.
    length_s, length_frames, stride_s, stride_frames
        Length and stride of windows, if not as stored; at most one of each pair; only for a store of track scope.
        Windows end where the clip ends, or the first of `fields` in it.
    trim
        Whether windows begin at each clip's trim_start, where the dance begins according to the source.
    ignore
        Names of lists whose clips are left out; "ignored.<protocol>" is then left out as well. "LAYER:LABEL" leaves
        out windows that overlap a segment of this layer and label, such as "mark:reject" of the viewer's marks.
    protocol
        Such as "cross_genre". If the store's clips are in lists of that name ("cross_genre.train"), these lists,
        and not the stored splits, define which clips `split` has.
    filter
        A window filter, or its name and parameters as in a recipe, ``{"movement": {"min_std": 0.07}}``; False:
        all windows are kept. Default: the preset's.
    start_at
        "downbeat" or "beat": windows begin there, at least a stride apart, instead of a stride after each other;
        only for a store of track scope. Clips without any are in `rejects` ("filtered"). The beats are those of
        the first of `fields` that has such a column, else of the first field of the store.
    relative_root
        Whether the translation columns are relative to the window's first frame. Such motion cannot be
        normalised: a scaler is fitted on absolute positions.
    primitive_n, primitive_variant
        Frames of a local segment; "paper" takes the clip's stored key motions, "code" what Lodge's released
        code finds in the window, shifted by a bias in -2 .. 2 that is a pure function of (seed, epoch, index).
    normalizer_covers_mirror, normalizer_covers
        A wider scaler than the stored one: its range covers mirrored motion, or these augmentations, as for
        `augment`. Every reader and command that meets the model's columns then needs that scaler by name.
    normalizer_over
        "train", or "all": every row of every clip, as Lodge's released scaler was fitted. It includes test
        data, and is here to reproduce Lodge's results.
    scaler
        A scaler of another reader, such as one that is wider: a normaliser, the file of its ``save``, either by
        field, or the reader itself. Default: the stored one of each field.
    clip
        Whether normalised values are cut to [-1, 1]. Default: as EDGE and Lodge do in their presets, unless
        samples are mirrored or augmented; else False, and values beyond come back whole.
    segments
        True: a sample has ``"segments"``, a list of the segments that its window overlaps (`PlacedSegment`), which
        `collate` keeps as a list. The name of a layer: it has ``"text"``, one text of that layer, drawn for each
        (seed, epoch, index); "" where there is none. Mirrored windows have the words of a mirrored dancer.
    min_share
        Share of a window that a segment covers at least if its text may be drawn.
    empty
        Share of windows with "" as their text, for guidance.
    mirror_words
        "error": a layer that may name sides and has no mirrored words cannot be read mirrored. "keep": its words are
        given as they are.
    columns
        Names of free columns, ``["x/level"]``: samples have their clip's value under that name, a list where the
        column holds lists; "" and nan where a clip has no text or number.
    where
        Clips to read, by values of columns, ``{"x/level": (3, 4), "genre": "waltz"}``: one of several values; of a
        column of lists, lists that have one of them; ``{"clip": IDS}`` are those clips. Others are in `rejects`
        ("filtered").
    mapped
        False: read by position, for files that may be overwritten in place, or file systems that map poorly.
    seed
        Whole number >= 0, for mirroring and the bias.

    Raises
    ------
    StoreError
        If there is no finished dataset at `store`.
    UsageError
        For an unknown split, field or preset, a probability outside [0, 1], a field that cannot be mirrored or
        augmented, or windows that this store cannot give.

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

    With "primitives" among the fields a sample also holds Lodge's ``"primitives"`` (K, 8, D), ``"primitive_start"``,
    ``"primitive_hard"`` and ``"primitive_filled"`` (K,); for windows of one local segment ``"primitives"`` (8, D)
    alone. With a field that has beats it holds the labels ``"beat"`` and ``"downbeat"``, (rows,) bool.

    ``samples([INDEX], EPOCH)`` is the sample of an "id" CLIP@START+LENGTH:CHANGES:SEED.EPOCH.INDEX. See
    docs/reading.md and docs/training.md.

    Examples
    --------
    >>> from dancedata.readers import WindowDataset
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
        fields: Sequence[str] | None = None,
        *,
        normalize: bool | Sequence[str] | None = None,
        mirror: float = 0.0,
        augment: Augment | None = None,
        preset: str | None = None,
        length_s: float | str | None = None,
        length_frames: int | None = None,
        stride_s: float | str | None = None,
        stride_frames: int | None = None,
        trim: bool | None = None,
        ignore: Sequence[str] | None = None,
        protocol: str | None = None,
        filter: FilterLike = None,
        start_at: StartAt | None = None,
        relative_root: bool | None = None,
        primitive_n: int = 256,
        primitive_variant: Literal["paper", "code"] = "paper",
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
        mapped: bool = True,
        seed: int = 0,
    ) -> None:
        super().__init__(store, split, fields, preset, protocol)
        lengths = {"length_s": length_s, "length_frames": length_frames}
        requested = {**lengths, "stride_s": stride_s, "stride_frames": stride_frames}
        filter_ = value_or_preset(filter, self._preset, "filter", None)
        start = require_start_at(start_at)
        windows = preset_windows(self._preset, requested)
        length = self.store.window_grid(**windows).length
        self._primitives: PrimitiveSpec | None = None
        if self._with_primitives:
            self._primitives = primitive_spec(self.store, self.fields, length, primitive_n, primitive_variant)
        also = self._primitives.key_motion if self._primitives is not None else None
        selection = self._select(windows, trim, ignore, filter_, start, where, also=also)
        self.windows, self.rejects = selection.windows, selection.rejects
        if not self.windows:
            raise no_window_error(self.store, self.split, self.rejects, start)
        changes = Changes(
            mirror=mirror, augment=augment, normalize=normalize, normalizer_covers_mirror=normalizer_covers_mirror,
            normalizer_covers=normalizer_covers, normalizer_over=normalizer_over, scaler=scaler, clip=clip, seed=seed,
            words=SegmentChoice(segments, min_share, empty, mirror_words), columns=columns,
        )  # fmt: skip
        self._prepare(changes)
        if start is not None and self._augmenter.crops:
            raise UsageError("start_at and the augmentation crop both choose windows", fix="leave one of them out")
        self._is_random |= self._with_primitives and primitive_variant == "code"
        if self._primitives is not None and self._primitives.field in self._normalizers:
            self._primitives.refuse_scaling(length)
        self.relative_root = value_or_preset(relative_root, self._preset, "relative_root", False)
        self._roots = root_columns(self.store, self.fields, self._normalizers) if self.relative_root else {}
        self.mapped = mapped
        self._stride = self.store.window_grid(**self._choice.windows).stride
        self._starts: dict[str, range] = {}
        self._cached_reader: BatchReader | None = None
        self._pool = MemoryPool()

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Return one window; negative indices count from the end.

        Raises
        ------
        IndexError
            For an index outside the split.
        """
        request, reader = self._request([index]), self._batch_reader()
        arrays = {name: np.empty((1, *shape), dtype=dtype) for name, (shape, dtype) in reader.layout.items()}
        reader(request, arrays)
        tensors = {name: torch.from_numpy(array[0]) for name, array in arrays.items()}
        return tensors | {name: values[0] for name, values in self._metadata(request).items()}

    @override
    def samples(self, indices: Sequence[int], epoch: int | None = None) -> list[dict[str, Any]]:
        """Return many windows, as of an epoch that is given here instead of by `set_epoch`.

        Their tensors are rows of one batch, which has its own memory.
        """
        request, reader = self._request(indices, epoch), self._batch_reader()
        if not len(request):
            return []
        tensors = {name: self._pool.tensor((len(request), *s), dtype) for name, (s, dtype) in reader.layout.items()}
        reader(request, {name: tensor.numpy() for name, tensor in tensors.items()})
        if get_worker_info() is not None:
            tensors = {name: shared_tensor(tensor.numpy()) for name, tensor in tensors.items()}
        batch, metadata = Batch.of(len(request), tensors), self._metadata(request)
        return [
            Sample({n: rows[nth] for n, rows in batch.rows.items()} | {k: v[nth] for k, v in metadata.items()}, batch)
            for nth in range(len(request))
        ]

    def __repr__(self) -> str:
        normalized = ", ".join(self._normalizers) or "nothing"
        steps = [(step.name, getattr(step.augmentation, "p", step.p)) for step in self._augmenter.steps]
        augment = "".join(f"; augment: {name}, p={p:g}" for name, p in steps)
        return (
            f"WindowDataset({str(self.store.path)!r}, split={self.split!r}, {len(self):,} windows, "
            f"fields: {', '.join(self.fields)}; normalised: {normalized}; mirror={self.mirror:g}{augment})"
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_cached_reader": None, "_pool": MemoryPool()}

    @property
    def unmapped(self) -> dict[str, str]:
        """By field, why it is not copied from mapped files; empty if all are."""
        return {field.name: field.rows.unmapped for field in self._batch_reader().fields if field.rows.unmapped}

    def _bias(self, place: int, epoch: int | None = None) -> int:
        """Return the shift, -2 .. 2 frames, of a sample's primitives in an epoch, or in the current one."""
        return primitive_bias(self.seed, self._drawn_epoch(epoch), place)

    def _request(self, indices: Sequence[int], epoch: int | None = None) -> Request:
        """Return the windows at some indices, and which of them are mirrored in an epoch, or in the current one."""
        epoch = self._drawn_epoch(epoch)
        places = tuple(self._place(index) for index in indices)
        mirrored = tuple(mirrored_samples(self.seed, epoch, places, self.mirror).tolist())
        shifts = tuple(self._shift(place, epoch) for place in places) if self._augmenter.crops else (0,) * len(places)
        return Request(places, mirrored, shifts, epoch)

    def _shift(self, place: int, epoch: int) -> int:
        """Return by how many frames the window that is read begins later than the listed one."""
        window = self.windows[place]
        if window.clip not in self._starts:
            trim = self._choice.trim
            self._starts[window.clip] = self.store.starts(window.clip, window.length, fields=self.fields, trim=trim)
        start = self._augmenter.start(window.start, self._starts[window.clip], self._stride, epoch, place)
        return start - window.start

    @property
    def _layout(self) -> Layout:
        return self._batch_reader().layout

    def _planned(self, indices: Sequence[int], epoch: int | None = None) -> ReadBatch:
        """Return a reader of the samples at some indices; random numbers are drawn now, files are read later."""
        request, reader = self._request(indices, epoch), self._batch_reader()

        def read(out: Mapping[str, Array]) -> dict[str, list[Any]]:
            reader(request, out)
            return self._metadata(request)

        return read

    def _batch_reader(self) -> BatchReader:
        """Return the reader of batches, which each process makes when it first needs it."""
        if self._cached_reader is None:
            rows = {name: self.store.window_rows(self.windows, name, mapped=self.mapped) for name in self.fields}
            fields = [
                FieldReader(n, rows[n], self._mirrors.get(n), self._roots.get(n), self._normalizers.get(n), self.clip)
                for n in self.fields
            ]
            for name, values in rows.items():
                if values.unmapped and self.mapped:
                    _log.warning("field %s is not read from mapped files: %s", name, values.unmapped)
            self._cached_reader = BatchReader(
                self.store,
                self.windows,
                fields,
                self._augmenter,
                self._primitives,
                self._bias,
                beat_labels(self.store, self.fields),
            )
        return self._cached_reader
