"""Window arithmetic: the one place that counts windows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError


def count_windows(n_frames: int, length: int, stride: int) -> int:
    """Return how many windows of `length` frames, `stride` apart, fit into `n_frames` frames.

    Raises
    ------
    UsageError
        If length or stride is below one frame.
    """
    if length < 1 or stride < 1:
        raise UsageError(
            "windows need a length and a stride of at least one frame", found=f"length {length}, stride {stride}"
        )
    return (n_frames - length) // stride + 1 if n_frames >= length else 0


def window_starts(n_frames: int, length: int, stride: int) -> npt.NDArray[np.int64]:
    """Return the first frame of every window, shape (W,), ascending from 0."""
    return np.arange(count_windows(n_frames, length, stride), dtype=np.int64) * stride
