"""Engine of a Dask cluster, whose workers are checked before their first unit."""

from __future__ import annotations

import hashlib
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dancedata.core.errors import DanceDataError
from dancedata.core.packages import require
from dancedata.core.version import __version__
from dancedata.execution.cache import Cache, package_version
from dancedata.execution.cache_files import TEMPORARY, locked_file, temporary_name
from dancedata.execution.executors.base import Call, Executor, OnResult, WorkerDiedError, first_line
from dancedata.execution.reference_process import expected
from dancedata.files.locks import is_abandoned

if TYPE_CHECKING:
    from distributed import Client

#: Seconds to wait for the scheduler, and for a first worker.
TIMEOUT_S = 30


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

        # partial() hides arguments from Dask's key traversal.
        units = [partial(function, *call) for call in calls.values()]
        try:
            futures = self.client.map(partial(_run_checked, self.requirements), units, key=label, pure=False)
        except OSError as error:
            raise _lost(label, error) from error
        numbers = dict(zip(futures, calls, strict=True))
        suspects, killed = [], None
        try:
            done = as_completed(futures, self.client.loop, with_results=True, raise_errors=False)  # type: ignore[no-untyped-call]
            for future, outcome in done:
                if future.status == "finished":
                    on_result(numbers[future], outcome)
                elif future.status != "error":
                    raise _lost(label, outcome)
                elif isinstance(outcome[1], KilledWorker):
                    suspects.append(numbers[future])
                    killed = outcome[1]
                else:
                    raise outcome[1]
        finally:
            for future in futures:
                future.release()  # type: ignore[no-untyped-call]
        if killed is not None:
            raise WorkerDiedError(first_line(killed), sorted(suspects), killed.allowed_failures + 1) from killed


def _run_checked(requirements: WorkerRequirements, unit: Callable[[], Any]) -> Any:
    """Run a unit in a worker process."""
    check_worker(requirements)
    return unit()


def _lost(label: str, error: object) -> DanceDataError:
    cause = f"{type(error).__name__}: {first_line(error)}" if isinstance(error, BaseException) else str(error)
    return DanceDataError(
        f"the Dask cluster was lost during {label}",
        found=cause,
        fix="check that the scheduler runs, then run the same command again to resume",
    )


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


@dataclass(frozen=True)
class WorkerRequirements:
    """Requirements of a worker.

    Attributes
    ----------
    token, token_text
        A file in the cache, locked by the build, and its content: whether the worker sees the same cache.
    source, names_sha256
        The source folder and a hash of the names in it.
    versions
        Of Python, dancedata and the packages that shape numbers.
    """

    token: Path
    token_text: str
    source: Path
    names_sha256: str
    versions: tuple[tuple[str, str], ...]


@contextmanager
def worker_requirements(cache: Cache, source: Path, packages: set[str]) -> Iterator[WorkerRequirements]:
    """Yield the requirements of a build that reads `source` and computes with `packages`."""
    text = temporary_name()
    with locked_file(cache.root / TEMPORARY, f"{text}.token") as token:
        token.write_text(text, encoding="utf-8", newline="\n")
        yield WorkerRequirements(token, text, source, _names_sha256(source), _versions(packages))


@lru_cache(maxsize=8)
def check_worker(required: WorkerRequirements) -> None:
    """Raise DanceDataError unless this Dask worker meets the requirements; checked once per process and build.

    Workers may join a cluster at any time, so a check at the start of a build is not enough. A worker that does not
    see the source would reject every clip.
    """
    from distributed import get_worker

    worker = get_worker()
    where = f"Dask worker {worker.address}"
    if worker.state.nthreads != 1:
        # Threads of one process would undo each other's limit on BLAS, and with it the last digits.
        raise DanceDataError(
            "a worker runs several units at once in threads",
            where=where,
            found=f"{worker.state.nthreads} threads",
            fix="start workers with --nthreads 1, and more of them",
        )
    _check_cache(where, required)
    _check_source(where, required)
    _check_versions(where, dict(required.versions))


_FIX = "workers need the cache, the source and the same paths: a shared file system"


def _check_cache(where: str, required: WorkerRequirements) -> None:
    try:
        if required.token.read_text(encoding="utf-8") != required.token_text:
            raise DanceDataError("a worker sees another cache", where=where, found=required.token, fix=_FIX)
    except OSError as error:
        raise DanceDataError("a worker does not see the cache", where=where, found=str(error), fix=_FIX) from error
    if is_abandoned(required.token):
        # The build holds its lock. A worker would also remove files that other machines are writing.
        raise DanceDataError(
            "locks on files in the cache do not reach from one machine to another",
            where=where,
            found=f"a lock on {required.token.name} that the build holds and the worker does not see",
            fix="mount the file system with locks (Lustre: flock; NFS: neither nolock nor local_lock), "
            "or put the cache on another",
        )


def _check_source(where: str, required: WorkerRequirements) -> None:
    try:
        same = _names_sha256(required.source) == required.names_sha256
    except OSError as error:
        raise DanceDataError("a worker does not see the source", where=where, found=str(error), fix=_FIX) from error
    if not same:
        raise DanceDataError("a worker sees another source", where=where, found=required.source, fix=_FIX)


def _check_versions(where: str, required: dict[str, str]) -> None:
    versions = dict(_versions(set(required) - {"Python", "dancedata", "arithmetic"}))
    differences = [f"{name} {versions[name]}, not {v}" for name, v in required.items() if versions[name] != v]
    if differences:
        raise DanceDataError(
            "package versions differ on a worker, so results would differ",
            where=where,
            found="; ".join(differences),
            fix="use on all workers the environment of the machine that builds",
        )


def _versions(packages: set[str]) -> tuple[tuple[str, str], ...]:
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    names = sorted({"numpy", "scipy", *packages})
    base = (("Python", python), ("dancedata", __version__), ("arithmetic", expected()))
    return (*base, *((name, package_version(name)) for name in names))


def _names_sha256(folder: Path) -> str:
    return hashlib.sha256("\0".join(sorted(os.listdir(folder))).encode("utf-8", "surrogateescape")).hexdigest()
