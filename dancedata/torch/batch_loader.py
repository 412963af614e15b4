"""BatchLoader: threads read batches from mapped files directly into reused memory."""

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
from torch.utils.data import BatchSampler, SequentialSampler

from dancedata.core.arguments import whole
from dancedata.core.errors import UsageError
from dancedata.core.text import shown
from dancedata.store.columns import MAX_ROWS
from dancedata.torch.batch_reader import Layout, MemoryPool, ReadBatch
from dancedata.torch.collate import collate_values
from dancedata.torch.mix import Mix
from dancedata.torch.sampler import EpochSampler
from dancedata.torch.windows import WindowDataset

_log = logging.getLogger(__name__)

#: One batch's memory: a tensor (batch_size, ...) by name.
Buffer = dict[str, torch.Tensor]


class BatchLoader:
    """Batches of a `WindowDataset`, equal bit for bit to a DataLoader's with the same EpochSampler, and faster.

    Threads copy windows from the mapped shards into reused batches, and mirror and normalise them there::

        loader = BatchLoader(train, 64, sampler=EpochSampler(train, seed=0))
        for epoch in range(n):
            for batch in loader:
                ...

    A batch is a dict as torch's default collate makes it: a tensor (B, rows, D) per field, tensors and lists of
    the other values of a sample.

    Notes
    -----
    Batches belong to the caller; memory is reused once no tensor or array refers to it (a bare address,
    ``tensor.data_ptr()``, does not keep it alive).

    Order, ranks and resuming are the sampler's, which is read `prefetch` batches ahead: in the middle of an epoch the
    state is ``sampler.at(epoch, consumed)``. A new iteration ends the previous one, which then raises an error, as it
    does in a forked process. See docs/guides/batches.md.
    """

    def __init__(
        self,
        dataset: WindowDataset | Mix,
        batch_size: int = 1,
        *,
        sampler: Iterable[int] | None = None,
        shuffle: bool = False,
        drop_last: bool = False,
        threads: int = 2,
        prefetch: int = 2,
        pin_memory: bool = False,
    ) -> None:
        """Make the loader; nothing is read yet.

        Parameters
        ----------
        sampler
            Indices of one epoch each time it is iterated. Default: all samples in order, from the start each time.
        shuffle
            Instead of a sampler: an `EpochSampler` with the dataset's seed. After an epoch that was left early, the
            next epoch follows; to resume in the middle, give a sampler.
        drop_last
            Whether a last batch of fewer samples is left out.
        threads, prefetch
            Number of threads, each with a batch at a time; batches that are read ahead.
        pin_memory
            Whether batches are in pinned memory, for faster copies to a GPU. Without a GPU it is ignored, as in a
            DataLoader, and a warning is logged.

        Raises
        ------
        UsageError
            For a number that is too small, or `shuffle` together with a sampler.
        """
        if not isinstance(dataset, WindowDataset | Mix):
            raise UsageError("a BatchLoader reads windows", found=shown(dataset), fix="read others with a DataLoader")
        self.dataset = dataset
        self.batch_size, self.threads, self.prefetch = (
            whole(name, number, 1, MAX_ROWS)
            for name, number in (("batch_size", batch_size), ("threads", threads), ("prefetch", prefetch))
        )
        if sampler is not None and shuffle:
            raise UsageError("shuffle cannot be combined with a sampler",
                             fix="leave it out, or give EpochSampler(..., shuffle=True)")  # fmt: skip
        self._epochs = EpochSampler(len(dataset), seed=dataset.seed) if shuffle else None
        indices: Iterable[int] = SequentialSampler(dataset) if sampler is None else sampler
        self.sampler = indices if self._epochs is None else self._epochs
        self.drop_last = bool(drop_last)
        self.pinned = bool(pin_memory) and torch.cuda.is_available()
        if pin_memory and not self.pinned:
            _log.warning("pin_memory=True, but torch finds no CUDA device: batches are not pinned")
        self._iteration: weakref.ref[_Iteration] | None = None
        self._pool = self._new_pool()

    def __len__(self) -> int:
        return len(self._batches())

    def __repr__(self) -> str:
        return f"BatchLoader({self.dataset!r}, batch_size={self.batch_size}, threads={self.threads})"

    def __iter__(self) -> Iterator[dict[str, Any]]:
        previous = self._iteration() if self._iteration is not None else None
        if previous is not None:
            previous.close()
        if self._epochs is not None and self._epochs.position:
            self._epochs.set_epoch(self._epochs.epoch + 1)
        iteration = _Iteration(self)
        # Only the loop keeps an iteration alive, so that leaving the loop ends the threads.
        self._iteration = weakref.ref(iteration)
        return iteration

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_iteration": None, "_pool": self._new_pool()}

    def _new_pool(self) -> MemoryPool:
        # At the end of an epoch all prefetched batches are idle: every field, primitives and labels, of each.
        return MemoryPool(max_idle=(self.prefetch + 2) * (len(self.dataset.fields) + 3))

    def _batches(self) -> BatchSampler:
        return BatchSampler(self.sampler, self.batch_size, self.drop_last)

    def _memory(self, layout: Layout) -> Buffer:
        """Return uninitialised memory for a batch, to which nothing else refers."""
        shapes = {name: ((self.batch_size, *shape), dtype) for name, (shape, dtype) in layout.items()}
        if not self.pinned:
            return {name: self._pool.tensor(shape, dtype) for name, (shape, dtype) in shapes.items()}
        # torch manages pinned memory itself, and waits for copies to the device before it reuses it.
        return {
            name: torch.empty(shape, dtype=torch.from_numpy(np.empty(0, dtype)).dtype, pin_memory=True)
            for name, (shape, dtype) in shapes.items()
        }


