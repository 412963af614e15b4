"""BatchReader: copies windows into the arrays of a batch, and mirrors, augments and scales them there, in place.

One window, the batch of a DataLoader and the batch of a BatchLoader are all read here, so they are equal bit for bit.
"""

import math
import operator
import os
import weakref
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt
import torch

from dancedata.core.columns import Mirror
from dancedata.core.plugins import PRIMITIVES
from dancedata.core.system import memory_file
from dancedata.store.dataset import Store
from dancedata.store.normalize import Scaler
from dancedata.store.shard_reader import WindowRows
from dancedata.torch.music_beats import LABELS, BeatLabels
from dancedata.torch.sample_changes import SampleChanges

if TYPE_CHECKING:
    from dancedata.torch.primitives import PrimitiveSpec

Array = npt.NDArray[Any]
#: Shape and type of every array of one sample.
Layout = Mapping[str, tuple[tuple[int, ...], np.dtype[Any]]]
#: Reads a batch into arrays (B, ...) by name, and returns the other values of its samples, (B,) each by name.
ReadBatch = Callable[[Mapping[str, Array]], dict[str, list[Any]]]
#: An operation in place, and its operand.
_Step: TypeAlias = tuple[Callable[[Any, Any], Any], Array]
_IN_PLACE: Mapping[Callable[[Any, Any], Any], Callable[[Any, Any], Any]] = {
    operator.mul: operator.imul, operator.add: operator.iadd, operator.sub: operator.isub,
    operator.truediv: operator.itruediv,
}  # fmt: skip
#: Smaller arrays come from the allocator, which reuses small pieces itself.
_LARGE = 1 << 20


