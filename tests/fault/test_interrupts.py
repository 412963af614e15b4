"""Ctrl-C at any moment: one line, exit code 130, nothing left running, and the same command resumes."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from dancedata.cli import interrupts
from dancedata.core.system import shielded


def workers(group: int) -> list[int]:
    """Return the worker processes of a process group that are alive."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            pid = int(path.parent.name)
            if b"popen_loky" in path.read_bytes() and os.getpgid(pid) == group:
                found.append(pid)
    return found


def when_workers_start(process: subprocess.Popen[Any]) -> None:
    """Wait for the first worker process, which takes a quarter of a second to be ready."""
    while process.poll() is None and not workers(process.pid):
        time.sleep(0.002)


def when_it_runs(process: subprocess.Popen[Any]) -> None:
    """Wait until the command, and not Python's own beginning, is what runs: it has loaded numpy."""
    maps = Path(f"/proc/{process.pid}/maps")
    while process.poll() is None and "_multiarray_umath" not in maps.read_text():
        time.sleep(0.002)


@pytest.mark.parametrize("tries", [pytest.param(2), pytest.param(40, marks=pytest.mark.nightly)])
def test_ctrl_c_while_workers_start(slow, corpus, out, undisturbed, hashes, tries):
    slow.sleep(2)  # no build comes to its end
    chance = random.Random(tries)
    for number in range(tries):
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        process = slow.start_cold(corpus, out, "--jobs", 2, start_new_session=True, **pipes)
        if number % 2:
            when_workers_start(process)
            time.sleep(chance.uniform(0, 0.3))
        else:
            when_it_runs(process)
            time.sleep(chance.uniform(0, 1.5))
        os.killpg(process.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
        assert (process.returncode, printed, errors) == (130, "", f"{interrupts.LINE}\n"), number
        assert workers(process.pid) == []
        assert not out.exists()
        if number < tries - 1:
            shutil.rmtree(slow.cache, ignore_errors=True)  # so that workers start again
    slow.sleep(0)
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert slow.strays() == []


def test_an_end_within_a_clean_up_is_silent():
    program = """
from joblib.externals.loky.backend.resource_tracker import register
from dancedata.execution.arithmetic import start_trackers
start_trackers()
register("/dancedata-removed", "semlock")
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_impatience_changes_nothing(slow: Any, corpus: Path, out: Path):
    slow.sleep(0.3)
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = slow.start_cold(corpus, out, "--jobs", 2, start_new_session=True, **pipes)
    when_workers_start(process)
    for _ in range(5):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.02)
    printed, errors = process.communicate(timeout=60)
    assert (process.returncode, printed, errors) == (130, "", f"{interrupts.LINE}\n")
    assert workers(process.pid) == []


# The parts, in this process


@pytest.fixture
def restored(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Put back what a handler changes in the process."""
    import sys
    import threading

    before = {number: signal.getsignal(number) for number in interrupts.SIGNALS}
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    with warnings.catch_warnings():
        yield
    for number, handler in before.items():
        signal.signal(number, handler)


def terminate() -> None:
    signal.raise_signal(signal.SIGTERM)


def interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


def end(code: int) -> None:
    raise SystemExit(code)


def turned_into_another_error() -> None:
    try:
        interrupt()
    except KeyboardInterrupt as error:
        raise ImportError("half of a module") from error


def ended_by_a_library() -> None:
    try:
        interrupt()
    except KeyboardInterrupt:
        end(1)


def in_a_destructor() -> None:
    class Thing:
        def __del__(self) -> None:
            interrupt()

    Thing().__del__  # noqa: B018
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        time.sleep(0.01)


@pytest.mark.usefixtures("restored")
@pytest.mark.parametrize(
    "command",
    [interrupt, terminate, turned_into_another_error, ended_by_a_library, in_a_destructor],
    ids=lambda f: f.__name__,
)
def test_one_line_for_any_exception(command: Any, capfd: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as caught:
        interrupts.run(command)
    assert caught.value.code == (143 if command is terminate else 130)
    assert capfd.readouterr().err == f"{interrupts.LINE}\n"
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


@pytest.mark.usefixtures("restored")
@pytest.mark.parametrize("code", [0, 1, 2])
def test_a_command_that_is_not_interrupted_ends_as_it_does(code: int, capfd: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as caught:
        interrupts.run(lambda: end(code))
    assert caught.value.code == code
    assert capfd.readouterr().err == ""


def test_processes_that_are_started_behind_the_shield_do_not_get_it():
    seen = []
    before = signal.signal(signal.SIGINT, lambda *_: seen.append(1))
    try:
        with shielded():
            child = subprocess.Popen(["sleep", "30"])
            signal.raise_signal(signal.SIGINT)
            assert seen == []
        assert seen == [1], "it comes after the shield"
        child.send_signal(signal.SIGINT)
        with pytest.raises(subprocess.TimeoutExpired):
            child.wait(timeout=0.2)
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    finally:
        signal.signal(signal.SIGINT, before)
        child.kill()
        child.wait()
