"""Commands in forks of one process that has imported the command line: a second less than by a new interpreter.

`Process` is like subprocess.Popen for ``python -m dancedata ...`` and ``python -c CODE ...``; its output is kept.
Run as a script, this module is that process; it reads one request a line.
"""

import atexit
import gc
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import import_module
from pathlib import Path


@lru_cache
def _server() -> subprocess.Popen[bytes]:
    server = subprocess.Popen([sys.executable, __file__], stdin=subprocess.PIPE, cwd=Path(__file__).parents[1])
    atexit.register(server.communicate)  # an end of its input is its end
    return server


class Process:
    """A command in a fork of the warm process."""

    def __init__(self, command: Sequence[str], env: Mapping[str, str], start_new_session: bool = False) -> None:
        self.returncode: int | None = None
        self._folder = Path(tempfile.mkdtemp(prefix="warm-"))
        self._states = b""
        os.mkfifo(self._folder / "states")
        self._fifo = os.open(self._folder / "states", os.O_RDONLY | os.O_NONBLOCK)
        request = {
            "command": command[1:],
            "env": dict(env),
            "folder": str(self._folder),
            "session": start_new_session,
        }
        server = _server().stdin
        assert server is not None
        server.write(json.dumps({**request, "cwd": str(Path.cwd())}).encode() + b"\n")
        server.flush()
        while self._states.count(b"\n") < 1:
            self._read(60)
        self.pid = int(self._states.split()[0])

    def _read(self, timeout: float | None) -> None:
        if select.select([self._fifo], [], [], timeout)[0]:
            self._states += os.read(self._fifo, 100)

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal, or None."""
        if self.returncode is None:
            self._read(0)
            if self._states.count(b"\n") > 1:
                self.returncode = os.waitstatus_to_exitcode(int(self._states.split()[1]))
                self._output = [(self._folder / name).read_text(encoding="utf-8") for name in "12"]
                os.close(self._fifo)
                shutil.rmtree(self._folder)
        return self.returncode

    def wait(self, timeout: float = 300) -> int:
        """Wait for its end."""
        end = time.monotonic() + timeout
        while self.poll() is None:
            left = end - time.monotonic()
            if left < 0:
                raise subprocess.TimeoutExpired("a command", timeout)
            self._read(left)
        assert self.returncode is not None
        return self.returncode

    def communicate(self, timeout: float = 300) -> tuple[str, str]:
        """Wait for its end, and return what it printed."""
        self.wait(timeout)
        printed, errors = self._output
        return printed, errors


def run(command: Sequence[str], env: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, as subprocess.run does."""
    process = Process(command, os.environ if env is None else env)
    printed, errors = process.communicate()
    return subprocess.CompletedProcess(command, process.wait(), printed, errors)


def _serve() -> None:
    """Fork a command for each request; a process in between waits for it, whose states the pipe gets."""
    from dancedata.cli import app  # noqa: F401
    from dancedata.execution.arithmetic import adopt

    adopt()
    import dancedata.audio.librosa35.feature
    import dancedata.building.commands
    import dancedata.contacts.velocity
    import dancedata.datasets.aistpp
    import dancedata.datasets.folder
    import dancedata.evaluation.run
    import dancedata.execution.executors
    import dancedata.representations.edge151  # noqa: F401

    for package in ("scipy.ndimage", "scipy.spatial.transform", "soundfile", "soxr"):
        import_module(package)
    gc.freeze()  # a collection in a fork would copy all of this
    for line in iter(sys.stdin.buffer.readline, b""):
        request = json.loads(line)
        between = os.fork()
        if not between:
            break
        _reap()
    else:
        return
    states = os.open(Path(request["folder"], "states"), os.O_WRONLY)
    if child := os.fork():
        os.write(states, f"{child}\n".encode())
        _, status = os.waitpid(child, 0)
        os.write(states, f"{status}\n".encode())
        os._exit(0)
    os.close(states)
    _begin(request)


def _reap() -> None:
    """Take the times of processes that have ended."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        pass


def _begin(request: dict) -> None:
    """Make this process one that the shell has started, and run the command."""
    if request["session"]:
        os.setsid()
    os.chdir(request["cwd"])
    for number, name in enumerate((os.devnull, "1", "2")):
        file = os.open(Path(request["folder"], name), os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
        os.dup2(file, number)
        os.close(file)
    sys.stdin, sys.stdout, sys.stderr = (
        open(number, mode, encoding="utf-8", closefd=False)  # noqa: SIM115
        for number, mode in enumerate("rww")
    )
    os.environ.clear()
    os.environ.update(request["env"])
    tempfile.tempdir = None
    sys.path[:0] = [path for path in request["env"].get("PYTHONPATH", "").split(os.pathsep) if path not in sys.path]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    kind, what, *rest = request["command"]
    if kind == "-m":
        from dancedata.__main__ import main

        sys.argv = [what, *rest]
        main()
    else:
        sys.argv = ["-c", *rest]
        exec(compile(what, "<string>", "exec"), {"__name__": "__main__"})


if __name__ == "__main__":
    # The folder of this script would be searched for modules first.
    sys.path[0] = str(Path(__file__).parents[1])
    _serve()
