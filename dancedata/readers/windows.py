"""WindowDataset: the windows of a built dataset as a map-style torch dataset."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import index as as_int
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.utils.data import Dataset

from dancedata.core.clip import Window
from dancedata.core.columns import Mirror
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.normalize import MinMax
from dancedata.readers._checks import whole
from dancedata.store.dataset import Store, open_store

#: What is read where nothing else is asked for.
DEFAULT_FIELDS = ("edge151", "librosa35")
#: Keeps the stream that decides what is mirrored apart from EpochSampler's, which may have the same seed.
_MIRROR_STREAM = 2


@dataclass(frozen=True)
class Preset:
    """What one trainer reads: fields it cannot do without, fields it takes if there, frame rate, windows."""

    fields: tuple[str, ...]
    optional: tuple[str, ...]
    fps: int
    length_s: float
    stride_s: float


#: EDGE's own numbers: 5 s windows every 0.5 s at 30 frames a second (EDGE, Tseng et al. 2023, data/slice.py).
PRESETS = {"edge": Preset(("edge151",), ("librosa35",), fps=30, length_s=5, stride_s=0.5)}


class WindowDataset(Dataset[dict[str, Any]]):
    """Windows of one split, each a dict of tensors and metadata that torch's default collate can batch.

    ``dataset[i]`` is ``{field: tensor (rows, D), ..., "clip": id, "start": first frame in the clip at the
    store's fps, "length": frames, "split", "genre", "music", "dancer": str, "tempo_bpm": float (nan if
    unknown), "mirrored": bool, "index": int}``. Rows of a field are length * field rate / fps. Tensors have
    the stored dtype and are the caller's own; what is normalised is float32.

    Pickling copies no data: each process opens the files itself, so fork, spawn and forkserver all work.

    Notes
    -----
    *Normalising* is EDGE's: per column to [-1, 1] with the range of the train split, whatever the split
    read here, clipped. `normalizer` gives the same scaler for generated motion.

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
    """

    def __init__(
        self,
        store: str | Path | Store,
        split: str = "train",
        fields: Sequence[str] | None = None,
        *,
        normalize: bool | Sequence[str] = True,
        mirror: float = 0.0,
        preset: str | None = None,
        length_s: float | str | None = None,
        length_frames: int | None = None,
        stride_s: float | str | None = None,
        stride_frames: int | None = None,
        normalizer_covers_mirror: bool | None = None,
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
            Names of the fields to read. Default: the preset's, else edge151 and librosa35.
        normalize
            True: motion fields only. A sequence of field names: those. False: none.
        mirror
            Probability in [0, 1] that a sample is mirrored.
        preset
            "edge": edge151, librosa35 if stored, 5 s windows every 0.5 s at 30 frames a second. Arguments
            given beside it win.
        length_s, length_frames, stride_s, stride_frames
            Other windows than the stored ones; one of each at most; only for a store of track scope. They end
            where the clip ends, or the first of `fields` in it.
        normalizer_covers_mirror
            Whether the scaler's range covers mirrored motion too. Default: if mirror > 0. False keeps EDGE's.
        seed
            Whole number >= 0, for mirroring.

        Raises
        ------
        StoreError
            If there is no whole dataset at `store`.
        UsageError
            For an unknown split, field or preset, a probability outside [0, 1], a motion field that cannot be
            mirrored, or windows that this store cannot give.
        """
        self.store = store if isinstance(store, Store) else open_store(store)
        self.split = split
        self.preset = preset
        cuts: dict[str, Any] = {
            "length_s": length_s,
            "length_frames": length_frames,
            "stride_s": stride_s,
            "stride_frames": stride_frames,
        }
        if preset is not None:
            fields, cuts = _with_preset(self.store, preset, fields, cuts)
        self.fields = _field_names(self.store, DEFAULT_FIELDS if fields is None else fields)
        self.windows: Sequence[Window] = self.store.windows(split, fields=self.fields, **cuts)
        if not self.windows:
            longest = max(c.n_frames for c in self.store.clips if c.split == split)
            raise UsageError(
                f"split {split!r} has no window of that length",
                where=str(self.store.path),
                found=f"clips of at most {longest} frames at {self.store.fps} a second",
                fix="ask for shorter windows",
            )
        self.mirror = _probability(mirror)
        covers = self.mirror > 0 if normalizer_covers_mirror is None else normalizer_covers_mirror
        self.normalizer_covers_mirror = bool(covers)
        self.seed = whole("seed", seed)
        self._mirrors = _mirrors(self.store, self.fields) if self.mirror > 0 else {}
        self._normalizers = {
            name: _normalizer(self.store, name, self.normalizer_covers_mirror)
            for name in _normalized(self.store, self.fields, normalize)
        }
        self._epoch = _shared_number(0)
        self._coins: tuple[int, npt.NDArray[np.bool_]] | None = None

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
        place = self._place(index)
        return self._item(place, bool(self._mirrored()[place]) if self.mirror > 0 else False)

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Return many windows in the order asked for; torch's DataLoader calls this for a batch.

        Windows are read in the order they have in the files, whatever the order asked for.
        """
        places = [self._place(index) for index in indices]
        items: list[dict[str, Any]] = [{}] * len(places)
        coins = self._mirrored() if self.mirror > 0 else None
        for nth in sorted(range(len(places)), key=places.__getitem__):
            items[nth] = self._item(places[nth], coins is not None and bool(coins[places[nth]]))
        return items

    def __repr__(self) -> str:
        """Say what is read, and how."""
        normalized = ", ".join(self._normalizers) or "nothing"
        return (
            f"WindowDataset({str(self.store.path)!r}, split={self.split!r}, {len(self):,} windows, "
            f"fields: {', '.join(self.fields)}; normalised: {normalized}; mirror={self.mirror:g})"
        )

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what can be drawn again."""
        return {**self.__dict__, "_coins": None}

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
        return known if known is not None else _normalizer(self.store, field, self.normalizer_covers_mirror)

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

    def _item(self, place: int, mirrored: bool) -> dict[str, Any]:
        window = self.windows[place]
        item: dict[str, Any] = {name: torch.from_numpy(self._array(window, name, mirrored)) for name in self.fields}
        record = self.store.clip(window.clip).record
        item.update(
            clip=window.clip,
            start=int(window.start),
            length=int(window.length),
            split=self.split,
            genre=record.genre,
            music=record.music,
            dancer=record.dancer,
            tempo_bpm=math.nan if record.tempo_bpm is None else float(record.tempo_bpm),
            mirrored=mirrored,
            index=place,
        )
        return item

    def _array(self, window: Window, name: str, mirrored: bool) -> npt.NDArray[Any]:
        """Read one field of one window: mirrored first, then normalised."""
        rows: npt.NDArray[Any] = self.store.read(window, name)
        mirror = self._mirrors.get(name) if mirrored else None
        if mirror is not None:
            rows = mirror.apply(rows)
        scaler = self._normalizers.get(name)
        return rows if scaler is None else np.asarray(scaler.normalize(rows), dtype=np.float32)


