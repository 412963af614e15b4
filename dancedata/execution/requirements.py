"""Requirements of the workers of a cluster, checked by each before its first unit."""

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
from dancedata.core.packages import package_version
from dancedata.core.version import __version__
from dancedata.execution.arithmetic import expected, here
from dancedata.execution.cache import Cache
from dancedata.execution.executors import worker_name
from dancedata.files.cache_files import TEMPORARY, locked_file, temporary_name
from dancedata.files.locks import is_abandoned

_FIX = "workers need the cache, the source and the same paths: a shared file system"


@dataclass(frozen=True)
class Requirements:
    """Requirements of a worker: that it sees the same cache and source, and has the same versions."""

    token: Path  # a file in the cache that the build has locked
    token_text: str  # its content
    source: Path
    names_sha256: str  # of the names in the source folder
    versions: tuple[tuple[str, str], ...]

    def check(self) -> None:
        """Raise DanceDataError unless this process meets them, see `check_worker`."""
        check_worker(self)


@contextmanager
def requirements_of(cache: Cache, source: Path, packages: set[str]) -> Iterator[Requirements]:
    """Yield the requirements of a build that reads `source` and computes with `packages`."""
    text = temporary_name()
    with locked_file(cache.root / TEMPORARY, f"{text}.token") as token:
        token.write_text(text, encoding="utf-8")
        yield Requirements(token, text, source, names_sha256(source), versions_of(packages, expected()))


@lru_cache(maxsize=8)
def check_worker(required: Requirements) -> None:
    """Raise DanceDataError unless this process meets the requirements, once per process and build."""
    where = worker_name()
    try:
        if required.token.read_text(encoding="utf-8") != required.token_text:
            raise DanceDataError("a worker sees a different cache", where=where, found=required.token, fix=_FIX)
    except OSError as error:
        raise DanceDataError("a worker does not see the cache", where=where, found=str(error), fix=_FIX) from error
    if is_abandoned(required.token):
        # The build holds its lock. A worker would also remove files that other machines are writing.
        raise DanceDataError("locks on files in the cache do not reach from one machine to another", where=where,
                             found=f"a lock on {required.token.name} that the build holds, unseen by the worker",
                             fix="mount the file system with locks (Lustre: flock; NFS: neither nolock nor "
                             "local_lock), or put the cache on another")  # fmt: skip
    try:
        if names_sha256(required.source) != required.names_sha256:
            raise DanceDataError("a worker sees a different source", where=where, found=required.source, fix=_FIX)
    except OSError as error:
        raise DanceDataError("a worker does not see the source", where=where, found=str(error), fix=_FIX) from error
    needed = dict(required.versions)
    found = dict(versions_of(set(needed) - {"Python", "dancedata", "arithmetic"}, here()))
    if differences := [
        f"{name} {found[name]}, not {version}" for name, version in needed.items() if found[name] != version
    ]:
        raise DanceDataError("package versions differ on a worker, so results would differ", where=where,
                             found="; ".join(differences),
                             fix="use on all workers the environment of the machine that builds; Dask needs "
                             "nannies, as by default, for the same arithmetic")  # fmt: skip


def versions_of(packages: set[str], arithmetic: str) -> tuple[tuple[str, str], ...]:
    """Return what shapes numbers, by name: versions, those of `packages` among them, and `arithmetic`."""
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    names = sorted({"numpy", "scipy", *packages})
    base = (("Python", python), ("dancedata", __version__), ("arithmetic", arithmetic))
    return (*base, *((name, package_version(name)) for name in names))


def names_sha256(folder: Path) -> str:
    """Return a hash of the names in a folder."""
    return hashlib.sha256("\0".join(sorted(os.listdir(folder))).encode("utf-8", "surrogateescape")).hexdigest()
