"""Commands, run in this process; and processes that are killed."""

import json
import multiprocessing
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from typer.testing import CliRunner, Result

from dancedata.cli.app import app


def run(*args: object, code: int = 0) -> Result:
    """Run a command and check its exit code."""
    result = CliRunner().invoke(app, [str(arg) for arg in args])
    assert result.exit_code == code, f"{result.exit_code}: {result.output} {result.exception!r}"
    return result


def as_json(*args: object, code: int = 0) -> Any:
    """Run a command with --json, check the head of its document, and return the result, or the error."""
    document = json.loads(run(*args, "--json", code=code).stdout)
    assert (document["ok"], document["command"]) == (code == 0, str(args[0]))
    return document["error" if "error" in document else "result"]


@contextmanager
def killed_afterwards(code: str, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Run code in a new process that prints a line when it is ready; the process is killed after the context."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def in_processes(n: int, target: Callable[[], Any]) -> list[Any]:
    """Run a function in forks that begin at the same time; returns what they got."""
    fork = multiprocessing.get_context("fork")
    queue, barrier = fork.SimpleQueue(), fork.Barrier(n)

    def run() -> None:
        barrier.wait()
        queue.put(target())

    processes = [fork.Process(target=run) for _ in range(n)]
    for process in processes:
        process.start()
    found = [queue.get() for _ in processes]
    for process in processes:
        process.join()
    return found
