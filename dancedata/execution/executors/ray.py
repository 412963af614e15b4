"""Engine of a Ray cluster, whose workers are checked before their first unit."""

from __future__ import annotations

import logging
import os
import socket
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.packages import require
from dancedata.execution.executors.base import Call, Executor, OnResult, first_line
from dancedata.execution.executors.remote import (
    TIMEOUT_S,
    Answers,
    WorkerRequirements,
    kept_signals,
    lost,
    packed,
    run_packed,
)

PREFIX = "ray://"
#: How many of the oldest units are waited for at a time: a wait takes a time that is proportional to their number.
_WINDOW = 1000
#: Seconds without a result after which it is checked that the cluster is there.
_QUIET_S = 5
#: How often Ray Client is asked. Its server forks a process for each client while it runs threads of gRPC, and that
#: process sometimes dies before it begins (ray-project/ray, issue 63202); the next one is another.
_ATTEMPTS = 3
#: Seconds that a cluster may take to add its first CPU: a cloud or a batch system starts a machine.
_NO_CPU_S = 600
#: How often a unit runs elsewhere because its machine was lost; after that it may be the cause.
_LOST_NODES = 3


@dataclass(frozen=True, kw_only=True)
class RayExecutor(Executor):
    """The workers of a cluster, one CPU each, each checked before its first unit; they may join and leave.

    Ray does not run a unit again whose worker died (``max_retries=0``): with retries it would repeat a unit that
    exceeds the memory for ever. Units of a machine that is lost run elsewhere.

    Attributes
    ----------
    head
        Address of the cluster's control service, HOST:PORT; None: connected through Ray Client.
    """

    requirements: WorkerRequirements
    head: str | None

    def run(self, function: Callable[..., Any], calls: Mapping[int, Call], label: str, on_result: OnResult) -> None:
        """See `Executor.run`. All units go to the cluster at once: one that scales sees how many wait.

        Raises
        ------
        DanceDataError
            If the cluster is lost or has no CPU, or a worker does not meet the requirements.
        """
        import ray
        from ray.exceptions import NodeDiedError, OutOfMemoryError, RayError, RayTaskError, WorkerCrashedError

        remote = ray.remote(num_cpus=1, max_retries=0)(run_packed).options(name=label or "dancedata")
        answers, losses = Answers(label, on_result), Counter[int]()
        left: dict[Any, int] = {}
        begun = time.monotonic()
        try:
            for index, call in calls.items():
                left[remote.remote("Ray", self.requirements, packed(label, function, call))] = index
            while left:
                ready = _ready(list(islice(left, _WINDOW)))
                if not ready:
                    self._check(label, time.monotonic() - begun)
                for reference in ready:
                    index = left.pop(reference)
                    try:
                        answer = ray.get(reference)
                    except (WorkerCrashedError, OutOfMemoryError) as death:
                        answers.died(death, index)
                    except NodeDiedError as death:
                        losses[index] += 1
                        if losses[index] > _LOST_NODES:
                            answers.died(death, index)
                        else:
                            again = remote.remote("Ray", self.requirements, packed(label, function, calls[index]))
                            left[again] = index
                    except RayTaskError as error:
                        raise _not_run(error) from error
                    else:
                        answers.take(index, answer)
        except (RayError, ConnectionError) as error:
            raise lost("Ray", label, error) from error
        finally:
            _cancel(left)
        answers.end()

    def _check(self, label: str, waited_s: float) -> None:
        """Raise DanceDataError if the cluster does not answer, or has no CPU for a long time.

        Ray itself ends this process a minute after the control service was lost.
        """
        import ray

        if self.head is not None:
            host, _, port = self.head.rpartition(":")
            try:
                socket.create_connection((host.strip("[]"), int(port)), TIMEOUT_S).close()
            except OSError as error:
                raise lost("Ray", label, error) from error
        if waited_s > _NO_CPU_S and not ray.cluster_resources().get("CPU", 0):
            raise DanceDataError(
                "the Ray cluster has no CPU",
                found=f"none in {_NO_CPU_S // 60} minutes",
                fix="start nodes: ray start --address HOST:6379",
            )


def _ready(references: list[Any]) -> list[Any]:
    """Return those whose units have ended, after at most `_QUIET_S`."""
    import ray

    first, rest = ray.wait(references, num_returns=1, timeout=_QUIET_S)
    if not first or not rest:
        return list(first)
    more, _ = ray.wait(rest, num_returns=len(rest), timeout=0)
    return [*first, *more]


def _not_run(error: Any) -> DanceDataError:
    """Return the error for a worker that could not call `run_packed`, which raises none itself."""
    cause = error.cause if isinstance(getattr(error, "cause", None), BaseException) else error
    return DanceDataError(
        "a Ray worker cannot run units",
        found=f"{type(cause).__name__}: {first_line(cause)}",
        fix="use on all workers the environment of the machine that builds",
    )


def _cancel(references: Mapping[Any, int]) -> None:
    """Cancel units; the workers that run them are killed."""
    import ray

    for reference in references:
        try:
            ray.cancel(reference, force=True)
        except Exception:  # noqa: BLE001  (the cluster is gone, and the error that led here is raised)
            return


@contextmanager
def started(scheduler: str, requirements: WorkerRequirements) -> Iterator[Executor]:
    """Yield the executor of a cluster: ``ray://HOST:PORT`` (Ray Client), or ``ray://auto`` on one of its machines.

    ``ray://auto`` is the cluster that this process is connected to, else that of $RAY_ADDRESS, else this machine's.

    Raises
    ------
    UsageError
        If Ray is not installed, or this process is connected to a cluster and an address is given.
    DanceDataError
        If no cluster answers.
    """
    require("ray", what="the backend ray")
    # Its report of each worker that died, to the stderr of this process; workers' own output is not sent.
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", ".")
    import ray

    address = "auto" if scheduler == f"{PREFIX}auto" else scheduler
    if ray.is_initialized():
        if address != "auto":
            raise UsageError(
                "this process is connected to a Ray cluster already", found=scheduler, fix=f"give {PREFIX}auto"
            )
        yield _executor(requirements)
        return
    _connect(scheduler, address)
    try:
        yield _executor(requirements)
    finally:
        ray.shutdown()


def _connect(scheduler: str, address: str) -> None:
    """Connect this process to the cluster; again where the process that Ray Client's server forks for it has died."""
    import ray

    for attempt in range(1, _ATTEMPTS + 1):
        try:
            with kept_signals(), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of Ray Client, beside its error
                ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
            return
        except Exception as error:  # Ray raises errors of many types
            died = isinstance(error, ConnectionAbortedError)
            if died and attempt < _ATTEMPTS:
                continue
            raise DanceDataError(
                "no Ray cluster answers at this address",
                where=scheduler,
                found=_reason(error),
                fix="start its head with GRPC_ENABLE_FORK_SUPPORT=0, or build on one of its machines with ray://auto"
                if died
                else "check that it runs and that this machine can reach it; if it needs a token, set "
                "RAY_AUTH_MODE=token",
            ) from error


def _reason(error: Exception) -> str:
    """Return the first line of an error; with the last where a traceback of Ray Client's server comes between."""
    lines = str(error).strip().split("\n")
    return f"{lines[0]} {lines[-1]}" if lines[0].endswith(":") else lines[0] or type(error).__name__


def _executor(requirements: WorkerRequirements) -> RayExecutor:
    import ray

    # Through Ray Client this process knows the cluster by the address of the client's server only.
    is_client = ray.util.client.ray.is_connected()
    head = None if is_client else ray.get_runtime_context().gcs_address
    return RayExecutor(requirements=requirements, head=head)
