"""BatchLoader: batches by threads, from mapped files straight into memory that is used again."""

from __future__ import annotations

import logging
import os
import threading
import weakref
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch.utils.data import BatchSampler, SequentialSampler, default_collate

from dancedata.core.errors import UsageError
from dancedata.readers.arguments import whole
from dancedata.readers.batch_memory import MemoryPool
from dancedata.readers.batch_reader import BatchReader, Request
from dancedata.readers.sampler import EpochSampler
from dancedata.readers.windows import WindowDataset

_log = logging.getLogger(__name__)

#: One batch's memory: a tensor (batch_size, ...) by name.
Buffer = dict[str, torch.Tensor]


class BatchLoader:
    """Batches of a `WindowDataset`, equal bit for bit to those of a DataLoader with the same sampler, and faster.

    Threads copy windows from the mapped shards into batches, and mirror and normalise them there. Nothing goes
    through another process, and the memory of a batch that nobody refers to any more becomes that of a later one,
    so that after a few batches no memory is touched for the first time::

        loader = BatchLoader(train, 64, sampler=EpochSampler(train, seed=0))
        for epoch in range(n):
            for batch in loader:
                ...

    A batch is a dict as torch's default collate makes it: a tensor (B, rows, D) per field, tensors and lists of what
    else a sample says.

    Attributes
    ----------
    dataset, sampler, batch_size, drop_last, threads, prefetch
        As given; `sampler` is the one made if none was given.
    pinned
        Whether batches lie in pinned memory.

    Notes
    -----
    *Batches are the caller's own.* They may be kept, written to and passed on; nothing is written into a batch while
    any tensor or array that shares its memory lives. A loop that lets go of each batch has `prefetch` + 2 of them in
    memory; one that keeps them all has them all. Only a bare address (``tensor.data_ptr()``) keeps nothing alive.

    *Copies to a GPU* with ``non_blocking=True`` need no care: torch hands pinned memory out again only after the
    copies from it are done.

    *Order and resuming* are the sampler's. Batches are asked of it `prefetch` ahead, as by a DataLoader with workers:
    in the middle of an epoch the state is ``sampler.at(epoch, consumed)``.

    *Ranks.* An `EpochSampler` gives each its share: `rank` and `world_size`, or torch.distributed's.

    *Threads and processes.* One iteration at a time: starting another ends the one before, which then raises an
    error. Leaving a loop early stops the threads. An error in a thread is raised where the loop asks for that batch.
    Threads do not live on in a forked process: iterate anew there. Pickling leaves memory and threads out.

    *Files that cannot be mapped* are read all the same, by the same threads; ``dataset.unmapped`` says why, and a
    warning is logged.
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
        pin_memory: bool = False,
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
        pin_memory
            Whether batches lie in pinned memory, for faster copies to a GPU. Without one this is logged and ignored,
            as in a DataLoader.

        Raises
        ------
        UsageError
            For a number that is too small, or `shuffle` beside a sampler.
        """
        self.dataset = dataset
        self.batch_size, self.threads = _at_least_1(batch_size=batch_size), _at_least_1(threads=threads)
        self.prefetch = _at_least_1(prefetch=prefetch)
        if sampler is not None and shuffle:
            raise UsageError(
                "shuffle is for the default sampler", fix="leave it out, or give EpochSampler(..., shuffle=True)"
            )
        self._own = EpochSampler(dataset, seed=dataset.seed) if shuffle else None
        given: Iterable[int] = SequentialSampler(dataset) if sampler is None else sampler
        self.sampler = given if self._own is None else self._own
        self.drop_last = bool(drop_last)
        self.pinned = bool(pin_memory) and torch.cuda.is_available()
        if pin_memory and not self.pinned:
            _log.warning("pin_memory=True, but torch finds no CUDA device: batches are not pinned")
        self._walk: weakref.ref[_Iteration] | None = None
        self._pool = self._new_pool()

    def __len__(self) -> int:
        """Return the batches of a whole epoch, wherever the sampler stands."""
        return len(self._batches())

    def __repr__(self) -> str:
        """Say what is read, and how."""
        return (
            f"BatchLoader({self.dataset!r}, batch_size={self.batch_size}, drop_last={self.drop_last}, "
            f"threads={self.threads}, prefetch={self.prefetch}, pinned={self.pinned})"
        )

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Go through one epoch, from the sampler's position on."""
        before = self._walk() if self._walk is not None else None
        if before is not None:
            before.close()
        if self._own is not None and self._own.position:
            self._own.set_epoch(self._own.epoch + 1)
        walk = _Iteration(self)
        # The loop alone keeps an iteration alive, so that leaving it ends the threads.
        self._walk = weakref.ref(walk)
        return walk

    def __getstate__(self) -> dict[str, Any]:
        """Leave memory and threads out."""
        return {**self.__dict__, "_walk": None, "_pool": self._new_pool()}

    def _new_pool(self) -> MemoryPool:
        # At an epoch's end all batches that were under way are idle: every field, and primitives, of each.
        return MemoryPool(kept=(self.prefetch + 2) * (len(self.dataset.fields) + 1))

    def _batches(self) -> BatchSampler:
        return BatchSampler(self.sampler, self.batch_size, self.drop_last)

    def _memory(self, fill: BatchReader) -> Buffer:
        """Return memory for a batch, of any content, that nothing else refers to."""
        shapes = {name: ((self.batch_size, *shape), dtype) for name, (shape, dtype) in fill.layout.items()}
        if not self.pinned:
            return {name: self._pool.tensor(shape, dtype) for name, (shape, dtype) in shapes.items()}
        # torch keeps pinned memory, and waits for copies to the device, before it hands it out again.
        return {
            name: torch.empty(shape, dtype=torch.from_numpy(np.empty(0, dtype)).dtype, pin_memory=True)
            for name, (shape, dtype) in shapes.items()
        }


