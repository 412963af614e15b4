"""Checks of arguments that the readers have in common."""

from operator import index as as_int

from dancedata.core.errors import UsageError


def whole(what: str, value: int, least: int = 0) -> int:
    """Return a whole number >= `least` as an int, also of numpy and torch; UsageError for anything else."""
    allowed = f"{least} or more"
    try:
        number = as_int(value)
    except TypeError as error:
        raise UsageError(f"{what} is not a whole number", found=repr(value), allowed=allowed) from error
    if number < least:
        raise UsageError(f"{what} is {'too small' if least else 'negative'}", found=number, allowed=allowed)
    return number


def probability(what: str, value: float) -> float:
    """Return a number in [0, 1]; UsageError for any other."""
    if not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise UsageError(f"{what} is a probability", found=value, allowed="0 to 1")
    return float(value)
