"""Progress of a command: a bar on a terminal and in a notebook, lines of text elsewhere."""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

from dancedata.core.text import printable


class Progress:
    """Progress on stderr: a bar with the time left on a terminal or in a notebook, lines elsewhere, or nothing."""

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
        """Show a stage of `total` steps (None: uncounted), `known` of them done; yield what counts finished ones."""
        if self.quiet:
            yield lambda _: None
            return
        from dancedata.execution.stage_display import show_bar, show_lines, stage_row

        bar = _has_cursor(self.stream)
        if known == total:
            self.announce(stage_row(label, total, "cached") if bar else f"{label}: {total}/{total} in the cache")
            yield lambda _: None
            return
        if self._announced:
            self.write(self._announced.pop())
        yield from (
            show_bar(self.stream, label, total, known) if bar else show_lines(self.write, label, total, known)
        )

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
