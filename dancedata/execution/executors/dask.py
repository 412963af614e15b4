"""Engine of a Dask cluster, whose workers are checked before their first unit."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from dancedata.core.errors import DanceDataError
from dancedata.core.packages import require
from dancedata.execution.executors.base import Call, Executor, OnResult
from dancedata.execution.executors.remote import (
    TIMEOUT_S,
    Answers,
    WorkerRequirements,
    lost,
    packed,
    run_packed,
    threads_refused,
)

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True, kw_only=True)
class DaskExecutor(Executor):
    """The workers of a cluster, each checked before its first unit; they may join and leave at any time.

    Where a worker dies, Dask runs its units on another one. It gives up units whose workers died several times
    (``distributed.scheduler.allowed-failures``); these are the suspects.
    """

    client: Client
    requirements: WorkerRequirements

    def run(self, function: Callable[..., Any], calls: Mapping[int, Call], label: str, on_result: OnResult) -> None:
        """See `Executor.run`. All units go to the scheduler at once: workers may join later.

        Raises
        ------
        DanceDataError
            If the scheduler is lost, or a worker does not meet the requirements.
        """
        from distributed import KilledWorker, as_completed

        units = [packed(label, function, call) for call in calls.values()]
        try:
            futures = self.client.map(partial(_run, self.requirements), units, key=label, pure=False)
        except OSError as error:
            raise lost("Dask", label, error) from error
        numbers = dict(zip(futures, calls, strict=True))
        answers = Answers(label, on_result)
        try:
            done = as_completed(futures, self.client.loop, with_results=True, raise_errors=False)  # type: ignore[no-untyped-call]
            for future, outcome in done:
                if future.status == "finished":
                    answers.take(numbers[future], outcome)
                elif future.status != "error":
                    raise lost("Dask", label, outcome)
                elif isinstance(outcome[1], KilledWorker):
                    answers.died(outcome[1], numbers[future], deaths=outcome[1].allowed_failures + 1)
                else:
                    raise outcome[1]
        finally:
            for future in futures:
                future.release()  # type: ignore[no-untyped-call]
        answers.end()


def _run(requirements: WorkerRequirements, message: bytes) -> bytes:
    """Run a unit in a worker process."""
    from distributed import get_worker

    worker = get_worker()
    if worker.state.nthreads != 1:
        fix = "start workers with --nthreads 1, and more of them"
        raise threads_refused(f"Dask worker {worker.address}", f"{worker.state.nthreads} threads", fix)
    return run_packed("Dask", requirements, message)


@contextmanager
def started(scheduler: str, requirements: WorkerRequirements) -> Iterator[Executor]:
    """Yield the executor of a cluster; errors as of `connected`."""
    with connected(scheduler) as client:
        yield DaskExecutor(client=client, requirements=requirements)


@contextmanager
def connected(scheduler: str) -> Iterator[Client]:
    """Yield a client of the cluster whose scheduler has this address.

    Raises
    ------
    UsageError
        If Dask is not installed.
    DanceDataError
        If no scheduler answers there, or it has no worker.
    """
    require("dask", what="the backend dask")
    from distributed import Client

    try:
        client = Client(scheduler, timeout=TIMEOUT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as error:
        raise DanceDataError(
            "no Dask scheduler answers at this address",
            where=scheduler,
            found=str(error) or type(error).__name__,
            fix="check that it runs and that this machine can reach it",
        ) from error
    try:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT_S)
        except TimeoutError as error:
            raise DanceDataError(
                "the Dask cluster has no worker",
                where=scheduler,
                fix="start some: dask worker ADDRESS --nworkers 4 --nthreads 1",
            ) from error
        yield client
    finally:
        _close(client)


def _close(client: Client) -> None:
    """Close a client without messages about units that are still running."""
    # distributed sets levels on several of its loggers.
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]
    loggers = [logging.getLogger(name) for name in ("tornado.application", *names)]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        client.close()  # type: ignore[no-untyped-call]
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
