"""How a stage is shown: as a bar on a terminal and in a notebook, as lines of text elsewhere."""

import os
import time
from collections.abc import Callable, Iterator
from typing import TextIO

#: Seconds between two lines of progress where there is neither a terminal nor a notebook.
LINE_INTERVAL_S = 15.0
#: Columns of the name of a stage on a terminal.
_LABEL = 24


def show_bar(stream: TextIO, label: str, total: int | None, n_cached: int) -> Iterator[Callable[[int], None]]:
    """Show a bar while the stage runs; a row of a table replaces it."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    # In a notebook too: rich's own display there needs ipywidgets.
    console = Console(file=stream, force_terminal=True, force_jupyter=False, highlight=False)
    counts = [MofNCompleteColumn(), TimeRemainingColumn()] if total is not None else []
    columns = [TextColumn("{task.description}"), BarColumn(bar_width=24), *counts]
    started = time.monotonic()
    with Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as display:
        task = display.add_task(label.ljust(_LABEL), total=total, completed=n_cached)
        yield lambda n: display.advance(task, n)
    style = None if os.environ.get("NO_COLOR") else "dim"
    console.print(stage_row(label, total, f"{time.monotonic() - started:.1f} s"), style=style, markup=False)


def stage_row(label: str, total: int | None, end: str) -> str:
    """Return the row of a stage that has ended."""
    return f"{label.ljust(_LABEL)} {'' if total is None else f'{total:,}':>8} {end:>9}"


def show_lines(
    write: Callable[[str], None], label: str, total: int | None, n_cached: int
) -> Iterator[Callable[[int], None]]:
    """Write a line from time to time while the stage runs, and one at its end."""
    started = last = time.monotonic()
    done = n_cached

    def advance(n: int) -> None:
        nonlocal done, last
        done += n
        now = time.monotonic()
        if total is not None and done < total and now - last >= LINE_INTERVAL_S:
            last = now
            remaining_s = (now - started) / (done - n_cached) * (total - done)
            write(f"{label}: {done}/{total}, about {remaining_s:.0f} s left")

    yield advance
    count = "done" if total is None else f"{done}/{total}"
    write(f"{label}: {count} in {time.monotonic() - started:.1f} s")
