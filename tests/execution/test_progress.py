"""Progress: lines without a terminal, a bar with one, nothing if quiet; units keep their order."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from dancedata.core.errors import DataError
from dancedata.execution import progress as progress_module
from dancedata.execution import units
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units
from tests.messages import raises_message


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def square(x: int) -> int:
    if x < 0:
        raise DataError("below zero", reason="negative", where="unit 3", found=x)
    return x * x


CALLS = [(1,), (2,), (3,)]


@pytest.fixture
def no_time_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress_module, "time", SimpleNamespace(monotonic=lambda: 0.0))


@pytest.mark.usefixtures("no_time_passes")
def test_lines_without_a_terminal(monkeypatch: pytest.MonkeyPatch):
    stream = io.StringIO()
    assert run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream)) == [1, 4, 9]
    assert stream.getvalue() == "squaring: 3/3 in 0.0 s\n"
    monkeypatch.setattr(progress_module, "LINE_INTERVAL_S", 0.0)
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream))
    assert "squaring: 1/3, about 0 s left\nsquaring: 2/3, about 0 s left\nsquaring: 3/3 in" in stream.getvalue()


def test_a_bar_on_a_terminal():
    stream = Terminal()
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream))
    last = stream.getvalue().split("\r")[-1]
    assert last.startswith("squaring: 100%")
    assert "3/3 [00:00<00:00" in last, "time passed and left"
    assert "/s]" in last, "rate"


@pytest.mark.parametrize("is_notebook", [True, False])
def test_a_bar_in_a_notebook(is_notebook: bool, monkeypatch: pytest.MonkeyPatch):
    class Bar(list[int]):
        update = list.append

        def __enter__(self) -> Bar:
            return self

        def __exit__(self, *_: object) -> None: ...

    bars: list[tuple[Bar, dict[str, object]]] = []

    def tqdm(**options: object) -> Bar:
        bars.append((Bar(), options))
        return bars[-1][0]

    # A notebook's stderr is not a terminal.
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    shell = SimpleNamespace(config={"IPKernelApp": {}} if is_notebook else {})
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))  # type: ignore[misc]
    monkeypatch.setitem(sys.modules, "tqdm.auto", SimpleNamespace(tqdm=tqdm))  # type: ignore[misc]
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress())
    assert [bar for bar, _ in bars] == [[1, 1, 1]] * is_notebook
    assert ("squaring: 3/3 in" in sys.stderr.getvalue()) is not is_notebook  # type: ignore[attr-defined]
    # Output that a program writes to its own stream stays text.
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=io.StringIO()))
    assert len(bars) == is_notebook


def test_nothing_if_quiet():
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
    assert run_units(square, calls, cached=cached, jobs=1, label="squaring", progress=Progress(stream=stream)) == [
        1,
        "cached",
        9,
    ]
    assert stream.getvalue() == "squaring: 3/3 in 0.0 s\n"
    monkeypatch.setattr(units, "_run", None)  # worker processes
    cached = ["a", "b", "c"]
    assert run_units(square, calls, cached=cached, jobs=2, label="", progress=Progress(quiet=True)) == cached


def test_no_unit_prints_nothing():
    stream = io.StringIO()
    assert run_units(square, [], jobs=2, label="squaring", progress=Progress(stream=stream)) == []
    assert stream.getvalue() == ""


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_a_unit_arrives_whole(jobs: int):
    with raises_message(DataError) as caught:
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
