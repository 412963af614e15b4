"""Engine of worker processes of this machine, by the library loky.

loky and not multiprocessing or concurrent.futures: its workers do not import the user's main module again, so that
`dancedata.build` works in a script without ``if __name__ == "__main__"`` and in a notebook, and one pool serves all
stages of a build.
"""

import multiprocessing
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any
from weakref import WeakSet

from dancedata.execution.arithmetic import adopted_by_children
from dancedata.execution.executors.base import (
    Call,
    Executor,
    InlineExecutor,
    OnResult,
    WorkerDiedError,
    first_line,
    not_sendable,
)
from dancedata.execution.reference_process import shielded

#: Seconds after which an idle worker ends: the next stage, or the next build in a notebook, finds it running.
IDLE_S = 300
#: Units run on one thread. BLAS libraries would start a thread for each core of the machine in every worker.
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "BLIS")}
#: Most bytes of free memory that workers keep: otherwise glibc returns it after each array, and a fifth of
#: the time of encoding motion is spent in clearing it again. Larger arrays than the first number are returned.
_KEEPS_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(1 << 25), "MALLOC_TRIM_THRESHOLD_": str(1 << 27)}
#: Pools of this process: one for each thread that builds.
_pools: WeakSet[Any] = WeakSet()


@dataclass(frozen=True)
class LokyExecutor(Executor):
    """`n` worker processes at most."""

    def for_calls(self, n_calls: int) -> Executor:
        """Return an executor without worker processes where one would do, or where none may be started.

        A daemonic process, such as one of multiprocessing.Pool, may not start processes.
        """
        may_start = not multiprocessing.current_process().daemon
        return self if may_start and min(self.n, n_calls) > 1 else InlineExecutor()

    def run(self, function: Callable[..., Any], calls: Mapping[int, Call], label: str, on_result: OnResult) -> None:
        """See `Executor.run`."""
        from loky import BrokenProcessPool, Future, as_completed, get_reusable_executor

        pool: Any = None
        futures: dict[Future, int] = {}
        death: BaseException | None = None
        unfinished: list[int] = []
        # Workers that end, such as idle ones, are replaced at any time.
        with adopted_by_children():
            resource_tracker.ensure_running()  # started with the workers, it would unblock SIGINT for them
            try:
                with shielded():  # an interrupt during the start is raised at its end
                    # In this folder, so that relative paths name the same files: a pool of another one is replaced.
                    pool = get_reusable_executor(
                        min(self.n, len(calls)), timeout=IDLE_S, env=_environment(), initializer=os.chdir,
                        initargs=(os.getcwd(),),
                    )  # fmt: skip
                    _pools.add(pool)
                    try:
                        for index, call in calls.items():
                            futures[pool.submit(function, *call)] = index
                    except BrokenProcessPool as error:
                        death = error
                for future in as_completed(futures):
                    if isinstance(future.exception(), BrokenProcessPool):
                        # So end all units that were running or waiting when a worker died.
                        death = future.exception()
                        unfinished.append(futures[future])
                    else:
                        on_result(futures[future], future.result())
            except BaseException:
                if pool is not None:
                    pool.shutdown(kill_workers=True)
                raise
        if death is not None:
            _raise_if_not_unpickled(death, label)
            # Units start in the order in which they were submitted: the oldest were running.
            raise WorkerDiedError(first_line(death), sorted(unfinished)[: self.n]) from death


def _environment() -> dict[str, str]:
    """Return additional environment variables of workers; a user's settings of the C library's memory stay."""
    tuned = "glibc.malloc" in os.environ.get("GLIBC_TUNABLES", "")
    chosen = tuned or any(name.startswith("MALLOC_") for name in os.environ)
    return _ONE_THREAD if chosen else {**_ONE_THREAD, **_KEEPS_MEMORY}


def end_workers() -> None:
    """Kill all workers, for a process that ends: they are idle, and take a tenth of a second to end by themselves."""
    for pool in list(_pools):
        pool.shutdown(kill_workers=True)


def _raise_if_not_unpickled(death: BaseException, label: str) -> None:
    """Raise the error of a call or a result that could not be unpickled, which loky reports as a dead worker."""
    if "un-serialize" in str(death):
        # The cause is the traceback of the worker, as text between quotation marks.
        raise not_sendable(label, str(death.__cause__ or death).strip(' \n"').rsplit("\n", 1)[-1]) from death
