"""Entries of the cache that turn out to be gone or damaged while a build uses them: they are computed again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from dancedata.execution.cache import Cache, EntryLostError
from dancedata.execution.progress import Progress

#: How often a build begins again because of entries that were removed or damaged while it ran.
LOST_ENTRIES = 3

T = TypeVar("T")


def with_lost_entries(cache: Cache, run: Callable[[Cache], T], progress: Progress) -> T:
    """Run a build, and again where an entry of the cache is lost.

    Checksums of arrays are compared when they are read, which may be late. After the first that is wrong, those of
    all entries are compared when they are looked up: however many are damaged, all are computed again at once.

    Raises
    ------
    EntryLostError
        If entries are lost again and again: something removes them, or the disk is failing.
    """
    for _ in range(LOST_ENTRIES):
        try:
            return run(cache)
        except EntryLostError as error:
            progress.write(f"{error.where}: {error.problem}; all entries are compared with their checksums now")
            cache = replace(cache, careful=True)
    return run(cache)
