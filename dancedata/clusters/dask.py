"""Dask: units of work on its workers."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar
from uuid import uuid4

from dancedata.core.errors import DanceDataError
from dancedata.core.packages import require
from dancedata.core.registry import ENGINES
from dancedata.core.typing import override
from dancedata.kernel import Engine, Executor, Requirements

#: Seconds to wait for a cluster to answer, and for a first worker.
TIMEOUT_S = 30


@ENGINES.register("dask")
@dataclass(frozen=True)
class Dask(Engine):
    """A Dask cluster."""

    version: ClassVar[int] = 1
    example: ClassVar[str] = "tcp://HOST:8786"
    address: ClassVar[re.Pattern[str]] = re.compile(rf"((tcp|tls|ucx|wss?)://)?{Engine.HOST}:\d+(/\S*)?|inproc://\S+")

    @override
    @contextmanager
    def connect(self, address: str, required: Requirements) -> Iterator[Executor]:
        """Yield the executor of a Dask cluster, which runs the units of a dead worker on another one, a few times."""
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
        def starting(label: str) -> Iterator[Callable[..., Future[Any]]]:
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
                others = [here for here in client.run(Engine.here).values() if here != self.expected()]
                environment = ReferenceEnvironment(self.variables(), bool(others))
                client.register_plugin(environment, name="dancedata-arithmetic")
                client.wait_for_workers(1, timeout=TIMEOUT_S)
            except TimeoutError as error:
                raise DanceDataError(
                    "the Dask cluster has no worker",
                    where=address,
                    fix="start some: dask worker ADDRESS --nworkers 4 --nthreads 1",
                ) from error
            except Exception as error:  # such as a worker without dancedata
                raise Executor.lost("the Dask cluster", error) from error
            yield Executor(engine="the Dask cluster", deaths=(KilledWorker,), check=required.check, starting=starting)
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
