"""Checks of arguments that the readers have in common."""

from operator import index as as_int

from dancedata.core.errors import UsageError


def whole(what: str, value: int) -> int:
    """Return a whole number >= 0 as an int; integers of numpy and torch are accepted.

    UsageError for anything else.
    """
    try:
        number = as_int(value)
    except TypeError as error:
        raise UsageError(f"{what} is not a whole number", found=repr(value), allowed="0 or more") from error
    if number < 0:
        raise UsageError(f"{what} is negative", found=number, allowed="0 or more")
    return number


def probability(what: str, value: float) -> float:
    """Return a number in [0, 1]; UsageError for any other."""
    if not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise UsageError(f"{what} is a probability", found=value, allowed="0 to 1")
    return float(value)
