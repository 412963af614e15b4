"""Versions of installed distributions."""

from __future__ import annotations


def version(name: str) -> str:
    """Return the version of an installed distribution; ModuleNotFoundError if it is not installed."""
    # Here, as help and worker processes, which get their keys made, need no version: it imports a mail parser.
    import importlib.metadata

    return importlib.metadata.version(name)
