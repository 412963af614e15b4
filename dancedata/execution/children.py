"""Starts child processes that Ctrl-C does not reach, and one that prints what this process was doing when it crashed.

A crash inside libsndfile or libhdf5 ends a process before Python can print anything; `faulthandler` could name lines
of code, but not the file that was read. So a second, tiny process is told what the first one is doing, and prints the
last of it when its input ends before the work does. Worker processes do not need it: `run_units` sees them die.
"""

from __future__ import annotations

import atexit
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import IO, cast

from dancedata.core.text import printable


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


_REPORTER = r"""
import signal, sys
signal.signal(signal.SIGTERM, signal.SIG_IGN)
last = b""
for line in sys.stdin.buffer:
    last = line.strip()
if last:
    fix = "Set the file aside if it happens again; what was computed is in the cache"
    sys.stderr.write("error: the process died at %s. %s\n" % (last.decode(errors="replace"), fix))
"""


@contextmanager
def named_if_it_crashes(what: str) -> Iterator[None]:
    """If this process dies within the context, print that it died at `what`."""
    _report(what)
    try:
        yield
    finally:
        _report("")


def _report(text: str) -> None:
    with suppress(OSError):  # the other process is gone: nothing depends on it
        _reporter().write(printable(" ".join(text.split())).encode() + b"\n")


@lru_cache(maxsize=1)
def _reporter() -> IO[bytes]:
    """Return the standard input of the other process, which is started by the first call."""
    command = [sys.executable, "-I", "-S", "-c", _REPORTER]
    with shielded():
        # Nothing in the command comes from outside.
        process = subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0)  # noqa: S603
        atexit.register(process.communicate)
    return cast(IO[bytes], process.stdin)
