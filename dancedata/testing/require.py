"""Expectations of the conformance suite."""

from __future__ import annotations

from collections.abc import Callable


def require(condition: bool, expected: str) -> None:
    """Raise AssertionError with what was expected, if it is not so."""
    if not condition:
        raise AssertionError(f"expected: {expected}")


def raises(kind: type[Exception], call: Callable[[], object], expected: str) -> str:
    """Return the text of the error that a call ends with; AssertionError if it ends without one of that kind."""
    try:
        call()
    except kind as error:
        return str(error)
    raise AssertionError(f"expected: {expected}")
