"""Says what a process was doing when it died.

A crash inside libsndfile or libhdf5 ends a process before it can say a word. So a second, tiny process is told what
the first one is doing; when that is gone without a goodbye, it prints the last it heard. Worker processes need none
of this: whoever hired them sees them die (`execute`).
"""

from __future__ import annotations

import atexit
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from dancedata.core.text import printable
from dancedata.execution.shielded import shielded

_LISTENER = r"""
import signal, sys
signal.signal(signal.SIGTERM, signal.SIG_IGN)
last = b""
for line in sys.stdin.buffer:
    last = line.strip()
if last:
    fix = "Set the file aside if it happens again; what was computed is in the cache"
    sys.stderr.write("error: the process died at %s. %s\n" % (last.decode(errors="replace"), fix))
"""


class _Listener:
    """The other process, started when there is something to say."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None

    def hear(self, text: str) -> None:
        if self.process is None:
            command = [sys.executable, "-I", "-S", "-c", _LISTENER]
            with shielded():
                # Nothing in the command comes from outside.
                self.process = subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0)  # noqa: S603
            atexit.register(self.goodbye)
        pipe = self.process.stdin
        if pipe is not None:
            with suppress(OSError):  # it is gone: nothing depends on it
                pipe.write(printable(" ".join(text.split())).encode() + b"\n")

    def goodbye(self) -> None:
        if self.process is not None:
            with suppress(OSError):
                self.process.communicate()
            self.process = None


_listener = _Listener()


@contextmanager
def doing(what: str) -> Iterator[None]:
    """If this process dies within the context, print that it died at `what`."""
    _listener.hear(what)
    try:
        yield
    finally:
        _listener.hear("")
