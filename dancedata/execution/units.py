"""Runs units of work with any executor; units whose worker process died are run again, here for all executors.

A unit is a call of a function with small arguments that leaves its arrays in the cache.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from dancedata.core.errors import DanceDataError
from dancedata.execution import arithmetic
from dancedata.execution.cache import Cache
from dancedata.execution.executors import Call, Executor, OnResult, first_line
from dancedata.execution.progress import Progress

if TYPE_CHECKING:
    from dancedata.execution.engines import Engine

R = TypeVar("R")
#: A number of processes on this machine, or an executor.
Jobs = int | Executor

#: After how many runs that end with the death of a worker, which runs nothing else, a unit is named as its cause.
_DEATHS_ALONE = 2
#: Consecutive deaths of workers that have not run a unit, after which a stage ends.
_BLIND_DEATHS = 3


def engine_of(backend: str | None, scheduler: str | None) -> "Engine | None":
    """Return the engine of a cluster, see `engine_at`; None without one."""
    if backend is None and scheduler is None:
        return None
    from dancedata.execution.engines import engine_at

    return engine_at(backend, scheduler)


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
    """Yield the executor of a build; a cluster's workers are checked before their first unit."""
    engine = engine_of(backend, scheduler)
    if engine is None or scheduler is None:
        yield Executor(n)
        return
    from dancedata.execution.requirements import requirements_of

    with requirements_of(cache, source, packages) as required, engine.connect(scheduler, required) as executor:
        yield executor


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
    """Return function(*call) for every call, in order, computed on one thread: sums in another order would differ.

    Where a worker process dies (out of memory, a crash in a decoder), the units that it may have been running are
    run again, one at a time; DanceDataError names one that kills its worker even then.

    `label`: Name of the stage.
    `cached`: Results of earlier runs, None for each missing one; only these are computed.
    `exact`: Compute with the instructions that results are promised for, see `arithmetic`, by a worker if need be.
    """
    if not calls:
        return []
    results: list[Any] = list(cached) or [None] * len(calls)
    missing = {index: call for index, call in enumerate(calls) if results[index] is None}
    with progress.stage(label, len(calls), known=len(calls) - len(missing)) as advance:

        def keep(index: int, result: R) -> None:
            results[index] = result
            advance(1)

        run = partial(arithmetic.on_one_thread, function)
        executor = Executor(jobs) if isinstance(jobs, int) else jobs
        if executor.is_here(len(missing), exact):
            for index, call in missing.items():
                keep(index, run(*call))
        else:
            _run(executor, run, missing, label, keep)
    return results


def _run(
    executor: Executor, function: Callable[..., Any], left: dict[int, Call], label: str, on_result: OnResult
) -> None:
    """Run calls until none is left; those that may have killed a worker run alone."""

    def finish(index: int, result: Any) -> None:
        del left[index]
        on_result(index, result)

    while left:
        suspects = executor.run(function, dict(left), label, finish)
        if suspects and (death := _death(executor, _nothing, 0, (function,), label, _BLIND_DEATHS, _nothing)):
            # No unit is blamed where workers die before they run one.
            raise DanceDataError(
                f"worker processes die during {label} before they run a unit of work",
                found=f"{_BLIND_DEATHS} times: {first_line(death)}",
                fix="run the same command again to resume; if memory ran out, with fewer --jobs",
            ) from death
        for index in suspects:
            call = left[index]
            if death := _death(executor, function, index, call, label, _DEATHS_ALONE, finish):
                raise DanceDataError(
                    f"this unit of work kills its worker process ({label})",
                    where=_unit_name(call),
                    found=f"{_DEATHS_ALONE} times, running alone: {first_line(death)}",
                    fix="if memory ran out, use a machine with more; else remove the file from the source",
                ) from death


def _death(
    executor: Executor,
    function: Callable[..., Any],
    index: int,
    call: Call,
    label: str,
    tries: int,
    on_result: OnResult,
) -> BaseException | None:
    """Run a call by itself; return the error if its worker dies at each of some tries."""
    dead: dict[int, BaseException] = {}
    for _ in range(tries):
        dead = executor.run(function, {index: call}, label, on_result)
        if not dead:
            return None
    return dead[index]


def _nothing(*arguments: Any) -> None:
    """Do nothing: a worker that has received a function has imported its modules."""


def _unit_name(call: Call) -> str:
    """Return the clip and the file that a unit of work reads, found among its arguments, for messages."""
    for argument in call:
        path = getattr(argument, "motion_path", None)
        if path is not None:
            return f"clip {argument.id} ({path})"
        path = argument if isinstance(argument, Path) else getattr(argument, "path", None)
        if isinstance(path, Path):
            return str(path)
    return "unit"


def in_reference(function: Callable[..., R], *args: Any) -> R:
    """Return ``function(*args)`` as a build computes it: on one thread, with the instructions of `expected`."""
    if arithmetic.here() == arithmetic.expected():
        return arithmetic.on_one_thread(function, *args)
    return run_units(function, [args], jobs=1, label="one unit", progress=Progress(quiet=True))[0]


def unit_runner(exact: bool) -> Callable[..., Any]:
    """Return the wrapper in which builds run units: `in_reference` or `on_one_thread`."""
    return in_reference if exact else arithmetic.on_one_thread
