"""Arrays over time: lengths of vectors, and runs of frames."""

from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.rotations import Float64Array


def lengths(vectors: Float64Array) -> Float64Array:
    """Return the lengths of vectors (..., 3)."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))


def runs(mask: npt.NDArray[Any], least: float = 1) -> list[tuple[int, int]]:
    """Return the maximal runs [start, stop) of true values in a mask (T,) that have at least `least` frames."""
    borders = np.flatnonzero(np.diff(np.r_[False, np.asarray(mask, dtype=np.bool_), False])).reshape(-1, 2)
    return [(int(start), int(stop)) for start, stop in borders if stop - start >= least]
