"""How many threads write a dataset."""

from __future__ import annotations

import os

#: Memory and the disk are shared: more threads do not write faster.
_MOST = 4


def n_threads() -> int:
    """Return the number of threads for work that runs outside the interpreter's lock: one per core, at most 4."""
    return min(_MOST, len(os.sched_getaffinity(0)))
