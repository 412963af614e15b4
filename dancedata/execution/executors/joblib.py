"""Engine of a backend of joblib: one that joblib has, Spark's, or one that the user registered."""

from __future__ import annotations

import os
import socket
import sys
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.packages import require
from dancedata.execution.arithmetic import adopted_by_children, one_thread
from dancedata.execution.executors.base import Call, Executor, OnResult, first_line
from dancedata.execution.executors.remote import (
    Answers,
    WorkerRequirements,
    failed,
    kept_signals,
    packed,
    run_packed,
    threads_refused,
    worker_name,
)
from dancedata.execution.reference_process import shielded

PREFIX = "joblib:"
#: Held while a unit runs in this process.
_running = threading.Lock()


class _BackendError(Exception):
    """joblib or its backend raised an error; no unit did."""


@dataclass(frozen=True, kw_only=True)
class JoblibExecutor(Executor):
    """All workers of a backend.

    joblib does not report which unit a worker was running that died: all units that were running are suspects.

    Attributes
    ----------
    backend
        Name of a backend, or an instance.
    """

    requirements: WorkerRequirements
    backend: Any

    def run(self, function: Callable[..., Any], calls: Mapping[int, Call], label: str, on_result: OnResult) -> None:
        """See `Executor.run`. An error that no unit raises counts as the death of a worker."""
        from joblib import delayed

        unit, builder = delayed(_run), _process()
        messages = {index: packed(label, function, call) for index, call in calls.items()}
        running: set[int] = set()

        def tasks() -> Iterator[Any]:
            for index, message in messages.items():
                running.add(index)
                yield unit(builder, self.requirements, index, message)

        answers = Answers(label, on_result)
        # Threads run units in this process: BLAS stays on one thread until the last unit has ended.
        with adopted_by_children(), one_thread(), warnings.catch_warnings():
            # Backends warn about the number of workers, and joblib where results are not waited for.
            warnings.simplefilter("ignore")
            outputs = self._outputs(tasks())
            try:
                for index, answer in outputs:
                    running.discard(index)
                    answers.take(index, answer)
            except _BackendError as error:
                answers.died(error.__cause__ or error, *(running or calls))
            finally:
                outputs.close()
        answers.end()

    def _outputs(self, tasks: Iterator[Any]) -> Generator[tuple[int, bytes]]:
        try:
            with shielded():  # an interrupt during the start is raised at its end
                outputs = self.parallel()(tasks)
            yield from outputs
        except Exception as error:  # backends raise errors of many types
            raise _BackendError from error

    def parallel(self) -> Any:
        """Return a joblib.Parallel of all workers; ValueError if the backend returns results only at its end."""
        from joblib import Parallel, effective_n_jobs, parallel_config

        with parallel_config(backend=self.backend):
            # With one worker joblib would run units in this process.
            workers = max(2, effective_n_jobs(-1))
            return Parallel(
                workers, return_as="generator_unordered", batch_size=1, pre_dispatch="n_jobs", max_nbytes=None
            )


def _run(builder: str, requirements: WorkerRequirements, index: int, message: bytes) -> tuple[int, bytes]:
    """Run a unit in a worker: a process, or a thread of the process that builds."""
    if _process() == builder:
        return index, run_packed("joblib", requirements, message)
    if not _running.acquire(blocking=False):
        return index, failed(threads_refused(worker_name("joblib"), "two", "give each worker one thread"))
    try:
        return index, run_packed("joblib", requirements, message)
    finally:
        _running.release()


def _process() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"


@contextmanager
def started(scheduler: str, requirements: WorkerRequirements) -> Iterator[Executor]:
    """Yield the executor of a backend, named as ``joblib:NAME``.

    Raises
    ------
    UsageError
        If joblib, or Spark, is not installed, for a name that is not registered, and for a backend that returns
        results only at its end.
    DanceDataError
        If Spark does not start.
    """
    name = scheduler.removeprefix(PREFIX)
    require("spark" if name == "spark" else "joblib", what=f"the backend {scheduler}")
    context: AbstractContextManager[Any] = _spark() if name == "spark" else nullcontext(name)
    with context as backend:
        executor = JoblibExecutor(requirements=requirements, backend=backend)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                executor.parallel()
        except (ValueError, ImportError) as error:
            raise UsageError(
                "the backend of joblib cannot be used", where=scheduler, found=first_line(error),
                allowed="one that is registered and returns results as they come: loky, threading, spark",
            ) from error  # fmt: skip
        yield executor


@contextmanager
def _spark() -> Iterator[Any]:
    """Yield the backend of the active Spark session, else of a new one, which ends with the context."""
    os.environ.setdefault("PYSPARK_PYTHON", sys.executable)
    from joblib.parallel import ThreadingBackend
    from joblibspark.backend import SparkDistributedBackend
    from pyspark.sql import SparkSession

    class Spark(SparkDistributedBackend):  # type: ignore[misc]
        """joblibspark's, which passes results to its callback, as ThreadingBackend does, and does not say so."""

        supports_retrieve_callback = True
        retrieve_result_callback = ThreadingBackend.retrieve_result_callback

    session = active = SparkSession.getActiveSession()
    if session is None:
        try:
            with kept_signals(), shielded():
                builder = SparkSession.builder.appName("dancedata")
                session = builder.config("spark.ui.showConsoleProgress", "false").getOrCreate()
        except Exception as error:  # Spark raises errors of many types
            raise DanceDataError(
                "Spark does not start",
                found=first_line(error).rstrip("."),
                fix="check spark.master and that Java is installed",
            ) from error
        session.sparkContext.setLogLevel("OFF")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield Spark()
    finally:
        if active is None:
            session.stop()
