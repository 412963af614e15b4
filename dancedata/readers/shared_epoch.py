"""The epoch of a dataset, which the workers of a DataLoader see as well."""

from __future__ import annotations

import torch


def shared_number(value: int) -> torch.Tensor:
    """Return a tensor (1,) int64 in memory that this process and its workers share."""
    number = torch.tensor([value], dtype=torch.int64)
    number.share_memory_()  # type: ignore[no-untyped-call]
    return number
