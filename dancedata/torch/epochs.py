"""The epoch of a dataset, which decides every random change of its samples; shared with workers."""

from collections.abc import Mapping, Sequence
from operator import index as as_int
from typing import Any

import torch
from torch.utils.data import Dataset

from dancedata.core.arguments import whole
from dancedata.core.errors import UsageError
from dancedata.core.text import listed, shown

#: In place of an epoch while none is set.
_NOT_SET = -1


class EpochDataset(Dataset[dict[str, Any]]):
    """Samples that may be drawn and changed again in each epoch."""

    #: Whether reading draws numbers.
    _is_random: bool = False

    def __init__(self) -> None:
        self._epoch = _shared_number(_NOT_SET)

    def __len__(self) -> int:
        """Return the number of samples."""
        raise NotImplementedError

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Return many samples in the given order; torch's DataLoader calls this for a batch.

        The files are read in their own order, independent of the order of `indices`.
        """
        return self.samples(indices)

    def samples(self, indices: Sequence[int], epoch: int | None = None) -> list[dict[str, Any]]:
        """Return many samples, as of an epoch that is given here instead of by `set_epoch`.

        Raises IndexError: for an index outside the dataset.
        """
        raise NotImplementedError

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        # torch's own workers receive the shared number itself; any other copy gets its own number, which has to
        # be shared as well, because workers may be started from that copy.
        if not self._epoch.is_shared():  # type: ignore[no-untyped-call]
            self._epoch = _shared_number(int(self._epoch.item()))

    @property
    def epoch(self) -> int | None:
        """The current epoch, which decides what happens to each sample; None: every reading draws new numbers."""
        epoch = int(self._epoch.item())
        return None if epoch == _NOT_SET else epoch

    def set_epoch(self, epoch: int | None) -> None:
        """Set the current epoch, here and in all workers; None: each reading draws from torch's generator.

        Raises UsageError: for a negative epoch, or one of 2**63 and more.
        """
        self._epoch.fill_(_NOT_SET if epoch is None else whole("epoch", epoch, most=2**63 - 1))

    def _place(self, index: int) -> int:
        """Return the place of a sample; negative indices count from the end."""
        place = as_int(index)
        if not -len(self) <= place < len(self):
            raise IndexError(f"sample {index} of a {type(self).__name__} of {len(self)} samples")
        return place % len(self)

    def _drawn_epoch(self, epoch: int | None) -> int:
        """Return the number that decides what happens to samples: an epoch, or one from torch's generator."""
        epoch = self.epoch if epoch is None else whole("epoch", epoch)
        if epoch is None:
            # Without random changes the generator keeps its state.
            epoch = int(torch.empty((), dtype=torch.int64, device="cpu").random_()) if self._is_random else 0
        return epoch


def _shared_number(value: int) -> torch.Tensor:
    number = torch.tensor([value], dtype=torch.int64)
    number.share_memory_()  # type: ignore[no-untyped-call]
    return number


def require_scalers(state: Mapping[str, Any], current: Mapping[str, Any], fix: str) -> None:
    """Raise UsageError unless a checkpoint's state is of a reader with the scalers of this one."""
    stated, hashes = state.get("scalers") if isinstance(state, Mapping) else state, current["scalers"]
    if stated != hashes:
        scalers = listed(f"{n} {v}" for n, v in stated.items()) if isinstance(stated, Mapping) else shown(stated)
        allowed = listed(f"{name} {sha256}" for name, sha256 in hashes.items()) or "none"
        raise UsageError(
            "the state was saved by a reader with different scalers", found=scalers, allowed=allowed, fix=fix
        )