class _Iteration(Iterator[dict[str, Any]]):
    def __init__(self, loader: BatchLoader) -> None:
        self._process = os.getpid()
        self._pending: deque[tuple[Buffer, Future[dict[str, Any]]]] = deque()
        self._ended = False
        self._thread_ids: set[int] = set()
        self._threads: ThreadPoolExecutor | None = ThreadPoolExecutor(
            loader.threads,
            "BatchLoader",
            initializer=lambda ids: ids.add(threading.get_ident()),
            initargs=(self._thread_ids,),
        )
        self._loader = loader
        self._layout = loader.dataset._layout  # which makes the readers here, not in several threads at once
        self._indices = iter(loader._batches())
        self._epoch = loader.sampler.epoch if isinstance(loader.sampler, EpochSampler) else None
        for _ in range(loader.prefetch):
            self._submit()

    def __next__(self) -> dict[str, Any]:
        if self._ended:
            raise StopIteration
        if self._process != os.getpid():
            raise UsageError("this iteration began in another process", fix="start a new iteration over the loader")
        if self._threads is None:
            raise UsageError("another iteration over this loader has begun", fix="use two loaders, or one at a time")
        try:
            self._submit()
            if not self._pending:
                raise StopIteration
            tensors, reading = self._pending.popleft()
            metadata = reading.result()
        except BaseException:
            self._ended = True
            self.close()
            raise
        return {**tensors, **metadata}

    def close(self) -> None:
        """Stop the threads, once each of them has finished its batch."""
        threads, self._threads = self._threads, None
        self._pending.clear()
        if threads is not None and self._process == os.getpid():
            # The garbage collector may call this in one of the threads, which cannot wait for itself.
            threads.shutdown(wait=threading.get_ident() not in self._thread_ids, cancel_futures=True)

    def __del__(self) -> None:
        self.close()

    def _submit(self) -> None:
        indices = next(self._indices, None)
        if indices is None or self._threads is None:
            return
        read = self._loader.dataset._planned(indices, self._epoch)
        memory = self._loader._memory(self._layout)
        tensors = {name: tensor[: len(indices)] for name, tensor in memory.items()}
        reading = self._threads.submit(_read, read, tensors)
        self._pending.append((tensors, reading))


# Not a method: a thread that holds the last reference to the iteration would end it.
def _read(read: ReadBatch, tensors: Buffer) -> dict[str, Any]:
    """Read a batch into tensors, and return the other values of its samples; in a thread."""
    values = read({name: tensor.numpy() for name, tensor in tensors.items()})
    return {name: collate_values(column) for name, column in values.items()}
