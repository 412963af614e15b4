"""Engines of clusters: Dask and Ray."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import Any
from uuid import uuid4

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.packages import require
from dancedata.core.system import shielded
from dancedata.execution import arithmetic
from dancedata.execution.executors import Executor, Start, lost, run_packed
from dancedata.execution.requirements import Requirements

#: Seconds to wait for a cluster to answer, and for a first worker.
TIMEOUT_S = 30


@contextmanager
def dask(address: str, required: Requirements) -> Iterator[Executor]:
    """Yield the executor of a Dask cluster.

    Where a worker dies, Dask runs its units on another one. It gives up units whose workers died several times
    (``distributed.scheduler.allowed-failures``).

    Raises UsageError: if Dask is not installed.
    Raises DanceDataError: if no scheduler answers at the address, or it has no worker.
    """
    require("dask", what="the backend dask")
    from distributed import Client, KilledWorker, NannyPlugin

    class ReferenceEnvironment(NannyPlugin):
        """Nannies start their workers with the variables; those of now again, if they compute otherwise."""

        def __init__(self, environment: dict[str, str], restart: bool) -> None:
            self.environment, self.restart = environment, restart

        async def setup(self, nanny: Any) -> None:
            nanny.pre_spawn_env.update(self.environment)  # `env` is set when numpy has been loaded

    try:
        client = Client(address, timeout=TIMEOUT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as error:
        raise DanceDataError("no Dask scheduler answers at this address", where=address,
                             found=str(error) or type(error).__name__,
                             fix="check that it runs and that this machine can reach it") from error  # fmt: skip

    @contextmanager
    def starting(label: str) -> Iterator[Start]:
        units: list[Any] = []

        def start(*call: Any) -> Future[Any]:
            # Not its ClientExecutor, which loses the outcome of a unit whose worker was killed.
            future: Future[Any] = Future()
            units.append(client.submit(*call, key=f"{label}-{uuid4().hex}", pure=False))
            units[-1].add_done_callback(lambda unit: _pass_on(unit, future))
            return future

        try:
            yield start
        finally:
            for unit in units:
                unit.release()

    try:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT_S)
            others = [found for found in client.run(arithmetic.here).values() if found != arithmetic.expected()]
            environment = ReferenceEnvironment(arithmetic.variables(), bool(others))
            client.register_plugin(environment, name="dancedata-arithmetic")
            client.wait_for_workers(1, timeout=TIMEOUT_S)
        except TimeoutError as error:
            raise DanceDataError(
                "the Dask cluster has no worker",
                where=address,
                fix="start some: dask worker ADDRESS --nworkers 4 --nthreads 1",
            ) from error
        except Exception as error:  # such as a worker without dancedata
            raise lost("the Dask cluster", error) from error
        yield Executor(
            engine="the Dask cluster",
            deaths=(KilledWorker,),
            required=required,
            starting=starting,
        )
    finally:
        _close(client)


def _pass_on(unit: Any, future: Future[Any]) -> None:
    """Give a future the outcome of a unit of Dask's."""
    try:
        result = unit.result()
    except Exception as error:  # noqa: BLE001  (it is raised where the future is asked)
        future.set_exception(error)
    except BaseException as error:  # noqa: BLE001  (asyncio's CancelledError: the scheduler is gone)
        future.set_exception(ConnectionError(str(error)))
    else:
        future.set_result(result)


def _close(client: Any) -> None:
    """Close a client without messages about units that are still running."""
    before = logging.root.manager.disable
    logging.disable()
    try:
        client.close()
    finally:
        logging.disable(before)


@contextmanager
def ray(address: str, required: Requirements) -> Iterator[Executor]:
    """Yield the executor of a Ray cluster: ``ray://HOST:PORT`` (Ray Client), or ``ray://auto`` on its machines.

    ``ray://auto`` is the cluster that this process is connected to, else that of $RAY_ADDRESS, else this machine's.
    Each unit takes one CPU. Ray does not run a unit again whose worker died: with retries it would repeat a unit that
    exceeds the memory for ever.

    Raises UsageError: if Ray is not installed, or this process is connected to a cluster and an address is given.
    Raises DanceDataError: if no cluster answers.
    """
    require("ray", what="the backend ray")
    # Its report of each worker that died, to the stderr of this process; workers' own output is not sent.
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", ".")
    import ray
    from ray.exceptions import NodeDiedError, OutOfMemoryError, WorkerCrashedError

    environment = {"env_vars": arithmetic.variables()}
    was_connected = ray.is_initialized()
    if was_connected and address != "ray://auto":
        raise UsageError("this process is connected to a Ray cluster already", found=address, fix="give ray://auto")
    if not was_connected:
        try:
            # The shield also keeps the handlers of signals, which Ray replaces. Warnings stand beside its error.
            with shielded(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                where = "auto" if address == "ray://auto" else address
                ray.init(address=where, logging_level=logging.ERROR, log_to_driver=False)
        except Exception as error:  # Ray raises errors of many types
            lines = str(error).strip().split("\n")
            raise DanceDataError(
                "no Ray cluster answers at this address",
                where=address,
                # With the last where a traceback of Ray Client's server comes between.
                found=f"{lines[0]} {lines[-1]}" if lines[0].endswith(":") else lines[0] or type(error).__name__,
                fix="check that it runs and that this machine can reach it; if it needs a token, set "
                "RAY_AUTH_MODE=token; start the head of Ray Client with GRPC_ENABLE_FORK_SUPPORT=0",
            ) from error

    @contextmanager
    def starting(label: str) -> Iterator[Start]:
        remote = ray.remote(num_cpus=1, max_retries=0)(run_packed).options(name=label, runtime_env=environment)
        units: list[Any] = []

        def start(_: Callable[..., Any], *call: Any) -> Future[Any]:
            units.append(remote.remote(*call))
            future: Future[Any] = units[-1].future()
            return future

        try:
            yield start
        except BaseException:
            with suppress(Exception):  # the cluster may be gone
                for unit in units:
                    ray.cancel(unit, force=True)  # its worker is killed; nothing happens where it has ended
            raise

    try:
        deaths = (WorkerCrashedError, OutOfMemoryError, NodeDiedError)
        yield Executor(engine="the Ray cluster", deaths=deaths, required=required, starting=starting)
    finally:
        if not was_connected:
            ray.shutdown()
