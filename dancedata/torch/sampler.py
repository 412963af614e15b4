"""EpochSampler: the order of an epoch as a pure function, and resuming in the middle of one."""

from collections.abc import Iterator, Mapping, Sized
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import distributed
from torch.utils.data import Sampler

from dancedata.core.arguments import whole
from dancedata.core.errors import UsageError
from dancedata.core.text import counted, shown
from dancedata.store.columns import MAX_ROWS

#: Indices turned into Python ints at a time: a list of a million ints would take 36 MB.
_CHUNK = 4096
#: Keeps the order's random streams apart from that of mirroring and others, which may have the same seed.
_ORDER_STREAM, _BLOCK_STREAM = 1, 11
#: Blocks whose shards are fetched while one is read.
_AHEAD = 2


def set_epoch_of(source: object, epoch: int) -> None:
    """Set the epoch of a dataset; of one without `set_epoch`, that of the datasets among its attributes.

    So the parts of torch's ConcatDataset, Subset (random_split) and StackDataset are reached, and what other wrappers
    hold, in lists and dicts as well.
    """
    pending, visited = [source], {id(source)}
    while pending:
        source = pending.pop()
        set_epoch = getattr(source, "set_epoch", None)
        if callable(set_epoch):
            set_epoch(epoch)
            continue
        slots = [
            getattr(source, name, None) for cls in type(source).__mro__ for name in getattr(cls, "__slots__", ())
        ]
        parts = source if isinstance(source, list | tuple) else [*getattr(source, "__dict__", {}).values(), *slots]
        for part in source.values() if isinstance(source, dict) else parts:
            if _may_be_dataset(part) and id(part) not in visited:
                visited.add(id(part))
                pending.append(part)


def _may_be_dataset(part: object) -> bool:
    return hasattr(type(part), "__getitem__") and not isinstance(part, str | bytes | np.ndarray | torch.Tensor)


