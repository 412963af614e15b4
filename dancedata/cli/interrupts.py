"""Ctrl-C and SIGTERM end a command with one line and exit code 130 or 143, whatever it is doing."""

from __future__ import annotations

import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from types import FrameType

#: Signals that end a command in order, as batch systems and `timeout` send the second. Exit code: 128 and the number.
SIGNALS = (signal.SIGINT, signal.SIGTERM)
LINE = "interrupted; run the same command again to go on"
#: Seconds within which a second signal counts as the first, while files are put in order.
PATIENCE_S = 1.0
_RETRY_S = 0.05


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, or SIGTERM.

    Not a plain KeyboardInterrupt: if that passes code made from text, as of dataclasses, Python ends by the signal,
    whatever the exit code is.
    """


class _Handler:
    """Raises `Interrupted` at one of `SIGNALS`."""

    def __init__(self) -> None:
        self.received = 0
        self._is_over = False
        self._last = -PATIENCE_S

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self._is_over or now - self._last < PATIENCE_S:
            return
        self.received, self._last = number, now
        # The effects of a sudden end on threads and libraries are not worth a line.
        warnings.simplefilter("ignore")
        threading.excepthook = lambda _: None
        sys.unraisablehook = self._unraisable
        raise Interrupted

    def end(self) -> int:
        """End the command, and ignore SIGINT from now on; return the received signal, 0 for none."""
        self._is_over = True
        # Python gives signals back before it ends.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        return self.received

    def _unraisable(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Try again if the exception was raised in a place that passes none on, such as a destructor."""
        if issubclass(unraisable.exc_type, KeyboardInterrupt) and not self._is_over:
            self._last = -PATIENCE_S
            again = threading.Timer(_RETRY_S, signal.raise_signal, (self.received,))
            again.daemon = True
            again.start()


def run(command: Callable[[], None]) -> None:
    """Run a command that ends with SystemExit; where a signal ends it, print one line and exit with 130 or 143."""
    handler = _Handler()
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as SIGINT is under nohup
            signal.signal(number, handler)
    try:
        command()
    except SystemExit as end:
        if not handler.end() or not end.code:
            raise
    except BaseException:
        if not handler.end():
            raise
    if received := handler.end():
        print(LINE, file=sys.stderr, flush=True)
        raise SystemExit(128 + received)


def is_interrupted() -> bool:
    """Return whether this process received a signal to end: errors are then a consequence."""
    return any(getattr(signal.getsignal(number), "received", 0) for number in SIGNALS)
