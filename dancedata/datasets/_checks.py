"""Checks of arrays that all readers share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError

__all__ = ["require_finite"]


def require_finite(path: Path, what: str, array: NDArray[np.float64], fix: str) -> None:
    """Check that an array (T, ...) of a file is finite.

    Raises
    ------
    DataError
        ``nan``, with the first frame that is not.
    """
    bad = np.asarray(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))
    if bad.any():
        raise DataError(
            f"{what} contains values that are not finite",
            reason="nan",
            where=f"{path}, frame {int(bad.argmax())}",
            found=f"{int(bad.sum())} of {len(bad)} frames with NaN or infinity",
            fix=fix,
        )
