"""An expectation of the conformance suite."""

from __future__ import annotations


def require(condition: bool, expected: str) -> None:
    """Raise AssertionError with what was expected, if it is not so."""
    if not condition:
        raise AssertionError(f"expected: {expected}")
