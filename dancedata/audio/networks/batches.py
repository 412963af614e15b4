"""Computing in batches, whose size is halved when the device runs out of memory."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import torch

from dancedata.core.errors import DanceDataError, UsageError

Item = TypeVar("Item")
Result = TypeVar("Result")


class Batches:
    """Runs batches; keeps the largest size that the device has memory for.

    Parameters
    ----------
    fix
        What to do where a single item is too large, for the message.
    """

    def __init__(self, fix: str = "end other programs on the device") -> None:
        self.limit = sys.maxsize
        self.fix = fix

    def run(
        self, items: Sequence[Item], size: int, compute: Callable[[Sequence[Item]], list[Result]]
    ) -> Iterator[list[Result]]:
        """Compute items in order, `size` at once; the size is halved whenever the device runs out of memory.

        Yields
        ------
        list
            Results of the next items.

        Raises
        ------
        UsageError
            `size` is below 1.
        DanceDataError
            The memory is too small for a single item.
        """
        if size < 1:
            raise UsageError("invalid value for batch_size", found=size, allowed="1 or more")
        start = 0
        while start < len(items):
            part = items[start : start + min(size, self.limit)]
            results = self._attempt(part, compute)
            if results is None:
                # Outside of the except block: the traceback of the error references the tensors of the batch.
                torch.cuda.empty_cache()
                continue
            start += len(part)
            yield results

    def _attempt(
        self, part: Sequence[Item], compute: Callable[[Sequence[Item]], list[Result]]
    ) -> list[Result] | None:
        """Compute one batch; if the device runs out of memory, lower the limit and return None."""
        try:
            return compute(part)
        except RuntimeError as error:
            if not _is_out_of_memory(error):
                raise
            if len(part) > 1:
                self.limit = len(part) // 2
                return None
            raise DanceDataError(
                "the device has too little free memory for a single clip",
                found=str(error).split(". ")[0],
                fix=self.fix,
            ) from error


def _is_out_of_memory(error: RuntimeError) -> bool:
    """Whether it is torch's own error, or one of cuBLAS or cuDNN about their workspace."""
    return isinstance(error, torch.cuda.OutOfMemoryError) or "_STATUS_ALLOC_FAILED" in str(error)
