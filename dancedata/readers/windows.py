"""WindowDataset: the windows of a built dataset as a map-style torch dataset."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from operator import index as as_int
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch.utils.data import Dataset, get_worker_info

from dancedata.core.clip import Reject
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.normalize import MinMax
from dancedata.core.plugins import WindowFilter
from dancedata.readers._checks import whole
from dancedata.readers.batch_fill import FieldFill, Fill, Request
from dancedata.readers.batch_memory import Pool, shared_tensor
from dancedata.readers.collate import Batch, Sample, collate
from dancedata.readers.metadata import metadata
from dancedata.readers.presets import NO_FIELDS, Preset, field_names, find_preset, preset_cut, preset_fields
from dancedata.readers.primitives import PRIMITIVES, Cues, cues_of
from dancedata.readers.scalers import mirrors_of, normalized_fields, scaler_of
from dancedata.readers.selection import Choice, require_protocol, select, window_filter
from dancedata.store.dataset import Store, open_store, reopen

#: What is read where nothing else is asked for.
DEFAULT_FIELDS = ("edge151", "librosa35")
#: Keep the streams that decide what is mirrored, and how primitives are shifted, apart from EpochSampler's,
#: which may have the same seed.
_MIRROR_STREAM = 2
_BIAS_STREAM = 3

_log = logging.getLogger(__name__)


class WindowDataset(Dataset[dict[str, Any]]):
    """Windows of one split, each a dict of tensors and metadata that torch's default collate can batch.

    ``dataset[i]`` is ``{field: tensor (rows, D), ..., "clip": id, "start": first frame in the clip at the
    store's fps, "length": frames, "split", "genre", "music", "dancer": str, "genre_id": int (-1 if the dataset
    numbers no genres), "tempo_bpm": float (nan if unknown), "mirrored": bool, "index": int}``. Rows of a field are
    length * field rate / fps. Tensors have the stored dtype and are the caller's own; what is normalised is
    float32.

    Pickling copies no data: each process opens the files itself, so fork, spawn and forkserver all work.

    Notes
    -----
    *Normalising* is EDGE's: per column to [-1, 1] with the range of the train split, whatever the split
    read here, clipped. `normalizer` gives the same scaler for generated motion.

    *Choosing windows.* What was left out, and why, is in `rejects`: clips on an ignored list ("ignored") or
    shorter than a window ("too_short"), windows that hardly move ("still").

    *Primitives.* With "primitives" among the fields a sample also holds Lodge's cues of the first motion field:
    ``"primitives"`` (K, 8, D), ``"primitive_start"``, ``"primitive_hard"``, ``"primitive_filled"`` (K,) for windows
    of several local segments, and ``"primitives"`` (8, D), the 4 + 4 border frames, for windows of one. They are
    mirrored and normalised as the field is.

    *Mirroring* comes before normalising. Whether a sample is mirrored is a pure function of (seed, epoch,
    index): the same in every worker, on every rank, and after a resume. Audio is never changed by it. The
    scaler's range then covers x and mirror(x), as half of what the model sees lies in the mirrored range.
    Val and test sets of a model trained so want the same scaler but no mirroring: ``WindowDataset(out,
    split="val", normalizer_covers_mirror=True)``.

    *Epochs.* `set_epoch` writes to a number in shared memory, which forked, spawned and persistent workers
    all see: call it before ``iter(loader)``, as with torch's DistributedSampler. An `EpochSampler` made
    with this dataset does it by itself. Changed in the middle of an epoch, batches already prefetched keep
    the old epoch. A copy made with pickle or copy.deepcopy, outside torch's own workers, has an epoch of
    its own.

    *Batches.* A DataLoader reads a batch at once, into memory that becomes the batch: samples that come from
    ``__getitems__`` are its rows, and torch's default collate, or `collate`, gives it back without a copy. Samples
    and batch then share memory. `BatchLoader` is faster still.

    *Mapped files.* Rows are copied from mapped shards. Where a shard cannot be mapped, they are read by position or
    through h5py; `unmapped` says why, and a warning is logged. A mapped file must not be overwritten in place
    while it is read; builds never do.
    """

    #: For ``DataLoader(collate_fn=...)``; default_collate does the same with what this dataset gives.
    collate = staticmethod(collate)

    def __init__(
        self,
        store: str | Path | Store,
        split: str = "train",
        fields: Sequence[str] | None = None,
        *,
        normalize: bool | Sequence[str] | None = None,
        mirror: float = 0.0,
        preset: str | None = None,
        length_s: float | str | None = None,
        length_frames: int | None = None,
        stride_s: float | str | None = None,
        stride_frames: int | None = None,
        trim: bool | None = None,
        ignore: Sequence[str] | None = None,
        protocol: str | None = None,
        filter: WindowFilter | Mapping[str, Any] | Literal[False] | None = None,
        relative_root: bool | None = None,
        primitive_n: int = 256,
        primitive_variant: Literal["paper", "code"] = "paper",
        normalizer_covers_mirror: bool | None = None,
        normalizer_over: Literal["train", "all"] = "train",
        mapped: bool = True,
        seed: int = 0,
    ) -> None:
        """Open a split of a built dataset.

        Parameters
        ----------
        store
            The built dataset's folder, or what `dancedata.open` gave.
        split
            One of ``store.splits``.
        fields
            Names of the fields to read, and "primitives" if wanted. Default: the preset's, else edge151 and
            librosa35.
        normalize
            True: motion fields only. A sequence of field names: those. False: none. Default: the preset's, else
            True.
        mirror
            Probability in [0, 1] that a sample is mirrored.
        preset
            "edge", "lodge-global", "lodge-local" or "finenet": fields, windows, trim, lists, filter and root as
            that trainer has them. Arguments given beside it win.
        length_s, length_frames, stride_s, stride_frames
            Other windows than the stored ones; one of each at most; only for a store of track scope. They end
            where the clip ends, or the first of `fields` in it.
        trim
            Whether windows begin where the source says that the dance does (a clip's trim_start).
        ignore
            Names of lists whose clips are left out; "ignored.<protocol>" is then left out as well.
        protocol
            Such as "cross_genre": where the store's clips are in lists of that name ("cross_genre.train"), they and
            not the stored splits say which clips `split` has.
        filter
            A window filter, or its name and parameters as in a recipe, ``{"movement": {"min_std": 0.07}}``; False:
            all windows are kept. Default: the preset's.
        relative_root
            Whether the translation columns are relative to the window's first frame. Such motion cannot be
            normalised: a scaler is fitted on places in the room.
        primitive_n, primitive_variant
            Frames of a local segment; "paper" takes the clip's stored key motions, "code" what Lodge's released
            code finds in the window, shifted by a bias in -2 .. 2 that is a pure function of (seed, epoch, index).
        normalizer_covers_mirror
            Whether the scaler's range covers mirrored motion too. Default: if mirror > 0. False keeps EDGE's.
        normalizer_over
            "train", or "all": every row of every clip, as Lodge's released scaler was fitted. Wrong for a fair test;
            here to reproduce it.
        mapped
            False: read by position, where files may be overwritten in place or a file system maps badly.
        seed
            Whole number >= 0, for mirroring and the bias.

        Raises
        ------
        StoreError
            If there is no whole dataset at `store`.
        UsageError
            For an unknown split, field or preset, a probability outside [0, 1], a motion field that cannot be
            mirrored, or windows that this store cannot give.
        """
        self._store: Store | None = store if isinstance(store, Store) else open_store(store)
        self._reference = self._store.reference
        self.split = split
        self.preset = preset
        known = find_preset(self.store, preset)
        if protocol is not None:
            require_protocol(self.store, protocol)
        cut = {
            "length_s": length_s,
            "length_frames": length_frames,
            "stride_s": stride_s,
            "stride_frames": stride_frames,
        }
        self.fields, with_primitives = _fields(self.store, known, fields, preset)
        self._choice = Choice(
            fields=self.fields,
            cut=preset_cut(known, cut),
            trim=_given(trim, known, "trim", False),
            ignore=tuple(_given(ignore, known, "ignore", ())),
            protocol=_given(protocol, known, "protocol", None),
            filter=window_filter(_given(filter, known, "filter", None)),
        )
        selection = select(self.store, split, self._choice)
        self.windows = selection.windows
        self.rejects: tuple[Reject, ...] = selection.rejects
        if not self.windows:
            raise _no_window(self.store, split, self.rejects)
        self._cues: Cues | None = None
        if with_primitives:
            length = self.windows[0].length
            self._cues = cues_of(self.store, self.fields, length, primitive_n, primitive_variant)
        self.mirror = _probability(mirror)
        covers = self.mirror > 0 if normalizer_covers_mirror is None else normalizer_covers_mirror
        self.normalizer_covers_mirror = bool(covers)
        self.normalizer_over = normalizer_over
        self.seed = whole("seed", seed)
        self._mirrors = mirrors_of(self.store, self.fields) if self.mirror > 0 else {}
        wanted = _given(normalize, known, "normalize", True)
        self._normalizers = {name: self._scaler(name) for name in normalized_fields(self.store, self.fields, wanted)}
        if self._cues is not None and self._cues.field in self._normalizers:
            self._cues.refuse_scaling(self.windows[0].length)
        self.relative_root = _given(relative_root, known, "relative_root", False)
        self._roots = _root_columns(self.store, self.fields, self._normalizers) if self.relative_root else {}
        self._epoch = _shared_number(0)
        self.mapped = mapped
        self._coins: tuple[int, npt.NDArray[np.bool_]] | None = None
        self._reader: Fill | None = None
        self._pool = Pool()

    @property
    def store(self) -> Store:
        """The built dataset; opened anew in every process that this was sent to.

        Raises
        ------
        StoreError
            If another dataset was built in its place meanwhile.
        """
        if self._store is None:
            self._store = reopen(*self._reference)
        return self._store

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.windows)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Return one window; negative indices count from the end.

        Raises
        ------
        IndexError
            For an index outside the split.
        """
        request, fill = self._request([index]), self._fill()
        arrays = {name: np.empty((1, *shape), dtype=dtype) for name, (shape, dtype) in fill.layout.items()}
        fill(request, arrays)
        said = self._metadata(request)
        return {name: torch.from_numpy(array[0]) for name, array in arrays.items()} | {
            k: v[0] for k, v in said.items()
        }

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Return many windows in the order asked for; torch's DataLoader calls this for a batch.

        Their tensors are rows of one batch, which is memory of its own. Windows are read in the order they have in
        the files, whatever the order asked for.
        """
        request, fill = self._request(indices), self._fill()
        if not len(request):
            return []
        tensors = {name: self._pool.tensor((len(request), *s), dtype) for name, (s, dtype) in fill.layout.items()}
        fill(request, {name: tensor.numpy() for name, tensor in tensors.items()})
        if get_worker_info() is not None:
            tensors = {name: shared_tensor(tensor.numpy()) for name, tensor in tensors.items()}
        batch, said = Batch.of(len(request), tensors), self._metadata(request)
        return [
            Sample({n: rows[nth] for n, rows in batch.rows.items()} | {k: v[nth] for k, v in said.items()}, batch)
            for nth in range(len(request))
        ]

    def __repr__(self) -> str:
        """Say what is read, and how."""
        normalized = ", ".join(self._normalizers) or "nothing"
        return (
            f"WindowDataset({str(self.store.path)!r}, split={self.split!r}, {len(self):,} windows, "
            f"fields: {', '.join(self.fields)}; normalised: {normalized}; mirror={self.mirror:g})"
        )

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what can be drawn again, memory, and the open store.

        A store that cannot be opened again is then an error of the first batch, which a DataLoader passes on, and
        not the end of its worker.
        """
        return {**self.__dict__, "_coins": None, "_reader": None, "_pool": Pool(), "_store": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the state over, with an epoch that workers can share."""
        self.__dict__.update(state)
        # torch's own workers are handed the shared number itself; any other copy gets one of its own, which
        # must be shared as well in case workers are started from it.
        if not self._epoch.is_shared():  # type: ignore[no-untyped-call]
            self._epoch = _shared_number(self.epoch)

    @property
    def epoch(self) -> int:
        """The epoch that decides what is mirrored."""
        return int(self._epoch.item())

    def set_epoch(self, epoch: int) -> None:
        """Say which epoch begins, here and in all workers; see the class's notes.

        Raises
        ------
        UsageError
            For a negative epoch.
        """
        self._epoch.fill_(whole("epoch", epoch))

    @property
    def unmapped(self) -> dict[str, str]:
        """Why fields are not copied from mapped files, by name; empty if all are."""
        return {field.name: field.rows.unmapped for field in self._fill().fields if field.rows.unmapped}

    def normalizer(self, field: str) -> MinMax:
        """Return the scaler that a field of this dataset is normalised with.

        For a field that is read as it is, it is the scaler that ``normalize=(field,)`` would use.

        Raises
        ------
        UsageError
            For a field that this dataset does not read.
        """
        if field not in self.fields:
            raise UsageError(
                f"this dataset reads no field {field!r}",
                allowed=", ".join(self.fields),
                fix=did_you_mean(field, self.fields),
            )
        known = self._normalizers.get(field)
        return known if known is not None else self._scaler(field)

    def _scaler(self, field: str) -> MinMax:
        covers = self.normalizer_covers_mirror
        return scaler_of(self.store, field, self._choice, covers_mirror=covers, over=self.normalizer_over)

    def _place(self, index: int) -> int:
        place = as_int(index)
        if place < 0:
            place += len(self.windows)
        if not 0 <= place < len(self.windows):
            raise IndexError(f"window {index} of split {self.split!r}, which has {len(self.windows)} windows")
        return place

    def _mirrored(self) -> npt.NDArray[np.bool_]:
        """Return which windows are mirrored in the current epoch, (windows,) bool; drawn once an epoch."""
        epoch = self.epoch
        if self._coins is None or self._coins[0] != epoch:
            stream = np.random.Philox(np.random.SeedSequence(self.seed, spawn_key=(_MIRROR_STREAM, epoch)))
            # Raw bits, not Generator.random: numpy promises to keep bit streams, not algorithms. 53 bits make
            # a float64 in [0, 1), so that 0 mirrors none and 1 all.
            uniform = (stream.random_raw(len(self.windows)) >> np.uint64(11)) * 2.0**-53
            self._coins = epoch, uniform < self.mirror
        return self._coins[1]

    def _bias(self, place: int, epoch: int | None = None) -> int:
        """Return the shift, -2 .. 2 frames, of a sample's primitives in an epoch, or in the current one."""
        epoch = self.epoch if epoch is None else epoch
        stream = np.random.Philox(np.random.SeedSequence(self.seed, spawn_key=(_BIAS_STREAM, epoch, place)))
        return int(stream.random_raw() % 5) - 2

    def _request(self, indices: Sequence[int]) -> Request:
        """Say which windows an epoch's samples are, and which of them are mirrored."""
        places = tuple(self._place(index) for index in indices)
        coins = self._mirrored() if self.mirror > 0 else None
        mirrored = tuple(coins is not None and bool(coins[place]) for place in places)
        return Request(places, mirrored, self.epoch)

    def _metadata(self, request: Request) -> dict[str, list[Any]]:
        return metadata(self.store, self.windows, self.split, request.places, request.mirrored)

    def _fill(self) -> Fill:
        """Return what reads batches, made when first needed, in each process."""
        if self._reader is None:
            rows = {name: self.store.window_rows(self.windows, name, mapped=self.mapped) for name in self.fields}
            fields = [
                FieldFill(n, rows[n], self._mirrors.get(n), self._roots.get(n), self._normalizers.get(n))
                for n in self.fields
            ]
            for name, found in rows.items():
                if found.unmapped and self.mapped:
                    _log.warning("field %s is not read from mapped files: %s", name, found.unmapped)
            self._reader = Fill(self.store, self.windows, fields, self._cues, self._bias)
        return self._reader


def _given(value: Any, preset: Preset | None, name: str, default: Any) -> Any:
    """Return what the caller gave, else the preset's, else the default."""
    if value is not None:
        return value
    return default if preset is None else getattr(preset, name)


def _fields(
    store: Store, preset: Preset | None, fields: Sequence[str] | None, preset_name: str | None
) -> tuple[tuple[str, ...], bool]:
    """Return the stored fields to read, and whether primitives are wanted beside them."""
    default = DEFAULT_FIELDS if preset is None else preset_fields(store, preset)
    given = default if fields is None else (fields,) if isinstance(fields, str) else tuple(fields)
    with_primitives = PRIMITIVES in given and PRIMITIVES not in store.fields
    wanted = tuple(name for name in given if not (with_primitives and name == PRIMITIVES))
    named = (preset_name or NO_FIELDS) if fields is None or not wanted else None
    return field_names(store, wanted or (preset.fields if preset is not None else wanted), named), with_primitives


def _root_columns(store: Store, fields: tuple[str, ...], normalizers: Mapping[str, MinMax]) -> dict[str, slice]:
    """Return the columns of the root's translation of every motion field."""
    found = {}
    for name in fields:
        if store.field(name).kind != "motion":
            continue
        if "translation" not in store.fields[name].names:
            raise UsageError(f"field {name!r} has no translation to make relative", where=str(store.path))
        if name in normalizers:
            raise UsageError(
                "a root that is relative to its window's first frame cannot be normalised: the scaler was fitted on "
                "places in the room",
                fix="pass normalize=False, or relative_root=False",
            )
        found[name] = store.fields[name].slice("translation")
    return found


def _no_window(store: Store, split: str, rejects: Sequence[Reject]) -> UsageError:
    longest = max((c.n_frames for c in store.clips), default=0)
    reasons = ", ".join(sorted({r.reason for r in rejects})) or "nothing"
    return UsageError(
        f"split {split!r} has no window of that length",
        where=str(store.path),
        found=f"clips of at most {longest} frames at {store.fps} a second; left out: {reasons}",
        fix="ask for shorter windows, or for fewer lists and filters",
    )


def _shared_number(value: int) -> torch.Tensor:
    """Return a tensor (1,) int64 in memory that this process and its workers share."""
    number = torch.tensor([value], dtype=torch.int64)
    number.share_memory_()  # type: ignore[no-untyped-call]
    return number


def _probability(mirror: float) -> float:
    if not isinstance(mirror, int | float) or not 0.0 <= mirror <= 1.0:
        raise UsageError("mirror is a probability", found=mirror, allowed="0 to 1")
    return float(mirror)
