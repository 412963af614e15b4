"""Arguments that functions have in common: paths and checks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from operator import index as as_int
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DataError, UsageError
from dancedata.core.text import shown

if TYPE_CHECKING:
    from torch import Tensor

#: Keys of a recipe to change: ``["windows.stride_s=1"]`` or ``{"windows.stride_s": 1}``.
Overrides = Iterable[str] | Mapping[str, Any]


def folder_of(path: str | Path | None) -> Path | None:
    """Return a path with ~ expanded; None for None."""
    return None if path is None else Path(path).expanduser()


def whole(what: str, value: int, least: int = 0, most: int | None = None) -> int:
    """Return a whole number >= `least` as an int, also of numpy and torch; UsageError for anything else."""
    allowed = f"{least} or more" if most is None else f"{least} to {most}"
    try:
        if isinstance(value, bool):
            raise TypeError
        number = as_int(value)
    except TypeError as error:
        raise UsageError(f"{what} is not a whole number", found=shown(value), allowed=allowed) from error
    if number < least or (most is not None and number > most):
        size = "too large" if number >= least else "too small" if least else "negative"
        raise UsageError(f"{what} is {size}", found=number, allowed=allowed)
    return number


def names(what: str, value: Any) -> tuple[str, ...]:
    """Return names as a tuple; one may stand alone; UsageError for anything but texts."""
    texts = (value,) if isinstance(value, str) or not isinstance(value, Iterable) else tuple(value)
    if not all(isinstance(text, str) for text in texts):
        raise UsageError(f"{what} does not consist of names", found=shown(value), allowed="a text, or several")
    return texts


def probability(what: str, value: float) -> float:
    """Return a number in [0, 1]; UsageError for any other."""
    if not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise UsageError(f"{what} is a probability", found=value, allowed="0 to 1")
    return float(value)


def require_finite(array: npt.NDArray[Any], what: str, each: str = "frame") -> None:
    """Raise DataError "nan" unless all values of each frame, or sample, along the first axis are finite."""
    bad = ~np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
    if bad.any():
        found = f"{int(bad.sum())} of {len(bad)} {each}s, the first at {each} {int(np.argmax(bad))}"
        raise DataError(f"{what} contains NaN or infinity", reason="nan", found=found)


def as_numpy(batch: npt.ArrayLike | Tensor) -> npt.NDArray[Any]:
    """Return a batch as an array of this process; tensors may be on any device."""
    return np.asarray(batch.detach().float().cpu().numpy() if hasattr(batch, "detach") else batch)
