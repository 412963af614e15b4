"""Computes again the entries of the cache that are found missing or damaged while a build uses them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from dancedata.execution.cache import Cache, EntryLostError
from dancedata.execution.progress import Progress

#: How often a build starts again because entries were removed or damaged while it ran.
LOST_ENTRIES = 3

T = TypeVar("T")


def with_lost_entries(cache: Cache, run: Callable[[Cache], T], progress: Progress) -> T:
    """Run a build, and run it again if an entry of the cache is lost.

    Checksums of arrays are compared when arrays are read, which may be late. After the first mismatch, those of all
    entries are compared when they are looked up: all damaged entries are then computed again in one go.

    Raises
    ------
    EntryLostError
        If entries are lost repeatedly: something removes them, or the disk is failing.
    """
    for _ in range(LOST_ENTRIES):
        try:
            return run(cache)
        except EntryLostError as error:
            progress.write(f"{error.where}: {error.problem}; all entries are compared with their checksums now")
            cache = replace(cache, careful=True)
    return run(cache)
