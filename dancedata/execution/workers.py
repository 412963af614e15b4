"""Where units of work run: worker processes of this machine, or a Dask cluster."""

from __future__ import annotations

import hashlib
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.locks import left_behind
from dancedata.core.version import __version__
from dancedata.execution.cache import Cache, package_version
from dancedata.execution.cache_files import TEMPORARY, held, temporary_name
from dancedata.execution.reference_process import expected

Backend = Literal["loky", "dask"]
#: Seconds to wait for the scheduler, and for a first worker.
DASK_TIMEOUT_S = 30


@dataclass(frozen=True)
class Surroundings:
    """What a worker on another machine has to have in common with the build.

    Attributes
    ----------
    token, word
        A file in the cache and what it says: whether the worker sees the same cache.
    source, listing
        The source folder and a hash of the names in it.
    versions
        Of Python, dancedata and the packages that shape numbers.
    """

    token: Path
    word: str
    source: Path
    listing: str
    versions: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Workers:
    """Who runs units of work.

    Attributes
    ----------
    n
        Worker processes; with Dask the cluster's own number counts.
    scratch
        Folder that all workers see, for marks of what each is doing; None: a temporary one.
    surroundings
        With Dask: what workers are checked for.
    """

    n: int = 1
    backend: Backend = "loky"
    scratch: Path | None = None
    surroundings: Surroundings | None = None


#: What functions that run units take: a number of processes, or a description of the workers.
Jobs = int | Workers


@contextmanager
def hired(
    n: int, cache: Cache, source: Path, packages: set[str], *, backend: str = "loky", scheduler: str | None = None
) -> Iterator[Workers]:
    """Give workers for a build, connected and checked.

    Raises
    ------
    UsageError
        If Dask is not installed.
    DanceDataError
        If there is no scheduler at that address, or no worker.
    """
    scratch = cache.root / TEMPORARY
    if backend == "loky" or scheduler is None:
        yield Workers(n, scratch=scratch)
        return
    with ExitStack() as stack:
        stack.enter_context(_connected(scheduler))
        word = temporary_name()
        token = stack.enter_context(held(scratch, f"{word}.token"))
        token.write_text(word, encoding="utf-8")
        around = Surroundings(token, word, source, _listing(source), _versions(packages))
        yield Workers(n, "dask", scratch, around)


def check_backend(backend: str, scheduler: str | None) -> None:
    """Raise UsageError unless backend and scheduler go together."""
    if backend not in ("loky", "dask"):
        raise UsageError("unknown backend", found=repr(backend), allowed="loky, dask")
    if backend == "dask" and scheduler is None:
        raise UsageError("the backend dask needs a scheduler", fix="give its address: --scheduler tcp://HOST:8786")
    if backend == "loky" and scheduler is not None:
        raise UsageError("a scheduler is for the backend dask", found=scheduler, fix="add --backend dask")


@contextmanager
def _connected(scheduler: str) -> Iterator[None]:
    """Be a client of a Dask cluster, and make joblib use it."""
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("Dask is not installed", fix="pip install dancedata[dask]") from error
    from joblib import parallel_config

    try:
        client = Client(scheduler, timeout=DASK_TIMEOUT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as error:
        raise DanceDataError(
            "there is no Dask scheduler that answers",
            where=scheduler,
            found=str(error) or type(error).__name__,
            fix="see that it runs and that this machine can reach it",
        ) from error
    try:
        try:
            client.wait_for_workers(1, timeout=DASK_TIMEOUT_S)
        except TimeoutError as error:
            raise DanceDataError(
                "the Dask cluster has no worker",
                where=scheduler,
                fix="start some: dask worker ADDRESS --nworkers 4 --nthreads 1",
            ) from error
        from dancedata.execution.dask_backend import Backend

        with parallel_config(backend=Backend(client=client, wait_for_workers_timeout=DASK_TIMEOUT_S)):
            yield
    finally:
        _close(client)


def _close(client: Any) -> None:
    """Leave the cluster; what is still under way there fails to come back, which is nothing to log."""
    # distributed gives several of its loggers levels of their own.
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]
    loggers = [logging.getLogger(name) for name in ("tornado.application", *names)]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        client.close()
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _versions(packages: set[str]) -> tuple[tuple[str, str], ...]:
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    names = sorted({"numpy", "scipy", *packages})
    own = (("Python", python), ("dancedata", __version__), ("arithmetic", expected()))
    return (*own, *((name, package_version(name)) for name in names))


def _listing(folder: Path) -> str:
    return hashlib.sha256("\0".join(sorted(os.listdir(folder))).encode("utf-8", "surrogateescape")).hexdigest()


@lru_cache(maxsize=8)
def check_surroundings(wanted: Surroundings) -> None:
    """Raise DanceDataError unless this process has what a build needs; once a process and build.

    Workers may join a cluster at any time, so that looking at the start of a build is not enough. A worker that
    does not see the source would set every clip aside.
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
    shared = "workers need the cache, the source and the same paths: a shared file system"
    try:
        if wanted.token.read_text(encoding="utf-8") != wanted.word:
            raise DanceDataError("a worker sees another cache", where=where, found=wanted.token, fix=shared)
    except OSError as error:
        raise DanceDataError("a worker does not see the cache", where=where, found=str(error), fix=shared) from error
    if left_behind(wanted.token):
        # The build holds it. What a worker takes for left behind it would also remove while it is being written.
        raise DanceDataError(
            "locks on files in the cache do not reach from one machine to another",
            where=where,
            found=f"a lock on {wanted.token.name} that the build holds and the worker does not see",
            fix="mount the file system with locks (Lustre: flock; NFS: neither nolock nor local_lock), "
            "or put the cache on another",
        )
    try:
        same = _listing(wanted.source) == wanted.listing
    except OSError as error:
        raise DanceDataError("a worker does not see the source", where=where, found=str(error), fix=shared) from error
    if not same:
        raise DanceDataError("a worker sees another source", where=where, found=wanted.source, fix=shared)
    _check_versions(where, dict(wanted.versions))


def _check_versions(where: str, wanted: dict[str, Any]) -> None:
    found = dict(_versions(set(wanted) - {"Python", "dancedata", "arithmetic"}))
    other = [f"{name} {found[name]}, not {v}" for name, v in wanted.items() if found[name] != v]
    if other:
        raise DanceDataError(
            "a worker has other versions, which would give other numbers",
            where=where,
            found="; ".join(other),
            fix="give all workers the environment of the machine that builds",
        )
