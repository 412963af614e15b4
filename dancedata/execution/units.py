"""Runs units of work with any executor; units whose worker process died are run again, here for all executors.

A unit is a call of a function with small arguments that leaves its arrays in the cache.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.plugin_files import with_known_files
from dancedata.execution.arithmetic import as_in_builds
from dancedata.execution.cache import Cache
from dancedata.execution.executors.base import Call, Executor, OnResult, WorkerDiedError, unit_name
from dancedata.execution.executors.loky import LokyExecutor
from dancedata.execution.executors.remote import worker_requirements
from dancedata.execution.progress import Progress

R = TypeVar("R")
#: A number of processes on this machine, or an executor.
Jobs = int | Executor

#: Backends that need a scheduler, and the form of its address.
SCHEDULERS = {
    "dask": "tcp://HOST:8786",
    "ray": "ray://HOST:10001, or ray://auto on a machine of the cluster",
    "joblib": "joblib:NAME, such as joblib:spark",
}
_HOST = r"(\[[^\]\s]+\]|[^\s:/\[\]]+)"
_ADDRESSES = {
    "dask": re.compile(rf"((tcp|tls|ucx|wss?)://)?{_HOST}:\d+(/\S*)?|inproc://\S+"),
    "ray": re.compile(rf"ray://{_HOST}(:\d+)?/?"),
    "joblib": re.compile(r"joblib:\S+"),
}
#: After how many deaths of a worker that runs nothing else a unit is named as their cause.
DEATHS_ALONE = 2
#: Consecutive deaths of workers that have not run a unit, after which a stage ends.
BLIND_DEATHS = 3


@contextmanager
def start_workers(
    n: int,
    cache: Cache,
    source: Path,
    packages: set[str],
    *,
    backend: str | None = None,
    scheduler: str | None = None,
) -> Iterator[Executor]:
    """Yield the executor of a build; a cluster is connected, and its workers are checked before their first unit.

    Raises
    ------
    UsageError
        As for `check_backend`, and if the cluster's package is not installed.
    DanceDataError
        If no cluster answers at the address, or it has no worker.
    """
    engine = check_backend(backend, scheduler)
    if scheduler is None:
        yield LokyExecutor(n)
        return
    started = import_module(f"{__package__}.executors.{engine}").started  # builds without a cluster load none of it
    with worker_requirements(cache, source, packages) as requirements, started(scheduler, requirements) as executor:
        yield executor


def check_backend(backend: str | None, scheduler: str | None) -> str:
    """Return the engine: that of the scheduler's address, or loky.

    Raises
    ------
    UsageError
        For an unknown backend, and unless backend and scheduler go together.
    """
    if backend not in (None, "loky", *SCHEDULERS):
        raise UsageError("unknown backend", found=repr(backend), allowed=", ".join(("loky", *SCHEDULERS)))
    if scheduler is None:
        if backend in SCHEDULERS:
            fix = f"give its address: --scheduler {SCHEDULERS[backend]}"
            raise UsageError(f"the backend {backend} needs a scheduler", fix=fix)
        return "loky"
    engine = next((name for name in ("ray", "joblib") if scheduler.startswith(f"{name}:")), "dask")
    if backend not in (None, engine):
        raise UsageError(
            f"the scheduler has an address of {engine}", found=f"--backend {backend}", fix="leave --backend out"
        )
    if _ADDRESSES[engine].fullmatch(scheduler) is None:
        allowed = "; ".join(SCHEDULERS.values()) if engine == "dask" else SCHEDULERS[engine]
        raise UsageError("not the address of a scheduler, or not a complete one", found=scheduler, allowed=allowed)
    return engine


def run_units(
    function: Callable[..., R],
    calls: Sequence[Call],
    *,
    jobs: Jobs,
    label: str,
    progress: Progress,
    cached: Sequence[object] = (),
    exact: bool = True,
) -> list[R]:
    """Return function(*call) for every call, in order.

    BLAS and OpenMP run on one thread in each worker, for any `jobs`: sums in another order would change
    last digits, and builds have to be byte-identical.

    Where a worker process dies (out of memory, a crash in a decoder), the units that it may have been running are
    run again, one at a time, and the others continue. Results in the cache are not computed again.

    Parameters
    ----------
    label
        Name of the stage, shown as its progress and in messages.
    cached
        Results of earlier runs, None for each missing one; only these are computed.
    exact
        Compute with the instructions that results are promised for, see `arithmetic`; in another process if this
        one has loaded libraries that use others.

    Raises
    ------
    DanceDataError
        For a unit that kills its worker even when it runs alone, by name.
    """
    if not calls:
        return []
    results: list[Any] = list(cached) or [None] * len(calls)
    missing = {index: call for index, call in enumerate(calls) if results[index] is None}
    with progress.stage(label, len(calls), known=len(calls) - len(missing)) as advance:

        def keep(index: int, result: R) -> None:
            results[index] = result
            advance(1)

        if missing:
            executor = (LokyExecutor(jobs) if isinstance(jobs, int) else jobs).for_calls(len(missing))
            # Local plug-ins among the arguments are unpickled after the function, here and in a reference process.
            run = with_known_files(partial(as_in_builds(exact), with_known_files(function)))
            _run(executor, run, missing, label, keep)
    return results


def _run(
    executor: Executor, function: Callable[..., Any], calls: Mapping[int, Call], label: str, on_result: OnResult
) -> None:
    left = dict(calls)

    def finish(index: int, result: Any) -> None:
        del left[index]
        on_result(index, result)

    while left:
        try:
            executor.run(function, dict(left), label, finish)
        except WorkerDiedError as death:
            _check_that_workers_start(executor, function, label)
            for index in death.suspects:
                _run_alone(executor, function, index, left[index], label, finish)


def _check_that_workers_start(executor: Executor, function: Callable[..., Any], label: str) -> None:
    """Raise if workers die before they run a unit, so that no unit is blamed for it."""
    calls = {0: (function,)}
    death = _last_death(BLIND_DEATHS, lambda: executor.run(_import, calls, label, lambda index, result: None))
    if death is not None:
        raise DanceDataError(
            f"worker processes die during {label} before they run a unit of work",
            found=f"{death.deaths} times: {death}",
            fix="run the same command again to resume; if memory ran out, with fewer --jobs",
        ) from death


def _run_alone(
    executor: Executor, function: Callable[..., Any], index: int, call: Call, label: str, on_result: OnResult
) -> None:
    death = _last_death(DEATHS_ALONE, lambda: executor.run(function, {index: call}, label, on_result))
    if death is not None:
        raise DanceDataError(
            f"this unit of work kills its worker process ({label})",
            where=unit_name(call),
            found=f"{death.deaths} times, running alone: {death}",
            fix="if memory ran out, use a machine with more; else remove the file from the source and report it",
        ) from death


def _last_death(limit: int, run: Callable[[], None]) -> WorkerDiedError | None:
    """Call `run` until no worker dies; after `limit` deaths return the last one, with the number of all."""
    deaths = 0
    while True:
        try:
            run()
        except WorkerDiedError as death:
            deaths += death.deaths
            if deaths >= limit:
                death.deaths = deaths
                return death
        else:
            return None


def _import(function: Callable[..., Any]) -> None:
    """Do nothing: a worker that has received the function has imported its modules."""
