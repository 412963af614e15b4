"""Memory for batches.

A loader that allocates new memory for every batch spends most of its time there: the system clears every new page.
Therefore memory of large batches is reused as soon as no tensor refers to it.
"""

from __future__ import annotations

import math
import os
import weakref
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

#: Smaller arrays come from the allocator, which reuses small pieces itself.
_LARGE = 1 << 20


class MemoryPool:
    """Tensors whose memory is reused once they, and all tensors and arrays that share it, are gone.

    Safe under threads; a forked child starts with the memory that was idle in its parent.
    """

    def __init__(self, kept: int = 8) -> None:
        """Start empty.

        Parameters
        ----------
        kept
            Most pieces that are kept while nothing refers to them, the latest ones. Default: two batches of four
            large fields.
        """
        # A deque, not a list with a lock: memory is returned whenever a tensor is freed, in any thread, even while
        # this object is in use.
        self._idle: deque[npt.NDArray[np.uint8]] = deque(maxlen=kept)

    def tensor(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> torch.Tensor:
        """Return an uninitialised tensor."""
        n_bytes = math.prod(shape) * dtype.itemsize
        if n_bytes < _LARGE:
            return torch.from_numpy(np.empty(shape, dtype=dtype))
        memory = self._take(n_bytes)
        # Only the tensor keeps this array alive: when it is freed, the memory is idle.
        array = memory.view(dtype).reshape(shape)
        weakref.finalize(array, self._idle.append, memory).atexit = False
        return torch.from_numpy(array)

    def _take(self, n_bytes: int) -> npt.NDArray[np.uint8]:
        for _ in range(len(self._idle)):
            try:
                memory = self._idle.popleft()
            except IndexError:
                break
            if memory.nbytes == n_bytes:
                return memory
            self._idle.append(memory)
        # numpy asks for huge pages, where the system has them.
        return np.empty(n_bytes, dtype=np.uint8)


def shared_tensor(array: npt.NDArray[Any]) -> torch.Tensor:
    """Return a copy of an array that a DataLoader's worker can send to the trainer without another copy.

    It is written to a file in memory instead of to mapped memory: the system then does not clear the pages first,
    which takes longer than the copy. Where system or torch do not support it, torch's own shared memory is used.
    """
    storage = _in_memory_file(array) if array.size else None
    if storage is None:
        return torch.from_numpy(array).clone().share_memory_()  # type: ignore[no-untyped-call, no-any-return]
    kind = torch.from_numpy(np.empty(0, dtype=array.dtype)).dtype
    return torch.empty(0, dtype=kind).set_(storage, 0, array.shape)  # type: ignore[call-overload, no-any-return]


def _in_memory_file(array: npt.NDArray[Any]) -> torch.UntypedStorage | None:
    """Copy an array into a file in memory, mapped as torch shares memory; None where that is impossible."""
    # A private function of torch, which a process that receives a tensor calls; it may change.
    map_shared = getattr(torch.UntypedStorage, "_new_shared_fd_cpu", None)
    make_file = getattr(os, "memfd_create", None)
    if map_shared is None or make_file is None:
        return None
    try:
        descriptor = make_file("dancedata-batch")
    except OSError:  # not allowed here, or no descriptor is left
        return None
    try:
        left = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
        while left.nbytes:
            left = left[os.write(descriptor, left) :]
        storage: torch.UntypedStorage = map_shared(descriptor, array.nbytes)  # with a descriptor of its own
    except (OSError, RuntimeError, TypeError):
        return None
    finally:
        os.close(descriptor)
    return storage
