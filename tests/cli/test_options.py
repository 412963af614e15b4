"""An option has one name, one default and one meaning on the command line, in Python and in the docstring."""

import inspect
import re
from collections.abc import Callable
from typing import Any

import pytest

import dancedata
from dancedata.building.commands import build_part, plan
from dancedata.cli import app as commands
from dancedata.cli import options

#: Options of the command line alone: its output, and other functions of Python.
OUTPUT = {"as_json", "quiet", "plugins"}
OTHER = {"build": {"part"}, "evaluate": {"per_clip", "table", "list_protocols", "self_test", "source"}}
#: Options with another name in Python, where several values are one argument there.
RENAMED = {"evaluate": {"metric": "metrics"}, "decode": {"files": "columns"}, "check": {"paths": "path"}}
#: Keys of export targets, which Python takes as `parameters`.
PARAMETERS = {"export": {"feature", "scaler", "keep_ignored", "overrides"}}
#: Options whose default differs, with those of the command line and of Python; every other one has the same.
DEFAULTS = {
    ("evaluate", "what"): (None, inspect.Parameter.empty),
    ("evaluate", "protocol"): (None, "dancedata"),
    **{("decode", name): (inspect.Parameter.empty, None) for name in ("to", "out")},
    ("evaluate", "jobs"): (None, 1),
}
PYTHON: dict[str, Callable[..., Any]] = {
    "build": dancedata.build, "plan": plan, "check": dancedata.check, "decode": dancedata.decode,
    "export": dancedata.export, "evaluate": dancedata.evaluate,
}  # fmt: skip


def taken(command: str) -> dict[str, inspect.Parameter]:
    """Return the parameters of a command that its Python function takes, by their names there."""
    without = OUTPUT | OTHER.get(command, set()) | PARAMETERS.get(command, set())
    signature = inspect.signature(getattr(commands, command)).parameters
    names = RENAMED.get(command, {})
    return {names.get(name, name): p for name, p in signature.items() if name not in without}


def documented(function: Callable[..., Any]) -> set[str]:
    """Return the names in the Parameters section of a docstring."""
    section = inspect.getdoc(function).split("Parameters\n----------\n")[1].split("\n\n")[0]  # type: ignore[union-attr]
    return {name for line in re.findall(r"^\S.*", section, flags=re.MULTILINE) for name in line.split(", ")}


@pytest.mark.parametrize("command", PYTHON)
def test_python_takes_the_options_of_the_command(command: str) -> None:
    python = inspect.signature(PYTHON[command]).parameters
    for name, option in taken(command).items():
        assert name in python, name
        pair = (option.default, python[name].default)
        if (command, name) in DEFAULTS:
            assert pair == DEFAULTS[command, name], name
        else:
            assert pair[0] == pair[1] or {pair[0], pair[1]} <= {None, ()}, name


@pytest.mark.parametrize("function", [*PYTHON.values(), build_part], ids=lambda f: f.__name__)
def test_the_docstring_lists_the_parameters(function: Callable[..., Any]) -> None:
    assert documented(function) == set(inspect.signature(function).parameters)


@pytest.mark.parametrize("command", PYTHON)
def test_shared_options_are_defined_once(command: str) -> None:
    shared: dict[str, list[Any]] = {
        "as_json": [options.AsJson], "backend": [options.Backend], "cache": [options.CacheFolder],
        "clip": [options.Clip], "jobs": [options.Jobs, options.JobsOrCores], "normalized": [options.Normalized],
        "quiet": [options.Quiet], "scheduler": [options.Scheduler],
    }  # fmt: skip
    annotations = inspect.get_annotations(getattr(commands, command), eval_str=True)
    assert annotations.keys() & shared.keys()
    for name in annotations.keys() & shared.keys():
        assert annotations[name] in shared[name], name
