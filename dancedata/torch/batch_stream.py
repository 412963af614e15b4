"""BatchStream: batches by their global step, endless, as an iterable torch dataset; or epoch by epoch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from typing import Any

import numpy as np
import numpy.typing as npt
from torch.utils.data import DataLoader, IterableDataset, default_collate, get_worker_info

from dancedata.core.arguments import whole
from dancedata.core.errors import UsageError
from dancedata.store.columns import MAX_ROWS
from dancedata.torch.buckets import BucketSampler
from dancedata.torch.epochs import EpochDataset
from dancedata.torch.sampler import EpochSampler


class BatchStream(IterableDataset[Any]):
    """Batches one after another, epoch after epoch, from any global step on: for trainers that count steps.

    Batch number `step` is a pure function of (dataset, sampler, batch size, step)::

        stream = BatchStream(train, 64, seed=0, start_step=checkpoint_step)
        loader = DataLoader(stream, batch_size=None, num_workers=4)
        for step, batch in enumerate(loader, start=checkpoint_step):
            ...

    The checkpoint's state of the data is the step, nothing else.

    Notes
    -----
    The batches and their order are the same with any number of workers. The sampler deals the samples of a step to
    the ranks, so that no other library should (Accelerate: no `prepare`). With another number of ranks a step has the
    same samples, on all of them together, if batch size times ranks is the same. The dataset's epoch is that of the
    step, whatever `set_epoch` was called with. See docs/guides/training.md.
    """

    def __init__(
        self,
        dataset: EpochDataset,
        batch_size: int | None = None,
        *,
        sampler: EpochSampler | BucketSampler | None = None,
        seed: int = 0,
        collate: Callable[[list[dict[str, Any]]], Any] = default_collate,
        start_step: int = 0,
        steps: int | None = None,
        drop_last: bool = False,
    ) -> None:
        """Make the stream; nothing is read yet.

        Parameters
        ----------
        batch_size
            Samples of this rank in a step; None with a `BucketSampler`, which makes batches itself.
        sampler
            The order; its position is not used. Default: an `EpochSampler` with `seed`.
        collate
            Makes a batch of samples, such as `pad_clips`. With workers it has to be picklable.
        start_step
            Global step of the first batch; may be set before each ``iter(loader)``.
        steps
            Number of batches; None: endless.
        drop_last
            Whether the last batch of an epoch is left out if it is not full.

        Raises
        ------
        UsageError
            For invalid numbers, an epoch without a batch, or a dataset without `samples`.
        """
        super().__init__()
        if not callable(getattr(dataset, "samples", None)):
            raise UsageError(
                "a stream reads a WindowDataset or a ClipDataset",
                found=type(dataset).__name__,
                fix="read others with a DataLoader and an EpochSampler, which sets the epoch of their parts",
            )
        self.dataset, self.collate, self.drop_last = dataset, collate, bool(drop_last)
        self.sampler = EpochSampler(len(dataset), seed=seed) if sampler is None else sampler
        if isinstance(self.sampler, BucketSampler) != (batch_size is None):
            raise UsageError("only a BucketSampler makes batches itself", fix="give batch_size, or leave it out")
        self.batch_size = None if batch_size is None else whole("batch_size", batch_size, most=MAX_ROWS)
        self.start_step = whole("start_step", start_step)
        self.n_steps = None if steps is None else whole("steps", steps)
        if not self.steps_per_epoch:
            raise UsageError("an epoch has no batch", found=repr(self.sampler), fix="give a smaller batch_size")
        self._order: tuple[int, list[npt.NDArray[np.int64]]] | None = None

    @property
    def steps_per_epoch(self) -> int:
        """Batches of an epoch, on every rank."""
        if isinstance(self.sampler, BucketSampler):
            return len(self.sampler)
        return self.sampler.steps(self.batch_size or 0, drop_last=self.drop_last)

    def indices(self, step: int) -> tuple[int, npt.NDArray[np.int64]]:
        """Return the epoch of a step, and the indices of this rank's samples."""
        epoch, nth = divmod(whole("step", step), self.steps_per_epoch)
        if self._order is None or self._order[0] != epoch:
            if isinstance(self.sampler, BucketSampler):
                batches = self.sampler.order(epoch)
            else:
                order, size = self.sampler.order(epoch), self.batch_size or 1
                batches = [order[first : first + size] for first in range(0, len(order), size)]
            self._order = epoch, batches
        return epoch, self._order[1][nth]

    def by_epoch(self, **options: Any) -> EpochLoader:
        """Return a loader that ends with each epoch; `options` are those of a DataLoader, such as ``num_workers``.

        Raises UsageError: for a stream that ends after a number of steps.
        """
        if self.n_steps is not None:
            raise UsageError("this stream ends by steps", found=f"steps={self.n_steps}", fix="leave out steps")
        return EpochLoader(self, options)

    def batch(self, step: int) -> Any:
        """Return the batch of a step."""
        epoch, indices = self.indices(step)
        return self.collate(self.dataset.samples(indices.tolist(), epoch))

    def __iter__(self) -> Iterator[Any]:
        worker = get_worker_info()
        first, step_size = (worker.id, worker.num_workers) if worker is not None else (0, 1)
        step, stop = self.start_step + first, None if self.n_steps is None else self.start_step + self.n_steps
        while stop is None or step < stop:
            yield self.batch(step)
            step += step_size

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_order": None}


class EpochLoader:
    """Batches of a `BatchStream`, an epoch or the rest of it at a time; `step`: that of the next batch."""

    def __init__(self, stream: BatchStream, options: dict[str, Any]) -> None:
        self._stream, self._options = copy(stream), options
        self.step = stream.start_step

    def __len__(self) -> int:
        return self._stream.steps_per_epoch

    def __iter__(self) -> Iterator[Any]:
        stream, first = self._stream, self.step
        stream.start_step, stream.n_steps = first, len(self) - first % len(self)
        for step, batch in enumerate(DataLoader(stream, batch_size=None, **self._options), start=first + 1):
            self.step = step
            yield batch
