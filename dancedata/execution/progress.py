"""Progress of a command: a bar on a terminal and in a notebook, lines of text elsewhere."""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

from dancedata.core.text import printable

#: Seconds between two lines of progress where there is neither a terminal nor a notebook.
LINE_INTERVAL_S = 15.0
#: Columns of the name of a stage on a terminal.
_LABEL = 24


class Progress:
    """Progress on stderr: a bar with the time left on a terminal or in a notebook, lines elsewhere, or nothing.

    `quiet`: Print nothing.
    `stream`: Where to print. Default: stderr.
    """

    def __init__(self, quiet: bool = False, stream: TextIO | None = None) -> None:
        self.quiet = quiet
        self.stream = stream if stream is not None else sys.stderr
        self._announced: list[str] = []

    def announce(self, text: str) -> None:
        """Print a line before the next output; nothing is printed where no stage has anything to do."""
        self._announced.append(text)

    def write(self, text: str) -> None:
        """Print a line."""
        if not self.quiet:
            lines, self._announced = [*self._announced, text], []
            print(printable("\n".join(lines), lines=True), file=self.stream, flush=True)

    @contextmanager
    def stage(self, label: str, total: int | None, known: int = 0) -> Iterator[Callable[[int], None]]:
        """Show a stage of `total` steps, `known` of them done before; yield a function that counts finished steps.

        `total` is None for work whose steps are not counted.
        """
        bar = _has_cursor(self.stream)
        if self.quiet:
            yield lambda _: None
        elif known == total:
            self.announce(_row(label, total, "cached") if bar else f"{label}: {total}/{total} in the cache")
            yield lambda _: None
        else:
            if self._announced:
                self.write(self._announced.pop())
            yield from (self._bar if bar else self._lines)(label, total, known)

    @contextmanager
    def megabytes(self, label: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show a stage of `total` bytes in MB; yield a function, for any thread, that counts bytes, also back."""
        lock, done = threading.Lock(), 0
        with self.stage(f"{label}, MB", -(-total // 1_000_000) or 1) as advance:

            def count(n: int) -> None:
                nonlocal done
                with lock:
                    before, done = done, done + n
                    advance(done // 1_000_000 - before // 1_000_000)

            yield count
            advance(-(-total // 1_000_000) - done // 1_000_000)

    def _bar(self, label: str, total: int | None, known: int) -> Iterator[Callable[[int], None]]:
        """Show a bar while the stage runs; a row of a table replaces it."""
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        # In a notebook too: rich's own display there needs ipywidgets.
        console = Console(file=self.stream, force_terminal=True, force_jupyter=False, highlight=False)
        counts = [MofNCompleteColumn(), TimeRemainingColumn()] if total is not None else []
        columns = [TextColumn("{task.description}"), BarColumn(bar_width=24), *counts]
        started = time.monotonic()
        with Bar(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as display:
            task = display.add_task(label.ljust(_LABEL), total=total, completed=known)
            yield lambda n: display.advance(task, n)
        style = None if os.environ.get("NO_COLOR") else "dim"
        console.print(_row(label, total, f"{time.monotonic() - started:.1f} s"), style=style, markup=False)

    def _lines(self, label: str, total: int | None, known: int) -> Iterator[Callable[[int], None]]:
        started = last = time.monotonic()
        done = known

        def advance(n: int) -> None:
            nonlocal done, last
            done += n
            now = time.monotonic()
            if total is not None and done < total and now - last >= LINE_INTERVAL_S:
                last = now
                left = (now - started) / (done - known) * (total - done)
                self.write(f"{label}: {done}/{total}, about {left:.0f} s left")

        yield advance
        count = "done" if total is None else f"{done}/{total}"
        self.write(f"{label}: {count} in {time.monotonic() - started:.1f} s")


def _row(label: str, total: int | None, end: str) -> str:
    return f"{label.ljust(_LABEL)} {'' if total is None else f'{total:,}':>8} {end:>9}"


def _has_cursor(stream: TextIO) -> bool:
    """Return whether a line of the stream can be replaced: on a terminal, and in a notebook."""
    if stream.isatty():
        return os.environ.get("TERM") != "dumb"
    return stream is sys.stderr and _in_notebook()


def _in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook; imports nothing."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return "IPKernelApp" in getattr(shell, "config", {})
