"""The epoch of a dataset, which the workers of a DataLoader see as well."""

from __future__ import annotations

import torch
from torch.utils.data import Dataset


def shared_number(value: int) -> torch.Tensor:
    """Return a tensor (1,) int64 in memory that this process and its workers share."""
    number = torch.tensor([value], dtype=torch.int64)
    number.share_memory_()  # type: ignore[no-untyped-call]
    return number


def set_epoch_of(source: object, epoch: int) -> None:
    """Set the epoch of a dataset; of one without `set_epoch`, that of the datasets among its attributes.

    So the parts of torch's ConcatDataset, Subset (random_split) and StackDataset are reached, and what other wrappers
    hold.
    """
    set_epoch = getattr(source, "set_epoch", None)
    if callable(set_epoch):
        set_epoch(epoch)
        return
    for held in getattr(source, "__dict__", {}).values():
        parts = held.values() if isinstance(held, dict) else held if isinstance(held, list | tuple) else (held,)
        for part in parts:
            if isinstance(part, Dataset):
                set_epoch_of(part, epoch)
