"""Runs units of work, on one core or many, and shows how far they are."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import AbstractContextManager, contextmanager
from typing import Any, TextIO

from dancedata.core.errors import DanceDataError

#: Seconds between two lines of progress where there is no terminal.
LINE_INTERVAL_S = 15.0


def run_units(
    function: Callable[..., Any], calls: Sequence[tuple[Any, ...]], *, jobs: int, label: str, progress: Progress
) -> list[Any]:
    """Return function(*call) for every call, in order.

    BLAS and OpenMP run on one thread in each worker, whatever `jobs` is: sums in another order would change
    last digits, and builds have to be byte-identical.
    """
    from joblib import Parallel, delayed

    if not calls:
        return []
    results: list[Any] = []
    # No more processes than calls; one call needs none.
    workers = Parallel(n_jobs=max(1, min(jobs, len(calls))), return_as="generator")
    outcome: Iterable[Any] = workers(delayed(_pinned)(function, call) for call in calls)
    try:
        with progress.stage(label, len(calls)) as advance:
            for result in outcome:
                results.append(result)
                advance(1)
    except BrokenExecutor as error:
        raise DanceDataError(
            f"a worker process died during {label}",
            found=str(error).split("\n")[0],
            fix="run the same command again, it goes on where it was; if memory ran out, with fewer --jobs",
        ) from error
    return results


def _pinned(function: Callable[..., Any], call: tuple[Any, ...]) -> Any:
    with one_thread():
        return function(*call)


def one_thread() -> AbstractContextManager[Any]:
    """Run BLAS and OpenMP on one thread within the context: the numbers of a build, to the last digit."""
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[Any] = threadpool_limits(limits=1)
    return limits


class Progress:
    """Progress on stderr: a bar with rate and time left on a terminal, plain lines elsewhere, or nothing."""

    def __init__(self, quiet: bool = False, stream: TextIO | None = None) -> None:
        self.quiet = quiet
        self.stream = stream if stream is not None else sys.stderr

    def say(self, text: str) -> None:
        """Print a line."""
        if not self.quiet:
            print(text, file=self.stream, flush=True)

    @contextmanager
    def stage(self, label: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show a stage of `total` steps; gives a function to call with the number of steps done."""
        if self.quiet:
            yield lambda _: None
        elif self.stream.isatty():
            from tqdm import tqdm

            with tqdm(total=total, desc=label, file=self.stream, unit="", dynamic_ncols=True) as bar:

                def advance(n: int) -> None:
                    bar.update(n)

                yield advance
        else:
            yield from self._lines(label, total)

    def _lines(self, label: str, total: int) -> Iterator[Callable[[int], None]]:
        started = last = time.monotonic()
        done = 0

        def advance(n: int) -> None:
            nonlocal done, last
            done += n
            now = time.monotonic()
            if done < total and now - last >= LINE_INTERVAL_S:
                last = now
                left = (now - started) / done * (total - done)
                self.say(f"{label}: {done}/{total}, about {left:.0f} s left")

        yield advance
        self.say(f"{label}: {done}/{total} in {time.monotonic() - started:.1f} s")
