"""Progress: lines where there is no terminal, a bar where there is one, nothing if asked; units keep their order."""

from __future__ import annotations

import io

import pytest

from dancedata.core.errors import DataError
from dancedata.execution import units
from dancedata.execution.progress import Progress
from dancedata.execution.units import run_units


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def square(x: int) -> int:
    if x < 0:
        raise DataError("below zero", reason="negative", where="unit 3", found=x)
    return x * x


CALLS = [(1,), (2,), (3,)]


def test_lines_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch):
    stream = io.StringIO()
    assert run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream)) == [1, 4, 9]
    assert stream.getvalue() == "squaring: 3/3 in 0.0 s\n"
    monkeypatch.setattr("dancedata.execution.progress.LINE_INTERVAL_S", 0.0)
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream))
    assert "squaring: 1/3, about 0 s left\nsquaring: 2/3, about 0 s left\nsquaring: 3/3 in" in stream.getvalue()


def test_a_bar_on_a_terminal():
    stream = Terminal()
    run_units(square, CALLS, jobs=1, label="squaring", progress=Progress(stream=stream))
    last = stream.getvalue().split("\r")[-1]
    assert last.startswith("squaring: 100%")
    assert "3/3 [00:00<00:00" in last, "time passed and left"
    assert "/s]" in last, "rate"


def test_nothing_if_quiet():
    for stream in (io.StringIO(), Terminal()):
        progress = Progress(quiet=True, stream=stream)
        progress.write("hello")
        run_units(square, CALLS, jobs=1, label="squaring", progress=progress)
        assert stream.getvalue() == ""


def test_what_is_known_is_not_computed(monkeypatch: pytest.MonkeyPatch):
    stream = io.StringIO()
    calls = [(1,), (-2,), (3,)]
    known = [None, "known", None]
    assert run_units(square, calls, known=known, jobs=1, label="squaring", progress=Progress(stream=stream)) == [
        1,
        "known",
        9,
    ]
    assert stream.getvalue() == "squaring: 3/3 in 0.0 s\n"
    monkeypatch.setattr(units, "_run", None)  # worker processes
    every = ["a", "b", "c"]
    assert run_units(square, calls, known=every, jobs=2, label="", progress=Progress(quiet=True)) == every


def test_no_unit_prints_nothing():
    stream = io.StringIO()
    assert run_units(square, [], jobs=2, label="squaring", progress=Progress(stream=stream)) == []
    assert stream.getvalue() == ""


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_a_unit_arrives_whole(jobs: int):
    with pytest.raises(DataError) as caught:
        run_units(square, [(1,), (-2,), (3,)], jobs=jobs, label="squaring", progress=Progress(quiet=True))
    assert (caught.value.reason, caught.value.where, caught.value.found) == ("negative", "unit 3", -2)
