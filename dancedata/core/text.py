"""Words for messages."""

from __future__ import annotations


def counted(n: int, noun: str) -> str:
    """Return a number of things in words: "1 clip", "1,408 clips"."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"