class _Iteration(Iterator[dict[str, Any]]):
    """One iteration: batches asked for, in order, and the threads that fill them."""

    def __init__(self, loader: BatchLoader) -> None:
        self._process = os.getpid()
        self._waiting: deque[tuple[Buffer, Future[dict[str, Any]]]] = deque()
        self._ended = False
        self._known: set[int] = set()
        self._threads: ThreadPoolExecutor | None = ThreadPoolExecutor(
            loader.threads, "BatchLoader", initializer=_introduce, initargs=(self._known,)
        )
        self._loader = loader
        self._fill = loader.dataset._batch_reader()  # made here, not by several threads at once
        self._indices = iter(loader._batches())
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
        return {**tensors, **said}

    def close(self) -> None:
        """Stop the threads, once they are through with the batch that each is at."""
        threads, self._threads = self._threads, None
        self._waiting.clear()
        if threads is not None and self._process == os.getpid():
            # The garbage collector may come here in one of them, which cannot wait for itself.
            threads.shutdown(wait=threading.get_ident() not in self._known, cancel_futures=True)

    def __del__(self) -> None:
        self.close()

    def _submit(self) -> None:
        """Have the next batch read, if there is one."""
        indices = next(self._indices, None)
        if indices is None or self._threads is None:
            return
        request = self._loader.dataset._request(indices)
        memory = self._loader._memory(self._fill)
        tensors = {name: tensor[: len(request)] for name, tensor in memory.items()}
        reading = self._threads.submit(_read, self._loader.dataset, self._fill, request, tensors)
        self._waiting.append((tensors, reading))


def _introduce(known: set[int]) -> None:
    known.add(threading.get_ident())


# Not a method: a thread that holds the last reference to the iteration would end it.
def _read(dataset: WindowDataset, fill: BatchReader, request: Request, tensors: Buffer) -> dict[str, Any]:
    """BatchReader tensors, and return what the samples say beside them; in a thread."""
    fill(request, {name: tensor.numpy() for name, tensor in tensors.items()})
    return {name: default_collate(values) for name, values in dataset._metadata(request).items()}


def _at_least_1(**given: int) -> int:
    ((name, value),) = given.items()
    number = whole(name, value)
    if number < 1:
        raise UsageError(f"{name} is too small", found=number, allowed="1 or more")
    return number
