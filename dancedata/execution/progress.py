"""Progress of a command: a bar on a terminal and in a notebook, lines of text elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

from dancedata.core.text import printable

#: Seconds between two lines of progress where there is neither a terminal nor a notebook.
LINE_INTERVAL_S = 15.0


class Progress:
    """Progress on stderr: a bar with rate and time left on a terminal or in a notebook, lines elsewhere, or nothing.

    Parameters
    ----------
    quiet
        Print nothing.
    stream
        Where to print. Default: stderr.
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
    def stage(self, label: str, total: int, known: int = 0) -> Iterator[Callable[[int], None]]:
        """Show a stage of `total` steps, `known` of them done before; yield a function that counts finished steps."""
        if self.quiet:
            yield lambda _: None
        elif known == total:
            self.announce(f"{label}: {total}/{total} in the cache")
            yield lambda _: None
        else:
            if self._announced:
                self.write(self._announced.pop())
            bar = self.stream.isatty() or (self.stream is sys.stderr and _in_notebook())
            yield from (self._bar if bar else self._lines)(label, total, known)

    def _bar(self, label: str, total: int, known: int) -> Iterator[Callable[[int], None]]:
        from tqdm.auto import tqdm

        with tqdm(total=total, initial=known, desc=label, file=self.stream, unit="", dynamic_ncols=True) as bar:

            def advance(n: int) -> None:
                bar.update(n)

            yield advance

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
                self.write(f"{label}: {done}/{total}, about {left:.0f} s left")

        yield advance
        self.write(f"{label}: {done}/{total} in {time.monotonic() - started:.1f} s")


def _in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook, as tqdm.auto does; imports nothing."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return "IPKernelApp" in getattr(shell, "config", {})