class EpochSampler(Sampler[int]):
    """Indices of one epoch after another, for one rank, resumable at any sample.

    The order is a pure function of (number of samples, seed, epoch, rank, world size, blocks), by numpy's Philox bit
    stream and a stable sort, which numpy keeps unchanged across versions. Iterating begins at `position` of `epoch`,
    and at the end moves on to the next epoch. The epoch is passed on to a data source with a `set_epoch`, also inside
    torch's ConcatDataset, Subset and other wrappers, before its first index is handed out.

    Resuming, and loops of PyTorch, Accelerate and Lightning: docs/guides/batches.md and docs/guides/training.md.

    Examples
    --------
    >>> from dancedata.torch import EpochSampler
    >>> len(list(EpochSampler(10, seed=0)))
    10
    """

    #: Hash of the groups that the order is drawn from; "" without.
    _groups = ""

    def __init__(
        self,
        data_source: Sized | int,
        *,
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
        shuffle: bool = True,
        drop_last: bool = False,
        block: int | None = None,
    ) -> None:
        """Make the sampler at position 0 of epoch 0.

        Parameters
        ----------
        data_source
            A map-style dataset, or its number of samples.
        seed
            Whole number >= 0; the same on every rank.
        rank, world_size
            Both or neither. Default: torch.distributed's if it is initialised, else 0 and 1.
        shuffle
            False gives the samples in the dataset's order, epoch after epoch.
        drop_last
            All ranks get equally many samples. False: by starting over at the head of the epoch's order (as
            torch's DistributedSampler does), so up to world_size - 1 samples come twice. True: by leaving the
            order's last few out. Without several ranks nothing is repeated or left out.
        block
            Shuffle in blocks of at most this many neighbouring samples: blocks come in random order, and samples in
            random order within each. Blocks end where shards end, if the data source has `shard_starts`; smaller
            shards come together. For data that is read over a network: a block needs few shards, and its pieces fit
            into memory. Default: one block.

        Raises
        ------
        UsageError
            For a negative seed or number of samples, or a rank outside [0, world_size).
        """
        self._source = data_source
        n_samples = len(data_source) if isinstance(data_source, Sized) else data_source
        self.n_samples = whole("the number of samples", n_samples, most=MAX_ROWS)
        self.seed = whole("seed", seed)
        self.rank, self.world_size = _rank_and_world_size(rank, world_size)
        self.shuffle = shuffle
        self.drop_last = drop_last
        self.block = None if block is None else whole("block", block, 1)
        if self.block is not None:
            self._bounds = _cut(getattr(data_source, "shard_starts", [0]), self.n_samples, self.block)
        share, remainder = divmod(self.n_samples, self.world_size)
        self._length = share + (1 if remainder and not drop_last else 0)
        self._epoch = 0
        self._position = 0
        self._turn = 0  # which iteration may move epoch and position; an abandoned one may not

    @property
    def epoch(self) -> int:
        """The epoch with which iteration continues."""
        return self._epoch

    @property
    def position(self) -> int:
        """Number of this rank's samples of `epoch` that were handed out already."""
        return self._position

    def __len__(self) -> int:
        return self._length

    def __repr__(self) -> str:
        return (
            f"EpochSampler({self.n_samples} samples, seed={self.seed}, rank={self.rank}, "
            f"world_size={self.world_size}, shuffle={self.shuffle}, drop_last={self.drop_last}, "
            f"epoch={self._epoch}, position={self._position})"
        )

    def order(self, epoch: int) -> npt.NDArray[np.int64]:
        """Return this rank's indices of one epoch, (len(self),) int64; changes nothing."""
        indices = self.order_of_all(whole("epoch", epoch))
        total = self._length * self.world_size
        if total > self.n_samples:
            indices = np.resize(indices, total)  # starts over at the head, as often as needed
        return np.ascontiguousarray(indices[self.rank : total : self.world_size])

    def order_of_all(self, epoch: int) -> npt.NDArray[np.int64]:
        """Return the indices of one epoch, (n_samples,) int64, before they are dealt to the ranks one by one."""
        if self.shuffle and self.block is not None:
            sizes = np.diff(self._bounds)
            turns = permutation(len(sizes), self.seed, _BLOCK_STREAM, epoch)
            # Shuffled as a whole, then sorted by the block's turn, which keeps the order within each.
            order = permutation(self.n_samples, self.seed, _ORDER_STREAM, epoch)
            turn_of_sample = np.repeat(np.argsort(turns), sizes)
            return order[np.argsort(turn_of_sample[order], kind="stable")]
        if self.shuffle:
            return permutation(self.n_samples, self.seed, _ORDER_STREAM, epoch)
        return np.arange(self.n_samples, dtype=np.int64)

    def __iter__(self) -> Iterator[int]:
        self._turn += 1
        turn, epoch, position = self._turn, self._epoch, self._position
        set_epoch_of(self._source, epoch)
        order = self.order(epoch)
        prefetch = getattr(self._source, "prefetch", None)
        step = _CHUNK if self.block is None else -(-self.block // self.world_size)
        for first in range(position, len(order), step):
            if self.block is not None and prefetch is not None:
                prefetch([order[k : k + step] for k in range(first, first + (1 + _AHEAD) * step, step)])
            for sample in order[first : first + step].tolist():
                position += 1
                if turn == self._turn:
                    self._position = position
                yield sample
        if turn == self._turn:
            self._move(epoch + 1, 0)

    def set_epoch(self, epoch: int) -> None:
        """Go to the start of an epoch; the current epoch keeps its position.

        Trainers also call this before an epoch that was just resumed. To begin it again: ``load_state_dict(at(epoch,
        0))``.
        """
        number = whole("epoch", epoch)
        if number != self._epoch:
            self._move(number, 0)

    def state_dict(self) -> dict[str, Any]:
        """Return the position of the sampler, {"epoch", "position", "order"}; with prefetching see `at`.

        `order` says what the order of an epoch follows from: a position is of that order alone.
        """
        return self.at(self._epoch, self._position)

    def at(self, epoch: int, consumed: int) -> dict[str, Any]:
        """Return the state of a trainer that has consumed this many samples of an epoch; changes nothing.

        Parameters
        ----------
        consumed
            This rank's samples since the start of the epoch, 0 to len(self), which is the start of the next epoch.

        Raises
        ------
        UsageError
            For more samples than an epoch has, or negative numbers.
        """
        epoch, consumed = whole("epoch", epoch), whole("consumed", consumed)
        if consumed > self._length:
            raise UsageError("more samples consumed than an epoch has", found=consumed,
                             allowed=f"0 to {self._length}",
                             fix="count this rank's samples, from the start of the epoch")  # fmt: skip
        if consumed and consumed == self._length:
            epoch, consumed = epoch + 1, 0
        return {"epoch": epoch, "position": consumed, "order": self._order_text}

    def steps(self, batch_size: int, *, drop_last: bool = False) -> int:
        """Return the number of steps of an epoch, each with `batch_size` samples of this rank."""
        if batch_size < 1:
            return 0
        return self._length // batch_size if drop_last else -(-self._length // batch_size)

    def at_total(self, epoch: int, consumed: int) -> dict[str, Any]:
        """Return the state from which all ranks together have consumed this many samples of an epoch.

        For a run that continues with another number of ranks. Every remaining sample follows once; if `consumed` is
        not a multiple of the new number of ranks, the remainder comes again.
        """
        return self.at(epoch, whole("consumed", consumed) // self.world_size)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go to a state of `state_dict` or `at`; takes effect at the next ``iter(loader)``.

        Raises
        ------
        UsageError
            If the state has other keys, a position beyond an epoch of this sampler, or one within an epoch of another
            order: of another number of samples or ranks, or another seed.
        """
        if not isinstance(state, Mapping) or set(state) - {"order"} != {"epoch", "position"}:
            raise UsageError("this is not the state of an EpochSampler", found=shown(state),
                             allowed="a mapping of epoch, position and order",
                             fix="give sampler.state_dict()")  # fmt: skip
        start = self.at(state["epoch"], state["position"])
        if start["position"] and state.get("order") != self._order_text:
            raise UsageError("this is a position in an epoch of another order", found=shown(state.get("order")),
                             allowed=self._order_text,
                             fix="make the sampler as it was, or state what all ranks have consumed: "
                                 "sampler.at_total(epoch, consumed)")  # fmt: skip
        self._move(start["epoch"], start["position"])

    @property
    def _order_text(self) -> str:
        """What `order` depends on, beside the epoch, the rank and the samples themselves."""
        seed, ranks = self.seed if self.shuffle else None, counted(self.world_size, "rank")
        text = f"{type(self).__name__} of {self.n_samples} samples, seed {seed}, {ranks}"
        text = text if self.block is None else f"{text}, blocks of {self.block}"
        return f"{text}, groups {self._groups[:12]}" if self._groups else text

    def _move(self, epoch: int, position: int) -> None:
        self._turn += 1
        self._epoch, self._position = epoch, position


def _cut(starts: npt.ArrayLike, n: int, block: int) -> npt.NDArray[np.int64]:
    """Return the bounds (B + 1,) of blocks of at most `block` samples, which end where shards end."""
    bounds = [0]
    for begin, end in pairwise([*np.asarray(starts).tolist(), n]):
        if bounds[-1] < begin and end - bounds[-1] > block:
            bounds.append(begin)
        parts = -(-(end - bounds[-1]) // block)
        bounds += [begin + (end - begin) * part // parts for part in range(1, parts + (parts > 1))]
    return np.unique(np.array([*bounds, n], dtype=np.int64))


def permutation(n: int, seed: int, *key: int) -> npt.NDArray[np.int64]:
    """Return the numbers 0 .. n - 1 in a random order, (n,) int64: a pure function of seed and key."""
    stream = np.random.Philox(np.random.SeedSequence(seed, spawn_key=key))
    # Sorting random keys, not Generator.permutation: numpy keeps bit streams, not algorithms.
    return np.argsort(stream.random_raw(n), kind="stable").astype(np.int64, copy=False)


def _rank_and_world_size(rank: int | None, world_size: int | None) -> tuple[int, int]:
    if (rank is None) != (world_size is None):
        raise UsageError("rank and world_size belong together", found=f"rank={rank}, world_size={world_size}",
                         fix="give both, or neither to take them from torch.distributed")  # fmt: skip
    if rank is None or world_size is None:
        if not (distributed.is_available() and distributed.is_initialized()):
            return 0, 1
        rank, world_size = distributed.get_rank(), distributed.get_world_size()
    ranks = whole("world_size", world_size, 1, MAX_ROWS)
    return whole("rank", rank, most=ranks - 1), ranks
