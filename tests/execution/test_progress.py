"""Progress: lines without a terminal, a bar with one, nothing if quiet; units keep their order."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from dancedata.core.errors import DataError
from dancedata.execution import stage_display, units
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units
from tests.messages import raises_message


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def plain(text: str) -> str:
    """Return the text of a terminal without its control sequences."""
    return re.sub(r"\x1b\[[\d;?]*[A-Za-z]|\r", "", text)


def square(x: int) -> int:
    if x < 0:
        raise DataError("below zero", reason="negative", where="unit 3", found=x)
    return x * x


CALLS = [(1,), (2,), (3,)]


@pytest.fixture
def no_time_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stage_display, "time", SimpleNamespace(monotonic=lambda: 0.0))


@pytest.mark.usefixtures("no_time_passes")
def test_lines_without_a_terminal(monkeypatch: pytest.MonkeyPatch):
    stream = io.StringIO()
    assert run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream)) == [1, 4, 9]
    assert stream.getvalue() == "squaring: 3/3 in 0.0 s\n"
    monkeypatch.setattr(stage_display, "LINE_INTERVAL_S", 0.0)
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream))
    with Progress(stream=stream).stage("writing the video", None):
        pass
    assert stream.getvalue().endswith("writing the video: done in 0.0 s\n")
    assert "squaring: 1/3, about 0 s left\nsquaring: 2/3, about 0 s left\nsquaring: 3/3 in" in stream.getvalue()


@pytest.mark.usefixtures("no_time_passes")
def test_a_bar_on_a_terminal():
    stream = Terminal()
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream))
    text = plain(stream.getvalue())
    assert "━ 3/3" in text
    *_, shown, last, end = text.split("\n")
    assert shown.startswith("squaring "), "the bar, which the next line replaces"
    assert last.split() == ["squaring", "3", "0.0", "s"]
    assert end == ""
    assert re.search(r"\x1b\[1A\x1b\[2K\x1b\[2msquaring", stream.getvalue())


@pytest.mark.usefixtures("no_time_passes")
def test_rows_of_stages_are_a_table():
    stream = Terminal()
    progress = Progress(stream=stream)
    for label, total, known in (("hashing", 1188, 1188), ("encoding motion", 12, 0), ("waiting", None, 0)):
        with progress.stage(label, total, known) as advance:
            advance(12)
    rows = [line for line in plain(stream.getvalue()).split("\n") if line and "━" not in line]
    assert rows == [
        "hashing                     1,188    cached",
        "encoding motion                12     0.0 s",
        "waiting                               0.0 s",
    ]


def test_a_terminal_without_a_cursor_or_colour_gets_neither(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("NO_COLOR", "1")
    stream = Terminal()
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream))
    assert not re.search(r"\x1b\[[\d;]*m", stream.getvalue())
    monkeypatch.setenv("TERM", "dumb")
    stream = Terminal()
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream))
    assert re.fullmatch(r"squaring: 3/3 in \d\.\d s\n", stream.getvalue())


@pytest.mark.parametrize("is_notebook", [True, False])
def test_a_bar_in_a_notebook(is_notebook: bool, monkeypatch: pytest.MonkeyPatch):
    # A notebook's stderr is not a terminal.
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    shell = SimpleNamespace(config={"IPKernelApp": {}} if is_notebook else {})
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))  # type: ignore[misc]
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress())
    assert ("━ 3/3" in plain(sys.stderr.getvalue())) is is_notebook  # type: ignore[attr-defined]
    assert ("squaring: 3/3 in" in sys.stderr.getvalue()) is not is_notebook  # type: ignore[attr-defined]
    # Output that a program writes to its own stream stays text.
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=(stream := io.StringIO())))
    assert stream.getvalue().startswith("squaring: 3/3 in")


def test_nothing_if_quiet_or_without_units():
    assert run_units(square, [], jobs=2, label="squaring", progress=Progress(stream=(none := io.StringIO()))) == []
    assert none.getvalue() == ""
    for stream in (io.StringIO(), Terminal()):
        progress = Progress(quiet=True, stream=stream)
        progress.write("hello")
        run_units(square, CALLS, jobs=1, label="squaring", progress=progress)
        assert stream.getvalue() == ""


@pytest.mark.usefixtures("no_time_passes")
def test_cached_results_are_not_recomputed(monkeypatch: pytest.MonkeyPatch):
    stream = io.StringIO()
    calls = [(1,), (-2,), (3,)]
    cached = [None, "cached", None]
    found = run_units(square, calls, cached=cached, jobs=1, label="squaring", progress=Progress(stream=stream))
    assert found == [1, "cached", 9]
    assert stream.getvalue() == "squaring: 3/3 in 0.0 s\n"
    monkeypatch.setattr(units, "_run", None)  # worker processes
    cached = ["a", "b", "c"]
    assert run_units(square, calls, cached=cached, jobs=2, label="", progress=Progress(quiet=True)) == cached


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_a_unit_arrives_whole(jobs: int):
    with raises_message(DataError, "zero", where="unit 3") as caught:
        run_units(square, [(1,), (-2,), (3,)], jobs=jobs, label="squaring", progress=Progress(quiet=True))
    assert (caught.value.reason, caught.value.where, caught.value.found) == ("negative", "unit 3", -2)


def test_a_script_without_a_guard_may_use_worker_processes(tmp_path: Path):
    """As a notebook: its functions travel to the workers, which do not run it again."""
    script = tmp_path / "script.py"
    script.write_text("""
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units
print("begin")
def twice(x):
    return 2 * x
print(run_units(twice, [(1,), (2,), (3,)], jobs=2, label="", progress=Progress(quiet=True)))
""")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("begin\n[2, 4, 6]\n", "")
