"""Starts child processes that Ctrl-C does not reach; their parent ends them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def shielded() -> Iterator[None]:
    """Start processes within the context: they never receive SIGINT; this process receives it when the context ends.

    SIGTERM, which is sent to one process, reaches this one then too.

    A terminal sends SIGINT to all processes of a command. A child that is starting would print a traceback, and an
    exception in the parent while it starts one leaves the child waiting for input.
    """
    received: list[int] = []
    in_main = threading.current_thread() is threading.main_thread()
    # A handler that is not Python's is None, and stays.
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM) if in_main and signal.getsignal(n)}
    for number in before:
        signal.signal(number, lambda number, _: received.append(number))
    # Unlike handlers, the mask is inherited.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])
