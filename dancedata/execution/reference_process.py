"""Child processes that Ctrl-C does not reach: one that computes as builds do, one that reports a crash.

A notebook or a training job has loaded numpy long before it requests a feature, so kernels can no longer be
chosen. It needs one more process, which is started by the first computation and kept. That works in every process:
multiprocessing would import the user's script again, and refuses to start children from the workers of a DataLoader.

A crash inside libsndfile or libhdf5 ends a process before Python can print anything; `faulthandler` could name lines
of code, but not the file that was read. A small helper process is therefore sent the current unit, and prints the
last one if its input ends before the work does. Workers do not need it: `run_units` sees them die.
"""

from __future__ import annotations

import atexit
import json
import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import IO, Any, TypeVar, cast

import cloudpickle

from dancedata.core.errors import DanceDataError
from dancedata.core.system import open_file
from dancedata.core.text import printable
from dancedata.execution import arithmetic

T = TypeVar("T")
_LENGTH = struct.Struct("<Q")


class ReferenceProcessError(DanceDataError):
    """The reference process died."""


# The module path is an argument: a new process starts with another one.
_START = "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); "


def python_command(statements: str, *arguments: str) -> list[str]:
    """Return the command of a process that runs statements with the module path of this one.

    No module of the working folder replaces one of Python's own, as it would by ``python -c``.
    """
    # Only texts: Python ignores other entries.
    folders = [folder for folder in sys.path if isinstance(folder, str)]
    return [sys.executable, "-P", "-c", _START + statements, json.dumps(folders), *arguments]


def expected() -> str:
    """Return the instructions that this machine's results are computed with, in any process: a part of their keys."""
    current = arithmetic.here()
    if current == arithmetic.REFERENCE or not arithmetic.is_chosen_by_user():
        return current
    if arithmetic.has_reference() and arithmetic.can_choose():
        return arithmetic.REFERENCE
    return _process_of(os.getpid()).arithmetic


def compute(function: Callable[..., T], *args: Any) -> T:
    """Return ``function(*args)``, computed as `expected` says: here or in the reference process.

    Function, arguments and result must be picklable. Exceptions of the function are raised here.

    Raises
    ------
    ReferenceProcessError
        If the reference process dies.
    """
    if arithmetic.here() == expected():
        return function(*args)
    result: T = _process_of(os.getpid()).call(function, args)
    return result


@lru_cache(maxsize=1)
def _process_of(pid: int) -> ReferenceProcess:
    """Return the reference process of this process, not that of the process it was forked from."""
    return ReferenceProcess()


class ReferenceProcess:
    """A process that computes with the instructions that builds use.

    Attributes
    ----------
    arithmetic
        Its instructions; `arithmetic.REFERENCE` wherever the processor has them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._start()
        self._owner = os.getpid()
        atexit.register(self.end)
        self.arithmetic: str = self._receive()

    def call(self, function: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        """Compute; one call at a time."""
        message = cloudpickle.dumps((function, args))
        with self._lock:
            try:
                if self._process.poll() is not None:
                    self._pipe.close()
                    self._start()
                    self._receive()
                self._pipe.send(message)
                is_error, result = self._receive()
            except BaseException:
                # Interrupted, or dead: its answer must not be returned by the next call.
                self._kill()
                raise
        if is_error:
            raise result
        return result

    def _start(self) -> None:
        command = python_command(f"from {__name__} import serve; serve()")
        with shielded():  # Ctrl-C is for the calling process
            # Nothing in the command comes from outside.
            self._process = subprocess.Popen(  # noqa: S603
                command, env=arithmetic.environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
        self._pipe = _Messages(cast(IO[bytes], self._process.stdout), cast(IO[bytes], self._process.stdin))

    def end(self) -> None:
        """End the process, unless this is a fork of the process that started it."""
        if os.getpid() == self._owner:
            # It would end by itself, but not before all processes that were forked since and hold the pipe, too.
            self._kill()

    def _kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._pipe.close()

    def _receive(self) -> Any:
        try:
            return pickle.loads(self._pipe.receive())  # noqa: S301  (our own process)
        except (EOFError, ConnectionError) as error:
            code = self._process.wait()
            raise ReferenceProcessError(
                "the process that computes features died",
                found=f"exit status {code}" if code >= 0 else f"signal {signal.Signals(-code).name}",
                fix="if memory ran out, use a machine with more; else move the file out of the source and report it",
            ) from error


class _Messages:
    """Messages of bytes through a pair of pipes, which every system has for the standard streams of a process."""

    def __init__(self, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._incoming, self._outgoing = incoming, outgoing

    def send(self, message: bytes) -> None:
        """Send a message; ConnectionError if the other process is gone."""
        self._outgoing.write(_LENGTH.pack(len(message)))
        self._outgoing.write(message)
        self._outgoing.flush()

    def receive(self) -> bytes:
        """Wait for a message; EOFError if the other process is gone."""
        (n,) = _LENGTH.unpack(self._read(_LENGTH.size))
        return self._read(n)

    def _read(self, n: int) -> bytes:
        data = self._incoming.read(n)
        if len(data) < n:
            raise EOFError
        return data

    def close(self) -> None:
        """Close both pipes."""
        self._incoming.close()
        with suppress(OSError):  # a message that was not read
            self._outgoing.close()


def serve() -> None:
    """Compute the calls that arrive through the standard input until its other end is closed."""
    incoming, outgoing = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # Input and output of a feature are not messages.
    nothing = open_file(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    os.close(nothing)
    pipe = _Messages(incoming, outgoing)
    with suppress(EOFError, ConnectionError):
        pipe.send(pickle.dumps(arithmetic.here()))
        while True:
            pipe.send(_answer(pipe.receive()))


def _answer(message: bytes) -> bytes:
    return answer(lambda: pickle.loads(message))  # noqa: S301  (from the process that started this one)


def answer(unpickled: Callable[[], tuple[Callable[..., Any], tuple[Any, ...]]]) -> bytes:
    """Call the function with the arguments that are given; returns, pickled, (False, result) or (True, error)."""
    try:
        function, args = unpickled()
        return bytes(cloudpickle.dumps((False, function(*args))))
    except Exception as error:  # noqa: BLE001  (it is raised in the calling process)
        try:
            return bytes(cloudpickle.dumps((True, error)))
        except Exception:  # noqa: BLE001  (an error that cannot travel)
            return pickle.dumps((True, DanceDataError(f"{type(error).__name__}: {error}")))


@contextmanager
def shielded() -> Iterator[None]:
    """Start processes within the context: they never receive SIGINT; this process receives it when the context ends.

    SIGTERM, which is sent to one process, also reaches this one only then.

    A terminal sends SIGINT to all processes of a command. A child that is starting would print a traceback, and an
    exception in the parent while it starts one leaves the child waiting for input.
    """
    received: list[int] = []
    in_main = threading.current_thread() is threading.main_thread()
    # A handler that is not Python's is None, and stays.
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM) if in_main and signal.getsignal(n)}
    for number in before:
        signal.signal(number, lambda number, _: received.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which children inherit
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
    fix = "Set the file aside if it happens again; finished units are in the cache"
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