def _shared_number(value: int) -> torch.Tensor:
    """Return a tensor (1,) int64 in memory that this process and its workers share."""
    number = torch.tensor([value], dtype=torch.int64)
    number.share_memory_()  # type: ignore[no-untyped-call]
    return number


def _with_preset(
    store: Store, name: str, fields: Sequence[str] | None, cuts: dict[str, Any]
) -> tuple[Sequence[str], dict[str, Any]]:
    """Fill in what a preset says and the caller did not."""
    preset = PRESETS.get(name)
    if preset is None:
        raise UsageError(f"there is no preset {name!r}", fix=did_you_mean(name, PRESETS))
    if store.fps != preset.fps:
        raise UsageError(
            f"preset {name!r} is for {preset.fps} frames a second",
            where=str(store.path),
            found=f"{store.fps} frames a second",
            fix=f"build with fps: {preset.fps}, or name fields and windows instead of a preset",
        )
    if fields is None:
        fields = (*preset.fields, *(field for field in preset.optional if field in store.fields))
    filled = dict(cuts)
    if cuts["length_s"] is None and cuts["length_frames"] is None:
        filled["length_s"] = preset.length_s
    if cuts["stride_s"] is None and cuts["stride_frames"] is None:
        filled["stride_s"] = preset.stride_s
    return fields, filled


def _field_names(store: Store, fields: Sequence[str]) -> tuple[str, ...]:
    """Check that the store has the fields, each named once."""
    names = (fields,) if isinstance(fields, str) else tuple(fields)
    if not names or len(set(names)) != len(names):
        raise UsageError("fields must name at least one field, each once", found=", ".join(names) or "none")
    for name in names:
        store.field(name)
    return names


def _normalized(store: Store, fields: tuple[str, ...], normalize: bool | Sequence[str]) -> tuple[str, ...]:
    """Return the fields to normalise."""
    if isinstance(normalize, bool):
        return tuple(name for name in fields if normalize and store.field(name).kind == "motion")
    wanted = (normalize,) if isinstance(normalize, str) else tuple(normalize)
    for name in wanted:
        if name not in fields:
            raise UsageError(
                f"normalize names a field that is not read: {name!r}",
                allowed=", ".join(fields),
                fix=did_you_mean(name, fields),
            )
    return wanted


def _mirrors(store: Store, fields: tuple[str, ...]) -> dict[str, Mirror]:
    """Return the mirror of every motion field; audio has none and is left as it is."""
    found: dict[str, Mirror] = {}
    for field in map(store.field, fields):
        if field.kind == "motion":
            if field.columns.mirror is None:
                raise _no_mirror(store, field.name)
            found[field.name] = field.columns.mirror
    return found


def _normalizer(store: Store, name: str, covers_mirror: bool) -> MinMax:
    """Return the train split's scaler, for motion with the mirrored range if wanted."""
    field = store.field(name)
    covers = covers_mirror and field.kind == "motion"
    if covers and field.columns.mirror is None:
        raise _no_mirror(store, name)
    return store.normalizer(name, mirror=covers)


def _no_mirror(store: Store, field: str) -> UsageError:
    return UsageError(
        f"field {field!r} cannot be mirrored: its columns name no mirror image",
        where=str(store.path),
        fix="read it with mirror=0 (and normalizer_covers_mirror=False), or leave the field out",
    )


def _probability(mirror: float) -> float:
    value = float(mirror)
    if not 0.0 <= value <= 1.0:
        raise UsageError("mirror is a probability", found=mirror, allowed="0 to 1")
    return value
