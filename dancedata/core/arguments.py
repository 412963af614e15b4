"""Checks of arguments that the readers have in common."""

from collections.abc import Iterable
from operator import index as as_int
from typing import Any

from dancedata.core.errors import UsageError
from dancedata.core.text import shown


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
