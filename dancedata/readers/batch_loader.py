"""BatchLoader: batches by threads, from mapped files straight into memory that is used again."""

from __future__ import annotations

import logging
import os
import weakref
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch.utils.data import BatchSampler, SequentialSampler, default_collate

from dancedata.core.errors import UsageError
from dancedata.readers._checks import whole
from dancedata.readers.fill import Fill, Request
from dancedata.readers.memory import Pool
from dancedata.readers.sampler import EpochSampler
from dancedata.readers.windows import WindowDataset

_log = logging.getLogger(__name__)

#: One batch's memory: a tensor (batch_size, ...) by name.
Buffer = dict[str, torch.Tensor]


class BatchLoader:
    """Batches of a `WindowDataset`, equal bit for bit to those of a DataLoader with the same sampler, and faster.

    Threads copy windows from the mapped shards into a ring of buffers, and mirror and normalise them there. Nothing
    goes through another process, and no memory is touched for the first time after the first few batches::

        loader = BatchLoader(train, 64, sampler=EpochSampler(train, seed=0))
        for epoch in range(n):
            for batch in loader:
                ...

    A batch is a dict as torch's default collate makes it: a tensor (B, rows, D) per field, tensors and lists of what
    else a sample says.

    Attributes
    ----------
    dataset, sampler, batch_size, drop_last, threads, prefetch, ring, copy
        As given; `sampler` is the one made if none was given.
    pinned
        Whether batches lie in pinned memory.

    Notes
    -----
    *Batches are overwritten.* The tensors of a batch are valid until `ring` further batches have been asked for:
    with ``ring=2`` a batch lives on while the next one is in use. Who keeps batches longer, or calls
    ``list(loader)``, passes ``copy=True``: then each batch is the caller's own, and its memory is used again once
    no tensor refers to it.

    *Copies to a GPU* with ``non_blocking=True`` must have finished before `ring` further batches are asked for. A
    training step that reads its loss has seen to that; with ``copy=True`` torch sees to it.

    *Order and resuming* are the sampler's. Batches are asked of it `prefetch` ahead, as by a DataLoader with workers:
    in the middle of an epoch the state is ``sampler.at(epoch, consumed)``.

    *Ranks.* An `EpochSampler` gives each its share: `rank` and `world_size`, or torch.distributed's.

    *Threads and processes.* One iteration at a time: starting another ends the one before, which then raises an
    error. Leaving a loop early stops the threads. An error in a thread is raised where the loop asks for that batch.
    Threads do not live on in a forked process: iterate anew there. Pickling leaves buffers and threads out.
    """

    def __init__(
        self,
        dataset: WindowDataset,
        batch_size: int = 1,
        *,
        sampler: Iterable[int] | None = None,
        shuffle: bool = False,
        drop_last: bool = False,
        threads: int = 2,
        prefetch: int = 2,
        ring: int = 2,
        pin_memory: bool = False,
        copy: bool = False,
    ) -> None:
        """Prepare; nothing is read yet.

        Parameters
        ----------
        batch_size
            Samples a batch.
        sampler
            Indices of one epoch each time it is iterated. Default: all in order, from the start each time.
        shuffle
            Instead of a sampler: an `EpochSampler` with the dataset's seed. Leaving an epoch early goes on with the
            next one; to resume in the middle, give a sampler.
        drop_last
            Whether a last batch of fewer samples is left out.
        threads
            That fill batches, one batch each.
        prefetch
            Batches that are filled ahead of the one asked for.
        ring
            Batches that stay valid at a time, the one asked for last included.
        pin_memory
            Whether batches lie in pinned memory, for faster copies to a GPU. Without one this is logged and ignored,
            as in a DataLoader.
        copy
            Whether each batch has memory of its own.

        Raises
        ------
        UsageError
            For a number that is too small, or `shuffle` beside a sampler.
        """
        self.dataset = dataset
        self.batch_size, self.threads = _at_least(1, batch_size=batch_size), _at_least(1, threads=threads)
        self.prefetch, self.ring = _at_least(1, prefetch=prefetch), _at_least(1, ring=ring)
        if sampler is not None and shuffle:
            raise UsageError(
                "shuffle is for the default sampler", fix="leave it out, or give EpochSampler(..., shuffle=True)"
            )
        self._own = EpochSampler(dataset, seed=dataset.seed) if shuffle else None
        given: Iterable[int] = SequentialSampler(dataset) if sampler is None else sampler
        self.sampler = given if self._own is None else self._own
        self.drop_last, self.copy = bool(drop_last), bool(copy)
        self.pinned = bool(pin_memory) and torch.cuda.is_available()
        if pin_memory and not self.pinned:
            _log.warning("pin_memory=True, but torch finds no CUDA device: batches are not pinned")
        self._walk: weakref.ref[_Walk] | None = None
        self._pool = Pool()
        self._buffers: list[Buffer] = []
        self._turn = 0  # batches handed out, which says whose buffer is next

    def __len__(self) -> int:
        """Return the batches of a whole epoch, wherever the sampler stands."""
        return len(self._batches())

    def __repr__(self) -> str:
        """Say what is read, and how."""
        return (
            f"BatchLoader({self.dataset!r}, batch_size={self.batch_size}, threads={self.threads}, "
            f"prefetch={self.prefetch}, ring={self.ring}, copy={self.copy}, pinned={self.pinned})"
        )

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Go through one epoch, from the sampler's position on."""
        before = self._walk() if self._walk is not None else None
        if before is not None:
            before.close()
        if self._own is not None and self._own.position:
            self._own.set_epoch(self._own.epoch + 1)
        walk = _Walk(self)
        # The loop alone keeps an iteration alive, so that leaving it ends the threads.
        self._walk = weakref.ref(walk)
        return walk

    def __getstate__(self) -> dict[str, Any]:
        """Leave memory and threads out."""
        return {**self.__dict__, "_walk": None, "_pool": Pool(), "_buffers": [], "_turn": 0}

    def _batches(self) -> BatchSampler:
        return BatchSampler(self.sampler, self.batch_size, self.drop_last)

    def _buffer(self, turn: int, fill: Fill) -> Buffer:
        """Return the memory of a batch, by its number since the loader was made."""
        if self.copy:
            return self._new(fill)
        n_buffers = self.ring + self.prefetch
        while len(self._buffers) <= turn % n_buffers:
            self._buffers.append(self._new(fill))
        return self._buffers[turn % n_buffers]

    def _new(self, fill: Fill) -> Buffer:
        shapes = {name: ((self.batch_size, *shape), dtype) for name, (shape, dtype) in fill.layout.items()}
        if not self.pinned:
            return {name: self._pool.tensor(shape, dtype) for name, (shape, dtype) in shapes.items()}
        # torch keeps pinned memory, and waits for copies to the device, before it hands it out again.
        return {
            name: torch.empty(shape, dtype=torch.from_numpy(np.empty(0, dtype)).dtype, pin_memory=True)
            for name, (shape, dtype) in shapes.items()
        }


