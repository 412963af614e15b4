"""The collate function of windows, without a copy where they are rows of one batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch.utils.data import default_collate

try:
    # As torch documents it for adding a type to default_collate.
    from torch.utils.data._utils.collate import default_collate_fn_map
except ImportError:
    # Without it torch stacks these samples like any others: slower, with the same result.
    default_collate_fn_map = {}


@dataclass(frozen=True, eq=False)
class Batch:
    """Tensors (B, ...) by name, and their rows."""

    size: int
    tensors: Mapping[str, torch.Tensor]
    rows: Mapping[str, tuple[torch.Tensor, ...]]

    @classmethod
    def of(cls, size: int, tensors: Mapping[str, torch.Tensor]) -> Batch:
        """Make a batch of tensors."""
        return cls(size, tensors, {name: tensor.unbind(0) for name, tensor in tensors.items()})


class Sample(dict[str, Any]):
    """A window as a dict, which remembers the batch that it is a row of. Copies and pickles are plain dicts."""

    __slots__ = ("batch",)

    def __init__(self, values: Mapping[str, Any], batch: Batch) -> None:
        """Make a row of a batch."""
        super().__init__(values)
        self.batch = batch

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


def collate(samples: Sequence[Any], *, collate_fn_map: Any = None) -> Any:
    """Make a batch as torch's default_collate does, without a copy where the samples are the rows of one."""
    batch = samples[0].batch if isinstance(samples[0], Sample) else None
    if batch is None or len(samples) != batch.size or not all(isinstance(s, Sample) for s in samples):
        rows = [dict(s) if isinstance(s, Sample) else s for s in samples]
        if not all(isinstance(row, dict) for row in rows):
            return default_collate(rows)
        return {name: collate_values([row[name] for row in rows]) for name in rows[0]}
    return {
        name: batch.tensors[name] if _are_rows(batch, name, samples) else collate_values([s[name] for s in samples])
        for name in samples[0]
    }


def collate_values(values: list[Any]) -> Any:
    """Make one value of a batch, as torch's default_collate does; lists, such as those of a group, stay lists."""
    return values if values and isinstance(values[0], list) else default_collate(values)


def _are_rows(batch: Batch, name: str, samples: Sequence[Any]) -> bool:
    rows = batch.rows.get(name)
    return rows is not None and all(s.get(name) is row for s, row in zip(samples, rows, strict=True))


default_collate_fn_map[Sample] = collate
