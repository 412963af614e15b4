"""The epoch of a dataset, which the workers of a DataLoader see as well."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch


def shared_number(value: int) -> torch.Tensor:
    """Return a tensor (1,) int64 in memory that this process and its workers share."""
    number = torch.tensor([value], dtype=torch.int64)
    number.share_memory_()  # type: ignore[no-untyped-call]
    return number


def set_epoch_of(source: object, epoch: int) -> None:
    """Set the epoch of a dataset; of one without `set_epoch`, that of the datasets among its attributes.

    So the parts of torch's ConcatDataset, Subset (random_split) and StackDataset are reached, and what other wrappers
    hold, in lists and dicts as well.
    """
    pending, seen = [source], {id(source)}
    while pending:
        held: Any = pending.pop()
        set_epoch = getattr(held, "set_epoch", None)
        if callable(set_epoch):
            set_epoch(epoch)
            continue
        slots = [getattr(held, name, None) for kind in type(held).__mro__ for name in getattr(kind, "__slots__", ())]
        parts = held if isinstance(held, list | tuple) else [*getattr(held, "__dict__", {}).values(), *slots]
        for part in held.values() if isinstance(held, dict) else parts:
            if _holds(part) and id(part) not in seen:
                seen.add(id(part))
                pending.append(part)


def _holds(part: object) -> bool:
    """Return whether an object may be a dataset, or a collection of them."""
    return hasattr(type(part), "__getitem__") and not isinstance(part, str | bytes | np.ndarray | torch.Tensor)