class _Walk(Iterator[dict[str, Any]]):
    """One iteration: batches asked for, in order, and the threads that fill them.

    With batch n asked for, batches up to n + prefetch are under way, and those from n - ring + 1 on are valid: as
    many as there are buffers. So batch n + prefetch takes over the buffer of batch n - ring.
    """

    def __init__(self, loader: BatchLoader) -> None:
        self._loader = loader
        self._process = os.getpid()
        self._fill = loader.dataset._fill()  # made here, not by several threads at once
        self._indices = iter(loader._batches())
        self._waiting: deque[tuple[Buffer, Future[dict[str, Any]]]] = deque()
        self._ended = False
        self._threads: ThreadPoolExecutor | None = ThreadPoolExecutor(loader.threads, "BatchLoader")
        for _ in range(loader.prefetch):
            self._submit()

    def __next__(self) -> dict[str, Any]:
        if self._ended:
            raise StopIteration
        if self._process != os.getpid():
            raise UsageError("this iteration began in another process", fix="iterate over the loader anew")
        if self._threads is None:
            raise UsageError("another iteration over this loader has begun", fix="use two loaders, or one at a time")
        try:
            self._submit()
            if not self._waiting:
                raise StopIteration
            tensors, reading = self._waiting.popleft()
            said = reading.result()
        except BaseException:
            self._ended = True
            self.close()
            raise
        self._loader._turn += 1
        return {**tensors, **said}

    def close(self) -> None:
        """Stop the threads; what they are at is finished first, as it writes into buffers that others will use."""
        threads, self._threads = self._threads, None
        self._waiting.clear()
        if threads is not None and self._process == os.getpid():
            threads.shutdown(wait=True, cancel_futures=True)

    def __del__(self) -> None:
        self.close()

    def _submit(self) -> None:
        """Have the next batch read, if there is one."""
        indices = next(self._indices, None)
        if indices is None or self._threads is None:
            return
        loader = self._loader
        request = loader.dataset._request(indices)
        buffer = loader._buffer(loader._turn + len(self._waiting), self._fill)
        # Tensors of its own for each batch: what a trainer does to one does not stick to the buffer.
        tensors = {name: tensor[: len(request)] for name, tensor in buffer.items()}
        reading = self._threads.submit(_read, loader.dataset, self._fill, request, tensors)
        self._waiting.append((tensors, reading))


# Not a method: a thread that holds the last reference to the iteration would have to wait for itself.
def _read(dataset: WindowDataset, fill: Fill, request: Request, tensors: Buffer) -> dict[str, Any]:
    """Fill tensors, and return what the samples say beside them; in a thread."""
    fill(request, {name: tensor.numpy() for name, tensor in tensors.items()})
    return {name: default_collate(values) for name, values in dataset._metadata(request).items()}


def _at_least(least: int, **given: int) -> int:
    ((name, value),) = given.items()
    number = whole(name, value)
    if number < least:
        raise UsageError(f"{name} is too small", found=number, allowed=f"{least} or more")
    return number
