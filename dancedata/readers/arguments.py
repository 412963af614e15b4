"""Checks of arguments that the readers have in common."""

from __future__ import annotations

from operator import index as as_int

from dancedata.core.errors import UsageError


def whole(what: str, value: int) -> int:
    """Return a whole number >= 0 as an int; numpy's and torch's integers are fine.

    Raises
    ------
    UsageError
        For anything else.
    """
    try:
        number = as_int(value)
    except TypeError as error:
        raise UsageError(f"{what} is not a whole number", found=repr(value), allowed="0 or more") from error
    if number < 0:
        raise UsageError(f"{what} is negative", found=number, allowed="0 or more")
    return number
