"""Engines that run units of work: worker processes of this machine, a Dask cluster, a Ray cluster.

An engine is how a call becomes a future of concurrent.futures; `Executor.run` is the same for all. A unit and its
answer are bytes, so that no engine looks for its own objects among arguments, and an error of a future is never the
unit's.

Workers of this machine are those of loky, which joblib brings: unlike multiprocessing's, they do not import the
user's main module again, so that `dancedata.build` works in a notebook and in a script without
``if __name__ == "__main__"``. joblib's own backends do not tell which unit a worker was running that died.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import socket
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Future, as_completed
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.util import Finalize
from queue import Empty
from typing import Any
from weakref import WeakSet

import cloudpickle

from dancedata.core.errors import DanceDataError
from dancedata.core.system import shielded
from dancedata.core.text import shown
from dancedata.execution import arithmetic

#: Arguments of a unit of work.
Call = tuple[Any, ...]
#: Takes the number of a call and its result.
OnResult = Callable[[int, Any], None]
#: Starts a function with arguments in a worker.
Start = Callable[..., Future[Any]]
#: Seconds after which an idle worker ends: the next stage, or the next build in a notebook, finds it running.
_IDLE_S = 300
#: Units run on one thread. BLAS libraries would start a thread for each core of the machine in every worker.
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "BLIS")}
#: Most bytes of free memory that workers keep: otherwise glibc returns it after each array, and a fifth of
#: the time of encoding motion is spent in clearing it again. Larger arrays than the first number are returned.
_KEEPS_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(1 << 25), "MALLOC_TRIM_THRESHOLD_": str(1 << 27)}


@dataclass(frozen=True)
class Executor:
    """Worker processes of this machine, at most `n`, or workers of a cluster."""

    n: int = 1
    engine: str = "this machine"  # whose workers these are
    deaths: tuple[type[BaseException], ...] = (BrokenExecutor,)  # errors of a future whose worker died
    check: Callable[[], None] | None = None  # of a cluster's worker; raises DanceDataError
    #: For the name of a stage, yields what starts a function on a cluster; cancels where the context raises.
    starting: Callable[[str], AbstractContextManager[Start]] | None = None

    def is_here(self, n_calls: int, exact: bool) -> bool:
        """Return whether calls run in this process: one job or call, or where no process may be started."""
        if self.starting is not None:
            return False
        here = min(self.n, n_calls) < 2 and (not exact or arithmetic.here() == arithmetic.expected())
        return here or multiprocessing.current_process().daemon

    def run(
        self, function: Callable[..., Any], calls: Mapping[int, Call], label: str, on_result: OnResult
    ) -> dict[int, BaseException]:
        """Compute function(*call) for every call in workers, and pass each result on as it comes, in any order.

        Returns the suspects: calls that may have been running when a worker died, with its error. They and all others
        without a result have to be run again. The first exception of a call is raised, and others are cancelled.
        """
        dead: dict[int, BaseException] = {}
        with self.starting(label) if self.starting else _processes(min(self.n, len(calls)), self.n) as start:
            futures: dict[Future[Any], int] = {}
            with shielded():  # workers start: an interrupt is raised at the end
                for number, call in calls.items():
                    message = cloudpickle.dumps((function, call))
                    try:
                        futures[start(self.run_packed, self.check, message)] = number
                    except self.deaths as error:
                        dead[number] = error
                    except Exception as error:
                        raise self.lost(self.engine, error) from error
            for future in as_completed(futures):
                try:
                    result = _unpacked(self._answer(future))
                except self.deaths as error:
                    dead[futures[future]] = error
                else:
                    on_result(futures[future], result)
        if dead and self.starting is None:
            # All futures of a pool break with one worker. Units start in order: the oldest were running.
            _kept.clear()
            return {number: dead[number] for number in sorted(dead)[: self.n]}
        return dead

    def _answer(self, future: Future[bytes]) -> bytes:
        try:
            return future.result()
        except self.deaths:
            raise
        except Exception as error:
            raise self.lost(self.engine, error) from error

    @staticmethod
    def run_packed(check: Callable[[], None] | None, message: bytes) -> bytes:
        """Run a unit in a worker that passes the check; return, pickled, (False, result) or (True, error)."""
        try:
            return bytes(cloudpickle.dumps((False, _run(check, message))))
        except Exception as error:  # noqa: BLE001  (it is raised in the process that builds)
            try:
                return bytes(cloudpickle.dumps((True, error)))
            except Exception as cause:  # noqa: BLE001  (a result or an error that cannot travel)
                return pickle.dumps((True, _not_sendable(cause)))

    @staticmethod
    def lost(engine: str, error: BaseException) -> DanceDataError:
        """Return the error for workers that are gone, or that cannot run `run_packed`."""
        cause = getattr(error, "cause", None)
        cause = cause if isinstance(cause, BaseException) else error
        return DanceDataError(
            f"the workers of {engine} were lost, or cannot run units",
            found=f"{type(cause).__name__}: {first_line(cause).rstrip('.')}",
            fix="check that all have the environment of the machine that builds; the same command resumes",
        )


@contextmanager
def _processes(least: int, most: int) -> Iterator[Start]:
    """Yield what starts calls in `least` to `most` worker processes."""
    arithmetic.start_trackers()
    pool = _pool(least, most)
    try:
        yield pool.submit
    except BaseException:
        _kill(pool)
        _kept.clear()
        raise


#: The pool that the next stage finds, with what it was started for; and all pools, such as those of other threads.
_kept: dict[tuple[Any, ...], Any] = {}
_pools: WeakSet[Any] = WeakSet()


def _pool(least: int, most: int) -> Any:
    """Return a pool of `least` to `most` workers, started by this process, not a parent, in its working folder."""
    from joblib.externals.loky import ProcessPoolExecutor

    # A worker that has grown by 300 MB is replaced, between units, and loky warns each time. As an error the warning
    # would end loky's thread, and the build would wait for ever; it is ignored anew, as filters may have been reset.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    folder, environment = os.getcwd(), _environment()
    started_for = (os.getpid(), folder, tuple(environment.items()))
    for (n, *other), pool in list(_kept.items()):
        if tuple(other) == started_for and least <= n <= most:
            return pool
    pool = ProcessPoolExecutor(least, timeout=_IDLE_S, env=environment, initializer=os.chdir, initargs=(folder,))
    _kept.clear()
    _kept[least, *started_for] = pool
    _pools.add(pool)
    # Children of multiprocessing run no other function at their end, and workers would wait for work without them.
    Finalize(None, end_workers, exitpriority=10)
    return pool


def _environment() -> dict[str, str]:
    """Return additional environment variables of workers; a user's settings of the C library's memory stay."""
    tuned = "glibc.malloc" in os.environ.get("GLIBC_TUNABLES", "")
    chosen = tuned or any(name.startswith("MALLOC_") for name in os.environ)
    return {**arithmetic.variables(), **_ONE_THREAD, **({} if chosen else _KEEPS_MEMORY)}


def end_workers() -> None:
    """Kill all workers, for a process that ends: they are idle, and take a tenth of a second to end by themselves."""
    for pool in list(_pools):
        _kill(pool)


def _kill(pool: Any) -> None:
    """Kill the workers of a pool and drop its calls, numbers first: loky's thread fails at one without a call."""
    with suppress(Empty):
        while True:
            pool._work_ids.get_nowait()
    pool.shutdown(kill_workers=True)


