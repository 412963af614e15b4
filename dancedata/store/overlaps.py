"""Rows that the overlapping windows of a clip have in common.

In window scope a frame is stored once per window that covers it. Most columns have the same value in each of them:
statistics then need it once, with the number of windows.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

#: Per field of motion: which columns have the same value in all windows that cover a frame; (D,).
SameColumns = Mapping[str, BoolArray]


def same_columns(windows: npt.NDArray[Any], starts: IntArray) -> BoolArray:
    """Tell which columns have, in every two windows that follow one another, the same values where these overlap.

    Parameters
    ----------
    windows
        (W, L, D), by start.
    starts
        (W,) row at which each window begins, ascending.

    Returns
    -------
    (D,) bool
    """
    length = windows.shape[1]
    same = np.ones(windows.shape[2], dtype=np.bool_)
    for (one, start), (other, later) in pairwise(zip(windows, starts.tolist(), strict=True)):
        step = later - start
        if step < length:
            same &= (one[step:] == other[: length - step]).all(axis=0)
    return same


def rows_once(starts: IntArray, length: int) -> npt.NDArray[np.int32]:
    """Count the windows of a clip that cover each row, at the first window that does; 0 at the others.

    Parameters
    ----------
    starts
        (W,) row at which each window begins, ascending.
    length
        Rows L of a window.

    Returns
    -------
    (W, L) int32
    """
    numbers = np.arange(len(starts))[:, None]
    rows = starts[:, None] + np.arange(length)
    seen = np.r_[starts[:1], starts[:-1] + length][:, None]
    counts = np.where(rows >= seen, np.searchsorted(starts, rows, "right") - numbers, 0)
    return counts.astype(np.int32)
