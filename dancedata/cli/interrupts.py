"""Ctrl-C and SIGTERM end a command with one line and exit code 130 or 143, at any point."""

import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

#: Signals that end a command in order, as batch systems and `timeout` send the second. Exit code: 128 and the number.
SIGNALS = (signal.SIGINT, signal.SIGTERM)
LINE = "interrupted; run the same command again to go on"
#: Seconds within which a second signal counts as the first, while files are put in order.
PATIENCE_S = 1.0
_received, _until = 0, 0.0


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, or SIGTERM. Python would end by the signal if a plain KeyboardInterrupt passed code made from text."""


def _interrupt(number: int, _: object = None) -> None:
    global _received, _until
    if time.monotonic() >= _until:
        _received, _until = number, time.monotonic() + PATIENCE_S
        # The effects of a sudden end on threads and libraries are not worth a line.
        warnings.simplefilter("ignore")
        threading.excepthook = lambda _: None
        sys.unraisablehook = _again
        raise Interrupted


def _again(unraisable: Any) -> None:
    """Try again: the exception was raised in a place that passes none on, such as a destructor."""
    global _until
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        _until = 0.0
        again = threading.Timer(0.05, signal.raise_signal, (_received,))
        again.daemon = True
        again.start()


def run(command: Callable[[], None]) -> None:
    """Run a command that ends with SystemExit; where a signal ends it, print one line and exit with 130 or 143."""
    global _received, _until
    _received, _until = 0, 0.0
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as SIGINT is under nohup
            signal.signal(number, _interrupt)
    try:
        command()
    except BaseException as end:
        if not _received or (isinstance(end, SystemExit) and not end.code):
            raise
    finally:
        # Python gives signals back before it ends.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if _received:
        print(LINE, file=sys.stderr, flush=True)
        raise SystemExit(128 + _received)


def is_interrupted() -> bool:
    """Return whether this process received a signal to end: errors are then a consequence."""
    return bool(_received)