#: Held while a unit runs in a worker.
_running = threading.Lock()


def _run(check: Callable[[], None] | None, message: bytes) -> Any:
    if not _running.acquire(blocking=False):
        # They would undo each other's limit on BLAS, and change last digits.
        fix = "start workers with one thread each (dask worker --nthreads 1), and more of them"
        raise DanceDataError("a worker runs several units at once in threads", where=worker_name(), fix=fix)
    try:
        if check is not None:
            check()
        try:
            function, call = pickle.loads(message)  # noqa: S301  (from the process that builds)
        except DanceDataError:
            raise
        except Exception as error:
            raise _not_sendable(error) from error
        return function(*call)
    finally:
        _running.release()


def worker_name() -> str:
    """Return a name of this process for messages."""
    return f"worker on {socket.gethostname()}, process {os.getpid()}"


def _unpacked(message: bytes) -> Any:
    """Return the result that `run_packed` has returned as bytes, or raise the error."""
    try:
        is_error, result = pickle.loads(message)  # noqa: S301  (from a worker of this build)
    except Exception as error:
        raise _not_sendable(error) from error
    if is_error:
        raise result
    return result


def _not_sendable(error: BaseException) -> DanceDataError:
    """Return the error for a unit or a result that another process cannot unpickle."""
    return DanceDataError(
        "a unit of work or its result cannot be sent between processes",
        found=shown(f"{type(error).__name__}: {error}"),
        fix="correct the plug-in: its module must import, and its errors must unpickle, in worker processes",
    )


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message."""
    return str(error).strip().split("\n")[0]