class MemoryPool:
    """Tensors whose memory is reused once they, and all tensors and arrays that share it, are gone; thread-safe."""

    def __init__(self, max_idle: int = 8) -> None:
        """Make an empty pool, which keeps up to `max_idle` unused pieces: by default two batches of four fields."""
        # A deque, not a list with a lock: memory is returned whenever a tensor is freed, in any thread, even while
        # this object is in use.
        self._idle: deque[npt.NDArray[np.uint8]] = deque(maxlen=max_idle)

    def tensor(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> torch.Tensor:
        """Return an uninitialised tensor."""
        n_bytes = math.prod(shape) * dtype.itemsize
        if n_bytes < _LARGE:
            return torch.from_numpy(np.empty(shape, dtype=dtype))
        memory = self._take(n_bytes)
        # Only the tensor keeps this array alive: when it is freed, the memory is idle.
        array = memory.view(dtype).reshape(shape)
        weakref.finalize(array, self._idle.append, memory).atexit = False
        return torch.from_numpy(array)

    def _take(self, n_bytes: int) -> npt.NDArray[np.uint8]:
        for _ in range(len(self._idle)):
            try:
                memory = self._idle.popleft()
            except IndexError:
                break
            if memory.nbytes == n_bytes:
                return memory
            self._idle.append(memory)
        # numpy asks for huge pages, where the system has them.
        return np.empty(n_bytes, dtype=np.uint8)


def shared_tensor(array: npt.NDArray[Any]) -> torch.Tensor:
    """Return a copy of an array that a DataLoader's worker can send to the trainer without another copy."""
    # A file in memory, not mapped memory, whose pages the system would clear first, which takes longer than the copy.
    storage = _in_memory_file(array) if array.size else None
    if storage is None:
        return torch.from_numpy(array).clone().share_memory_()  # type: ignore[no-untyped-call, no-any-return]
    kind = torch.from_numpy(np.empty(0, dtype=array.dtype)).dtype
    return torch.empty(0, dtype=kind).set_(storage, 0, array.shape)  # type: ignore[call-overload, no-any-return]


def _in_memory_file(array: npt.NDArray[Any]) -> torch.UntypedStorage | None:
    """Copy an array into a file in memory, mapped as torch shares memory; None where that is impossible."""
    # A private function of torch, which a process that receives a tensor calls; it may change.
    map_shared = getattr(torch.UntypedStorage, "_new_shared_fd_cpu", None)
    descriptor = None if map_shared is None else memory_file("dancedata-batch")
    if map_shared is None or descriptor is None:
        return None
    try:
        unwritten = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
        while unwritten.nbytes:
            unwritten = unwritten[os.write(descriptor, unwritten) :]
        storage: torch.UntypedStorage = map_shared(descriptor, array.nbytes)  # which duplicates the descriptor
    except (OSError, RuntimeError, TypeError):
        return None
    finally:
        os.close(descriptor)
    return storage


@dataclass(frozen=True)
class BatchPlan:
    """A batch: places in the dataset's windows, whether mirrored, frames by which each begins later, the epoch."""

    places: tuple[int, ...]
    mirrored: tuple[bool, ...]
    shifts: tuple[int, ...]
    epoch: int

    def __len__(self) -> int:
        return len(self.places)


@dataclass(frozen=True)
class FieldReader:
    """Reads one field."""

    name: str
    rows: WindowRows
    period: tuple[int, int]  # frames of the dataset and rows of the field that take the same time
    mirror: Mirror | None = None  # applied to mirrored windows; None for audio
    root: slice | None = None  # columns that become relative to a window's first row
    scaler: Scaler | None = None  # applied last; the result is float32
    clamp: bool = False  # whether scaled values are cut to [-1, 1]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the field in a batch."""
        return np.dtype(np.float32) if self.scaler is not None else self.rows.dtype

    def read(self, place: int, shift: int, mirrored: bool, out: Array) -> None:
        """Read one window, or its mirror image, moved by `shift` frames, into `out`, (rows, D) of the stored type."""
        rows = self.rows.read(place, out, shift // self.period[0] * self.period[1])
        image = self._image if mirrored else None
        if image is not None:
            rows = rows.copy() if rows is out else rows
            # With mode "raise" numpy would work on a copy of `out`.
            np.take(rows.reshape(-1), image[0], out=out, mode="clip")
            out *= image[1]
        elif rows is not out:
            np.copyto(out, rows)

    def make_relative(self, rows: Array) -> None:
        """Make the root of rows, (L, D), relative to the first row, in place."""
        if self.root is not None:
            rows[:, self.root] -= rows[:1, self.root].copy()

    def scale(self, rows: Array) -> Array:
        """Scale rows, (..., D) of the stored type; as `Scaler.normalize` does, operation by operation.

        In place, except for half precision, whose arithmetic is float32.
        """
        if self.scaler is None:
            return rows
        rows = rows.astype(self._arithmetic, copy=False)
        for operation, operand in self._whole_window if rows.shape == self.rows.shape else self._row:
            rows = operation(rows, operand)
        return rows.clip(-1, 1, out=rows) if self.clamp else rows

    # Operations on columns take half the time where the operands have the shape of a window.

    @cached_property
    def _image(self) -> tuple[npt.NDArray[np.intp], Array] | None:
        """Position in the window of each value of the mirrored window, and its sign, (rows, D) each."""
        if self.mirror is None:
            return None
        n_rows, width = self.rows.shape
        source = np.arange(n_rows)[:, None] * width + np.array(self.mirror.permutation, dtype=np.intp)
        return source, np.tile(np.array(self.mirror.signs, dtype=self.rows.dtype), (n_rows, 1))

    @cached_property
    def _row(self) -> tuple[_Step, ...]:
        steps = () if self.scaler is None else self.scaler.steps
        return tuple((_IN_PLACE[operation], operand.astype(self._arithmetic)) for operation, operand in steps)

    @property
    def _arithmetic(self) -> np.dtype[Any]:
        return np.promote_types(self.rows.dtype, np.float32)

    @cached_property
    def _whole_window(self) -> tuple[_Step, ...]:
        return tuple((operation, np.tile(row, (self.rows.shape[0], 1))) for operation, row in self._row)


def blank_of(store: Store, name: str) -> int:
    """Return the value of masked rows and of rows of absent dancers: 0, or the pad of a codebook."""
    codebook = store.field(name).codebook
    return 0 if codebook is None else codebook.pad


class BatchReader:
    """Reads batches of windows into arrays. Reading changes no state, so any number of threads may use it."""

    def __init__(
        self,
        store: Store,
        fields: Sequence[FieldReader],
        augmenter: SampleChanges,
        labels: BeatLabels | None = None,
        primitives: "PrimitiveSpec | None" = None,
        keys: FieldReader | None = None,
        bias: Callable[[int, int], int] = lambda place, epoch: 0,
    ) -> None:
        """Prepare; `keys` reads the key motions of primitives, `bias` returns their shift for (place, epoch)."""
        self._store, self.fields, self._augmenter, self._labels = store, tuple(fields), augmenter, labels
        self._primitives, self._keys, self._bias = primitives, keys, bias

    @cached_property
    def layout(self) -> Layout:
        """Shape and type of every array of one sample, in a sample's order."""
        layouts: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}
        for field in self.fields:
            if self._primitives is not None and field.name == self._primitives.field:
                rows = np.empty(field.rows.shape, dtype=field.rows.dtype)
                field.read(0, 0, False, rows)
                arrays = self._primitives.of(rows, 0, self._key_rows(0, 0))
                layouts.update({name: (value.shape, value.dtype) for name, value in arrays.items()})
                layouts[PRIMITIVES] = arrays[PRIMITIVES].shape, field.dtype
            if self._labels is not None and field.name == self._labels.field:
                layouts.update({label: (field.rows.shape[:1], np.dtype(np.bool_)) for label in LABELS})
            layouts[field.name] = field.rows.shape, field.dtype
        return layouts

    def read_ahead(self, places: Sequence[int]) -> None:
        """Ask for the rows of the windows at `places`, in their order; returns at once."""
        for field in self.fields:
            # A window that is moved has the pages of its neighbours.
            field.rows.read_ahead(places)

    def require_unchanged(self, places: Sequence[int], *, again: bool = False) -> None:
        """Raise StoreError if files of the windows were written to; see `WindowRows.require_unchanged`."""
        self.fields[0].rows.require_unchanged(places, again=again)

    def __call__(self, plan: BatchPlan, out: Mapping[str, Array]) -> None:
        """Read windows into `out`, an array (B, *shape) for each name in `layout`, in the order of the files."""
        self.require_unchanged(plan.places, again=True)
        order = sorted(range(len(plan)), key=plan.places.__getitem__)
        self.read_ahead([plan.places[nth] for nth in order])
        self.read(plan, order, out)
        self.require_unchanged(plan.places)
        for nth, place in enumerate(plan.places):
            for name in self._augmenter.dropped(plan.epoch, place):
                out[name][nth] = blank_of(self._store, name)

    def read(self, plan: BatchPlan, order: Sequence[int], out: Mapping[str, Array]) -> None:
        """Read all fields of the windows; `order` is that of their places in the files."""
        for field in self.fields:
            self.read_field(field, plan, order, out)

    def read_field(self, field: FieldReader, plan: BatchPlan, order: Sequence[int], out: Mapping[str, Array]) -> None:
        """Read a field: each window into its row of the batch, or into scratch memory if the types differ."""
        target, stored = out[field.name], field.rows.dtype
        scratch = None if target.dtype == stored else np.empty(field.rows.shape, dtype=stored)
        for nth in order:
            place, shift = plan.places[nth], plan.shifts[nth]
            rows = target[nth] if scratch is None else scratch
            field.read(place, shift, plan.mirrored[nth], rows)
            changed = self._augmenter.rows(field.name, rows, plan.epoch, place)
            if changed is not rows:
                rows[...] = changed
            field.make_relative(rows)
            if self._primitives is not None and field.name == self._primitives.field:
                keys, bias = self._key_rows(place, shift), self._bias(place, plan.epoch)
                primitives = self._primitives.of(rows, bias, keys)
                primitives[PRIMITIVES] = field.scale(primitives[PRIMITIVES])
                for name, value in primitives.items():
                    out[name][nth] = value
            if self._labels is not None and field.name == self._labels.field:
                for label, values in self._labels.of(rows).items():
                    out[label][nth] = values
            scaled = field.scale(rows)
            if scaled is not rows or target.dtype != rows.dtype:
                target[nth] = scaled

    def _key_rows(self, place: int, shift: int) -> Array | None:
        if self._keys is None:
            return None
        rows = np.empty(self._keys.rows.shape, dtype=self._keys.rows.dtype)
        self._keys.read(place, shift, False, rows)
        return rows
