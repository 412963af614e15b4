"""Shared parts of the engines of clusters: units as messages, answers, and the requirements of workers."""

from __future__ import annotations

import hashlib
import os
import pickle
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import cloudpickle

from dancedata.core.errors import DanceDataError
from dancedata.core.version import __version__
from dancedata.execution.cache import Cache, package_version
from dancedata.execution.cache_files import TEMPORARY, locked_file, temporary_name
from dancedata.execution.executors.base import Call, OnResult, WorkerDiedError, first_line, not_sendable
from dancedata.execution.reference_process import ReferenceProcessError, answer, expected
from dancedata.files.locks import is_abandoned

#: Seconds to wait for a cluster to answer, and for a first worker.
TIMEOUT_S = 30


def packed(label: str, function: Callable[..., Any], call: Call) -> bytes:
    """Return a unit of a stage as a message for `run_packed`.

    Engines see bytes: none looks for its own objects among the arguments, and a worker is checked before it imports
    the unit's modules.
    """
    return pickle.dumps((label, cloudpickle.dumps((function, call))))


def run_packed(engine: str, required: WorkerRequirements, message: bytes) -> bytes:
    """Run a unit in a worker process, after a check of the process; the answer is for `Answers.take`."""

    def unpacked() -> tuple[Callable[..., Any], Call]:
        check_worker(required, worker_name(engine))
        label, unit = pickle.loads(message)  # noqa: S301  (from the build)
        try:
            function, call = pickle.loads(unit)  # noqa: S301
        except DanceDataError:
            raise
        except Exception as error:
            raise not_sendable(label, f"{type(error).__name__}: {error}") from error
        return function, call

    return answer(unpacked)


def failed(error: DanceDataError) -> bytes:
    """Return the answer of a worker that refuses to run a unit."""
    return pickle.dumps((True, error))


def worker_name(engine: str) -> str:
    """Return a name of this worker process for messages."""
    return f"{engine} worker on {socket.gethostname()}, process {os.getpid()}"


def threads_refused(where: str, found: str, fix: str) -> DanceDataError:
    """Return the error for a worker whose threads would undo each other's limit on BLAS, and change last digits."""
    return DanceDataError("a worker runs several units at once in threads", where=where, found=found, fix=fix)


@dataclass
class Answers:
    """The answers of a run; units whose workers died are collected until its end.

    Attributes
    ----------
    label
        Name of the stage, for messages.
    on_result
        As of `Executor.run`.
    """

    label: str
    on_result: OnResult
    _suspects: set[int] = field(default_factory=set)
    _death: BaseException | None = None
    _deaths: int = 1

    def take(self, index: int, message: bytes) -> None:
        """Pass the result of a unit on, or raise its error.

        Where the unit ran in the reference process of the worker and that died, the unit is a suspect.
        """
        try:
            is_error, result = pickle.loads(message)  # noqa: S301  (from a worker of this build)
        except Exception as error:
            raise not_sendable(self.label, f"{type(error).__name__}: {error}") from error
        if not is_error:
            self.on_result(index, result)
        elif isinstance(result, ReferenceProcessError):
            self.died(result, index)
        else:
            raise result

    def died(self, death: BaseException, *suspects: int, deaths: int = 1) -> None:
        """Note that a worker died, and the units that may have caused it."""
        self._suspects.update(suspects)
        self._death, self._deaths = death, deaths

    def end(self) -> None:
        """Raise WorkerDiedError if a worker died."""
        if self._death is not None:
            raise WorkerDiedError(first_line(self._death), sorted(self._suspects), self._deaths) from self._death


def lost(engine: str, label: str, error: object) -> DanceDataError:
    """Return the error for a cluster that went away."""
    cause = f"{type(error).__name__}: {first_line(error)}" if isinstance(error, BaseException) else str(error)
    return DanceDataError(
        f"the {engine} cluster was lost during {label}",
        found=cause,
        fix="check that the scheduler runs, then run the same command again to resume",
    )


@contextmanager
def kept_signals() -> Iterator[None]:
    """Put back, at the end of the context, the handlers of SIGINT and SIGTERM that a library replaces within it."""
    in_main = threading.current_thread() is threading.main_thread()
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM) if in_main and signal.getsignal(n)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
def check_worker(required: WorkerRequirements, where: str) -> None:
    """Raise DanceDataError unless this process meets the requirements; checked once per process and build.

    Workers may join a cluster at any time, so a check at the start of a build is not enough. A worker that does not
    see the source would reject every clip.
    """
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
