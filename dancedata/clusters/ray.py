"""Ray: units of work on its workers."""

from __future__ import annotations

import logging
import os
import re
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, ClassVar

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.packages import require
from dancedata.core.registry import ENGINES
from dancedata.core.system import shielded
from dancedata.core.typing import override
from dancedata.kernel import Engine, Executor, Requirements


@ENGINES.register("ray")
@dataclass(frozen=True)
class Ray(Engine):
    """A Ray cluster."""

    version: ClassVar[int] = 1
    example: ClassVar[str] = "ray://HOST:10001, or ray://auto on a machine of the cluster"
    address: ClassVar[re.Pattern[str]] = re.compile(rf"ray://{Engine.HOST}(:\d+)?/?")

    @override
    @contextmanager
    def connect(self, address: str, required: Requirements) -> Iterator[Executor]:
        """Yield the executor of a Ray cluster; ``ray://auto``: that of this process, $RAY_ADDRESS or this machine."""
        require("ray", what="the backend ray")
        # Its report of each worker that died, to the stderr of this process; workers' own output is not sent.
        os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", ".")
        import ray
        from ray.exceptions import NodeDiedError, OutOfMemoryError, WorkerCrashedError

        environment = {"env_vars": self.variables()}
        was_connected = ray.is_initialized()
        if was_connected and address != "ray://auto":
            raise UsageError(
                "this process is connected to a Ray cluster already", found=address, fix="give ray://auto"
            )
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
        def starting(label: str) -> Iterator[Callable[..., Future[Any]]]:
            # With retries it would repeat a unit that exceeds the memory for ever.
            remote = ray.remote(num_cpus=1, max_retries=0)(Executor.run_packed).options(
                name=label, runtime_env=environment
            )
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
            yield Executor(engine="the Ray cluster", deaths=deaths, check=required.check, starting=starting)
        finally:
            if not was_connected:
                ray.shutdown()
