"""Number of threads, and instructions, that results are computed with: the same for every build."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any, TypeVar

T = TypeVar("T")


def exactly(function: Callable[..., T], *args: Any) -> T:
    """Return ``function(*args)`` as a build computes it: on one thread, with the instructions of `expected`.

    Raises
    ------
    ReferenceProcessError
        As for `reference_process.compute`.
    """
    # Here, as exports, which `list` loads, name this function and seldom call it.
    from dancedata.execution.reference_process import compute

    found: T = compute(on_one_thread, function, *args)
    return found


def as_in_builds(exact: bool) -> Callable[..., Any]:
    """Return the one of `exactly` and `on_one_thread` by which a build calls units, such as those of a feature."""
    return exactly if exact else on_one_thread


def on_one_thread(function: Callable[..., T], *args: Any) -> T:
    """Return ``function(*args)``, computed on one thread."""
    with one_thread():
        return function(*args)


def one_thread() -> AbstractContextManager[Any]:
    """Run BLAS and OpenMP on one thread within the context, so that the last digits do not depend on their number."""
    # Modules load libraries: these are looked up again after imports, which takes a millisecond.
    limits: AbstractContextManager[Any] = _thread_pools(len(sys.modules)).limit(limits=1)
    return limits


@lru_cache(maxsize=1)
def _thread_pools(n_modules: int) -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
