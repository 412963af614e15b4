"""What every command does: its options, its output as text or as JSON, its errors as exit codes."""

import inspect
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import typer

from dancedata.cli.interrupts import Interrupted, is_interrupted
from dancedata.cli.options import HELP, About, parameters_of, read_values
from dancedata.cli.terminal import say
from dancedata.core.errors import DanceDataError, StoreError, UsageError, unwritable_name
from dancedata.core.plugin_files import load_plugins
from dancedata.core.tables import json_text
from dancedata.core.version import __version__
from dancedata.execution.arithmetic import adopt


@dataclass(frozen=True)
class Output:
    """The result of a command, as a JSON document and as text."""

    document: Callable[[], Any]
    text: Callable[[], str]
    ok: bool = True  # whether the exit code is 0, else 1
    warnings: Sequence[str] = ()  # those of the document; the text has them already
    error: DanceDataError | None = None  # a problem for which there is a document all the same


def command(shared: str, **about: About) -> Callable[[Callable[..., Any]], Callable[..., None]]:
    """Make commands: exit code 2 for wrong usage, 1 for a problem in the data, errors as text or as JSON.

    `shared`: Names of options in `SHARED`, which the function gets as keywords.
    `about`: What is said of its own arguments and options. A function returns an `Output`, a result of the package
        with its text and `to_json`, or None if it has printed what there is.

    Before a command begins, and loads numpy, the instructions are chosen that results are computed with.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., None]:
        @wraps(function)
        def run(as_json: bool, **arguments: Any) -> None:
            _run(function, as_json, {name: value for name, value in arguments.items() if name not in HELP})

        parameters = list(parameters_of(function, shared, about))
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return run

    return decorate


def _run(function: Callable[..., Any], as_json: bool, arguments: dict[str, Any]) -> None:
    name, warnings, output, result = function.__name__, list[str](), None, None
    try:
        adopt()
        load_plugins(*(arguments.pop("plugins", None) or ()))
        if "quiet" in arguments and as_json:
            arguments["quiet"] = True
        if "as_json" in inspect.signature(function).parameters:
            arguments["as_json"] = as_json
        with _collected(warnings, shown=not as_json):
            output = function(**read_values(arguments))
            if hasattr(output, "to_json"):
                output = Output(output.to_json, output.__str__)
            if output is not None:
                result = output.document() if as_json else output.text()
    except (DanceDataError, UnicodeEncodeError, OSError) as raised:
        if is_interrupted():
            raise Interrupted from None
        fail(_error(raised), as_json, name, warnings)
    if output is None:
        return
    ok, warnings = output.ok and output.error is None, [*warnings, *output.warnings]
    if as_json:
        _print(name, ok, warnings, output.error, result=result)
    elif output.error is not None:
        fail(output.error, False, name)
    else:
        say(str(result))
    if not ok:
        raise typer.Exit(1)


def _error(raised: Exception) -> DanceDataError:
    """Return the error to print; one of the operating system, such as for an unreadable folder, as StoreError."""
    if isinstance(raised, UnicodeEncodeError):
        return unwritable_name(raised)
    return raised if isinstance(raised, DanceDataError) else StoreError("the system call failed", found=str(raised))


def fail(error: DanceDataError, as_json: bool, name: str, warnings: Sequence[str] = ()) -> Any:
    """Print an error, by options and paths as they are typed, and end the command with its exit code."""
    error.fix = error.options or error.fix
    if isinstance(error.where, str | Path):
        with suppress(OSError):  # of a working directory that was removed
            error.where = str(error.where).removeprefix(f"{Path.cwd()}{os.sep}")
    if as_json:
        _print(name, False, warnings, error)
    else:
        say(f"error: {error}", err=True)
    raise typer.Exit(2 if isinstance(error, UsageError) else 1)


def _print(name: str, ok: bool, warnings: Sequence[str], error: DanceDataError | None, **result: Any) -> None:
    """Print the document of a command, on stdout."""
    head = {"dancedata": __version__, "command": name, "ok": ok, "warnings": list(warnings)}
    typer.echo(json_text({**head, **({} if error is None else {"error": error.to_json()}), **result}))


@contextmanager
def _collected(warnings: list[str], *, shown: bool) -> Iterator[None]:
    """Take what the package warns of, and print it on stderr."""

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            warnings.append(record.getMessage())
            if shown:
                say(f"warning: {warnings[-1]}", err=True)

    logger, handler = logging.getLogger("dancedata"), Handler(logging.WARNING)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
