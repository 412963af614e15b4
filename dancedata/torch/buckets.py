"""BucketSampler: batches of samples of similar length."""

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from torch.utils.data import Sampler

from dancedata.core.arguments import whole
from dancedata.core.errors import UsageError
from dancedata.core.hashing import sha256_bytes
from dancedata.core.text import counted
from dancedata.torch.sampler import EpochSampler, permutation, set_epoch_of

#: Apart from the stream of orders, which shuffles the batches.
_BUCKET_STREAM = 7


class TimedSamples(Protocol):
    """A `ClipDataset`, or any other dataset that states the lengths of its samples."""

    @property
    def lengths(self) -> npt.NDArray[np.int64]:
        """Frames of each sample."""


class BucketSampler(Sampler[list[int]]):
    """Batches of similar length, in a random order, resumable at any batch: little padding for whole clips.

    Samples are sorted by length and cut into buckets of equally many. In every epoch each bucket is shuffled and cut
    into batches, and the batches of all buckets are shuffled. A pure function of (lengths, seed, epoch, rank, world
    size)::

        batches = BucketSampler(clips, batch_size=8, seed=0)
        loader = DataLoader(clips, batch_sampler=batches, collate_fn=pad_clips)

    Ranks may have batches of different lengths in the same step.

    Attributes
    ----------
    order_of_batches
        `EpochSampler` of the batches, whose state and resuming are this sampler's, counted in batches of this rank.
    """

    def __init__(
        self,
        data_source: TimedSamples,
        *,
        batch_size: int | None = None,
        max_frames: int | None = None,
        n_buckets: int = 8,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
        drop_last: bool = False,
    ) -> None:
        """Make the sampler at the start of epoch 0.

        Parameters
        ----------
        batch_size
            Samples of a batch.
        max_frames
            Instead: frames of a batch, padding included, so that short clips come in larger batches.
        n_buckets
            Number of buckets, at most one per sample.
        seed, rank, world_size
            As for an `EpochSampler`.
        drop_last
            Whether batches that are not full are left out: one per bucket.

        Raises
        ------
        UsageError
            If not exactly one of the two sizes is given, or a sample has more than `max_frames`; for a source that
            does not state the lengths of its samples, such as a `Mix`.
        """
        if not hasattr(data_source, "lengths"):
            raise UsageError("samples of this source have no lengths", found=type(data_source).__name__,
                             fix="give a ClipDataset; for a Mix take an EpochSampler")  # fmt: skip
        lengths = np.asarray(data_source.lengths, dtype=np.int64)
        if (batch_size is None) == (max_frames is None):
            raise UsageError("a batch has a number of samples or a number of frames", fix="give one of the two")
        if max_frames is not None and lengths.max(initial=0) > whole("max_frames", max_frames):
            raise UsageError("a sample is longer than a batch may be",
                             found=f"sample {int(lengths.argmax())}: {lengths.max()} frames",
                             allowed=f"max_frames={max_frames}")  # fmt: skip
        n = max(1, min(whole("n_buckets", n_buckets), len(lengths)))
        order = np.argsort(lengths, kind="stable")
        self._buckets = [bucket for bucket in np.array_split(order, n) if len(bucket)]
        longest = [int(lengths[bucket[-1]]) for bucket in self._buckets]
        size = 0 if batch_size is None else whole("batch_size", batch_size, 1)
        self._sizes = [max_frames // frames if max_frames else size for frames in longest]
        self._source, self.seed, self.drop_last = data_source, seed, drop_last
        self.order_of_batches = EpochSampler(len(self.batches(0)), seed=seed, rank=rank, world_size=world_size)
        self.order_of_batches._groups = sha256_bytes(f"{self._sizes}{bool(drop_last)}".encode(), order.data)

    def __len__(self) -> int:
        return len(self.order_of_batches)

    def __repr__(self) -> str:
        number = counted(sum(map(len, self._buckets)), "sample")
        return f"BucketSampler({number}, batches: {self.order_of_batches!r})"

    def batches(self, epoch: int) -> list[npt.NDArray[np.int64]]:
        """Return all batches of an epoch, bucket by bucket, before they are shuffled and dealt to the ranks."""
        batches_: list[npt.NDArray[np.int64]] = []
        for number, (bucket, size) in enumerate(zip(self._buckets, self._sizes, strict=True)):
            bucket = bucket[permutation(len(bucket), self.seed, _BUCKET_STREAM, epoch, number)]
            stop = len(bucket) // size * size if self.drop_last else len(bucket)
            batches_ += [bucket[first : first + size] for first in range(0, stop, size)]
        return batches_

    def order(self, epoch: int) -> list[npt.NDArray[np.int64]]:
        """Return this rank's batches of an epoch, in their order; changes nothing."""
        batches = self.batches(epoch)
        return [batches[number] for number in self.order_of_batches.order(epoch).tolist()]

    def __iter__(self) -> Iterator[list[int]]:
        epoch = self.order_of_batches.epoch
        set_epoch_of(self._source, epoch)
        batches = self.batches(epoch)
        for number in self.order_of_batches:
            yield batches[number].tolist()

    def set_epoch(self, epoch: int) -> None:
        """Go to the start of an epoch; the current epoch keeps its position."""
        self.order_of_batches.set_epoch(epoch)

    def state_dict(self) -> dict[str, Any]:
        """Return the state of `EpochSampler`, its position in batches; with prefetching see `at`."""
        return self.order_of_batches.state_dict()

    def at(self, epoch: int, consumed: int) -> dict[str, Any]:
        """Return the state of a trainer that has consumed this many of this rank's batches of an epoch."""
        return self.order_of_batches.at(epoch, consumed)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go to a state of `state_dict` or `at`; takes effect at the next ``iter(loader)``."""
        self.order_of_batches.load_state_dict(state)
