"""Runs units of work, on one core or many, and shows how far they are."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TextIO, TypeVar

from dancedata.core.errors import DanceDataError
from dancedata.core.locks import left_behind
from dancedata.core.text import printable
from dancedata.execution.arithmetic import adopted_by_children
from dancedata.execution.cache import entered
from dancedata.execution.cache_files import held, temporary_name
from dancedata.execution.last_words import doing
from dancedata.execution.reference_process import ReferenceProcessError, compute
from dancedata.execution.shielded import shielded
from dancedata.execution.workers import Jobs, Workers, check_surroundings

T = TypeVar("T")

#: Seconds between two lines of progress where there is no terminal.
LINE_INTERVAL_S = 15.0
#: How often a unit may kill the worker that runs it and nothing else.
TRIES_ALONE = 2
#: How often in a row workers may die before any unit of work was finished, or seen to be at fault.
BLIND_DEATHS = 3


def run_units(
    function: Callable[..., Any],
    calls: Sequence[tuple[Any, ...]],
    *,
    jobs: Jobs,
    label: str,
    progress: Progress,
    known: Sequence[Any] = (),
    exact: bool = True,
) -> list[Any]:
    """Return function(*call) for every call, in order.

    Where `known` has a result that is not None, that is taken instead: for what is in the cache no workers need
    be started.

    BLAS and OpenMP run on one thread in each worker, whatever `jobs` is: sums in another order would change
    last digits, and builds have to be byte-identical. So units compute with the instructions that results are
    promised for, see `arithmetic`, in another process if need be; not so if they are not `exact`.

    Where a worker process dies (out of memory, a crash in a decoder), the units that ran in that moment are run
    again, one at a time, and the others go on. Results in the cache are not computed again.

    Raises
    ------
    DanceDataError
        For a unit that kills its worker even when it runs alone, by name.
    """
    if not calls:
        return []
    workers = jobs if isinstance(jobs, Workers) else Workers(jobs)
    results = list(known) or [None] * len(calls)
    missing = [index for index, result in enumerate(results) if result is None]
    with progress.stage(label, len(calls), known=len(calls) - len(missing)) as advance:
        pinned = partial(exactly if exact else on_one_thread, function)
        computed = _run_missing(pinned, [calls[index] for index in missing], workers, label, advance)
    for index, result in zip(missing, computed, strict=True):
        results[index] = result
    return results


def _run_missing(
    function: Callable[..., Any],
    calls: Sequence[tuple[Any, ...]],
    workers: Workers,
    label: str,
    advance: Callable[[int], None],
) -> list[Any]:
    if workers.backend == "loky" and min(workers.n, len(calls)) <= 1:
        return [_advanced(advance, _alone(function, call, label)) for call in calls]
    if not calls:
        return []
    if workers.scratch is not None and _writable(workers.scratch):
        return _Run(function, calls, workers, workers.scratch, label, advance).results()
    with tempfile.TemporaryDirectory(prefix="dancedata-") as scratch:
        return _Run(function, calls, workers, Path(scratch), label, advance).results()


class _Run:
    """One stage of a build on worker processes."""

    def __init__(
        self,
        function: Callable[..., Any],
        calls: Sequence[tuple[Any, ...]],
        workers: Workers,
        scratch: Path,
        label: str,
        advance: Callable[[int], None],
    ) -> None:
        self.function, self.calls, self.workers, self.label, self.advance = function, calls, workers, label, advance
        self.scratch = scratch
        self.name = temporary_name()
        self.found: dict[int, Any] = {}

    def results(self) -> list[Any]:
        """Run all calls; returns their results in order."""
        blind = 0
        try:
            while len(self.found) < len(self.calls):
                left = [i for i in range(len(self.calls)) if i not in self.found]
                before = len(self.found)
                death = self._run(left)
                if death is not None:
                    suspects = [i for i in self._left_behind() if i not in self.found]
                    for index in suspects:
                        self._run_alone(index)
                    blind = blind + 1 if len(self.found) == before else 0
                    if blind == BLIND_DEATHS:
                        raise self._given_up(death)
        finally:
            self._left_behind()
        return [self.found[i] for i in range(len(self.calls))]

    def _run(self, indices: Sequence[int]) -> BaseException | None:
        """Run calls until all are done or a worker dies; returns what was said of that."""
        from multiprocessing import resource_tracker

        from joblib import Parallel, delayed

        # Units take paths, not arrays. joblib would make a folder for large ones in /dev/shm, and leave it there
        # when the build is killed. Of another folder it only remembers the name, and only one of ASCII letters, which
        # cache and temporary folder need not have.
        memory: dict[str, Any] = {"max_nbytes": None, "temp_folder": "/tmp"}  # noqa: S108 -- it stays unused
        pool = {"n_jobs": max(2, min(self.workers.n, len(indices))), "backend": "loky", **memory}
        deaths: tuple[type[Exception], ...] = (BrokenExecutor,)
        lost: tuple[type[BaseException], ...] = ()
        if self.workers.backend == "dask":
            from dancedata.execution.dask_backend import CLUSTER_LOST, WORKER_DEATHS

            # The backend is the one of the context. All units go to the scheduler at once: workers may come later.
            pool = {"n_jobs": -1, "pre_dispatch": "all"}
            deaths, lost = WORKER_DEATHS, CLUSTER_LOST
        tasks = (delayed(_marked)(self.function, self.calls[i], self._mark(i)) for i in indices)
        try:
            # Workers are started when they are needed.
            with adopted_by_children():
                if self.workers.backend == "loky":
                    # It would be started with the workers, and let SIGINT through to them.
                    resource_tracker.ensure_running()
                with shielded():
                    outcome = Parallel(**pool, return_as="generator")(tasks)
                for index, result in zip(indices, outcome, strict=True):
                    self.found[index] = result
                    self.advance(1)
        except deaths as error:
            return error
        except lost as error:
            raise DanceDataError(
                f"the Dask cluster was lost during {self.label}",
                found=f"{type(error).__name__}: {_first_line(error)}",
                fix="see that the scheduler runs, then run the same command again: it goes on where it was",
            ) from error
        return None

    def _run_alone(self, index: int) -> None:
        death = None
        for _ in range(TRIES_ALONE):
            death = self._run([index])
            if death is None:
                return
        raise DanceDataError(
            f"this unit of work kills its worker process ({self.label})",
            where=unit_name(self.calls[index]),
            found=f"{TRIES_ALONE} times, running alone: {_first_line(death)}",
            fix="if memory ran out, use a machine with more; else remove the file from the source and report it",
        ) from death

    def _given_up(self, death: BaseException) -> DanceDataError:
        return DanceDataError(
            f"worker processes die during {self.label} before they finish a unit of work",
            found=_first_line(death),
            fix="run the same command again, it goes on where it was; if memory ran out, with fewer --jobs",
        )

    def _mark(self, index: int) -> tuple[Path, str, Any]:
        return self.scratch, f"{self.name}-{index}.unit", self.workers.surroundings

    def _left_behind(self) -> list[int]:
        """Return what dead workers were running, and remove their marks."""
        found = []
        for path in self.scratch.glob(f"{self.name}-*.unit"):
            # Others of the same pool may live on for a moment.
            if left_behind(path) or self.workers.backend == "loky":
                path.unlink(missing_ok=True)
                found.append(int(path.stem.rsplit("-")[-1]))
        return sorted(found)


def unit_name(call: Sequence[Any]) -> str:
    """Return how people know a unit of work: its clip and file."""
    for argument in call:
        path = getattr(argument, "motion_path", None)
        if path is not None:
            return f"clip {argument.id} ({path})"
        path = argument if isinstance(argument, Path) else getattr(argument, "path", None)
        if isinstance(path, Path):
            return str(path)
    return "unit"


def _writable(folder: Path) -> bool:
    """Tell whether files can be made in a folder: a cache that holds everything may be read-only."""
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return os.access(folder, os.W_OK)


def _first_line(error: BaseException | None) -> str:
    return str(error).strip().split("\n")[0]


def _alone(function: Callable[..., Any], call: tuple[Any, ...], label: str) -> Any:
    """Run a unit in this process."""
    with doing(f"{label}, {unit_name(call)}"):
        try:
            return function(*call)
        except ReferenceProcessError as error:
            error.where = unit_name(call)
            raise


def _advanced(advance: Callable[[int], None], result: Any) -> Any:
    advance(1)
    return result


def _marked(function: Callable[..., Any], call: tuple[Any, ...], mark: tuple[Path, str, Any]) -> Any:
    """Run a unit in a worker process, with a file that says so as long as it runs."""
    scratch, name, surroundings = mark
    if surroundings is not None:
        check_surroundings(surroundings)
    with entered(scratch, held(scratch, name)):
        return function(*call)


def exactly(function: Callable[..., T], *args: Any) -> T:
    """Return ``function(*args)`` as a build computes it: on one thread, with the instructions of `expected`.

    Raises
    ------
    ReferenceProcessError
        As for `reference_process.compute`.
    """
    found: T = compute(on_one_thread, function, *args)
    return found


def on_one_thread(function: Callable[..., T], *args: Any) -> T:
    """Return ``function(*args)``, computed on one thread."""
    with one_thread():
        return function(*args)


def one_thread() -> AbstractContextManager[Any]:
    """Run BLAS and OpenMP on one thread within the context: the numbers of a build, to the last digit."""
    # Libraries come with modules: they are looked for again when modules were imported, which takes a millisecond.
    limits: AbstractContextManager[Any] = _thread_pools(len(sys.modules)).limit(limits=1)
    return limits


@lru_cache(maxsize=1)
def _thread_pools(n_modules: int) -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


class Progress:
    """Progress on stderr: a bar with rate and time left on a terminal, plain lines elsewhere, or nothing."""

    def __init__(self, quiet: bool = False, stream: TextIO | None = None) -> None:
        self.quiet = quiet
        self.stream = stream if stream is not None else sys.stderr
        self._announced: list[str] = []

    def announce(self, text: str) -> None:
        """Print a line as soon as there is something to do: what finds all done is silent."""
        self._announced.append(text)

    def say(self, text: str) -> None:
        """Print a line."""
        if not self.quiet:
            lines, self._announced = [*self._announced, text], []
            print(printable("\n".join(lines), lines=True), file=self.stream, flush=True)

    def _begin(self) -> None:
        """Print what was announced."""
        if self._announced:
            last = self._announced.pop()
            self.say(last)

    @contextmanager
    def stage(self, label: str, total: int, known: int = 0) -> Iterator[Callable[[int], None]]:
        """Show a stage of `total` steps, `known` of them done before; gives a function to say how many more are."""
        if self.quiet:
            yield lambda _: None
            return
        if known == total:
            self.announce(f"{label}: {total}/{total} in the cache")
            yield lambda _: None
            return
        self._begin()
        if self.stream.isatty():
            from tqdm import tqdm

            with tqdm(total=total, initial=known, desc=label, file=self.stream, unit="", dynamic_ncols=True) as bar:

                def advance(n: int) -> None:
                    bar.update(n)

                yield advance
        else:
            yield from self._lines(label, total, known)

    def _lines(self, label: str, total: int, known: int) -> Iterator[Callable[[int], None]]:
        started = last = time.monotonic()
        done = known

        def advance(n: int) -> None:
            nonlocal done, last
            done += n
            now = time.monotonic()
            if done < total and now - last >= LINE_INTERVAL_S:
                last = now
                left = (now - started) / (done - known) * (total - done)
                self.say(f"{label}: {done}/{total}, about {left:.0f} s left")

        yield advance
        self.say(f"{label}: {done}/{total} in {time.monotonic() - started:.1f} s")
