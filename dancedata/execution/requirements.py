"""What a worker on another machine must have in common with the process that builds, and the check of it."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from dancedata.core.errors import DanceDataError
from dancedata.core.locks import is_abandoned
from dancedata.core.version import __version__
from dancedata.execution.cache import Cache, package_version
from dancedata.execution.cache_files import TEMPORARY, locked_file, temporary_name
from dancedata.execution.reference_process import expected


@dataclass(frozen=True)
class WorkerRequirements:
    """What a worker is checked for.

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
    """Give the requirements of a build that reads `source` and computes with `packages`; they hold in the context."""
    text = temporary_name()
    with locked_file(cache.root / TEMPORARY, f"{text}.token") as token:
        token.write_text(text, encoding="utf-8")
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
    found = dict(_versions(set(required) - {"Python", "dancedata", "arithmetic"}))
    other = [f"{name} {found[name]}, not {v}" for name, v in required.items() if found[name] != v]
    if other:
        raise DanceDataError(
            "a worker has other versions, which would give other numbers",
            where=where,
            found="; ".join(other),
            fix="give all workers the environment of the machine that builds",
        )


def _versions(packages: set[str]) -> tuple[tuple[str, str], ...]:
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    names = sorted({"numpy", "scipy", *packages})
    own = (("Python", python), ("dancedata", __version__), ("arithmetic", expected()))
    return (*own, *((name, package_version(name)) for name in names))


def _names_sha256(folder: Path) -> str:
    return hashlib.sha256("\0".join(sorted(os.listdir(folder))).encode("utf-8", "surrogateescape")).hexdigest()
