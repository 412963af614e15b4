"""How commands turn errors into text and exit codes."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import typer

from dancedata.cli.interrupts import Interrupted, is_interrupted
from dancedata.core.errors import DanceDataError, UsageError, unwritable_name
from dancedata.execution.arithmetic import adopt


def errors_to_exit_codes(command: Callable[..., None]) -> Callable[..., None]:
    """Print our errors as text: exit code 2 for wrong usage, 1 for a problem in the data.

    Before a command begins, and loads numpy, the instructions are chosen that results are computed with.
    """

    @wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            adopt()
            command(*args, **kwargs)
        except (DanceDataError, UnicodeEncodeError) as error:
            if is_interrupted():
                raise Interrupted from None
            failure = unwritable_name(error) if isinstance(error, UnicodeEncodeError) else error
            typer.echo(f"error: {failure}", err=True)
            raise typer.Exit(2 if isinstance(failure, UsageError) else 1) from None

    return run
