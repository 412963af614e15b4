"""Starts processes that Ctrl-C does not reach: the one that started them ends them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def shielded() -> Iterator[None]:
    """Start processes within the context: they never get SIGINT; this process gets it when the context ends.

    A terminal sends SIGINT to all processes of a command. One that is just starting would print a traceback, and an
    exception while it is being started leaves it waiting for its orders.
    """
    held: list[int] = []
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT)
    if in_main and before is not None:
        signal.signal(signal.SIGINT, lambda number, _: held.append(number))
    # Unlike handlers, the mask is inherited.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if in_main and before is not None:
            signal.signal(signal.SIGINT, before)
        if held:
            signal.raise_signal(signal.SIGINT)
