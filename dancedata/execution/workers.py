"""The workers of a build: processes of this machine, or those of a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dancedata.core.errors import UsageError
from dancedata.execution.cache import Cache
from dancedata.execution.executors.base import Executor
from dancedata.execution.executors.loky import LokyExecutor


@contextmanager
def start_workers(
    n: int, cache: Cache, source: Path, packages: set[str], *, backend: str = "loky", scheduler: str | None = None
) -> Iterator[Executor]:
    """Give the executor of a build; a cluster is connected, and its workers are checked before their first unit.

    Raises
    ------
    UsageError
        If Dask is not installed.
    DanceDataError
        If no scheduler answers at the address, or it has no worker.
    """
    if backend == "loky" or scheduler is None:
        yield LokyExecutor(n)
        return
    from dancedata.execution.executors.dask import DaskExecutor, connected, worker_requirements

    with connected(scheduler) as client, worker_requirements(cache, source, packages) as requirements:
        yield DaskExecutor(n, client=client, requirements=requirements)


def check_backend(backend: str, scheduler: str | None) -> None:
    """Raise UsageError unless backend and scheduler go together."""
    if backend not in ("loky", "dask"):
        raise UsageError("unknown backend", found=repr(backend), allowed="loky, dask")
    if backend == "dask" and scheduler is None:
        raise UsageError("the backend dask needs a scheduler", fix="give its address: --scheduler tcp://HOST:8786")
    if backend == "loky" and scheduler is not None:
        raise UsageError("a scheduler is for the backend dask", found=scheduler, fix="add --backend dask")
