"""How commands turn errors into text and exit codes."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import typer

from dancedata.cli.interrupts import EXIT_CODE, is_interrupted
from dancedata.core.errors import DanceDataError, UsageError
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
        except DanceDataError as error:
            if is_interrupted():
                raise typer.Exit(EXIT_CODE) from None
            typer.echo(f"error: {error}", err=True)
            raise typer.Exit(2 if isinstance(error, UsageError) else 1) from None
        except KeyboardInterrupt:
            raise typer.Exit(EXIT_CODE) from None

    return run
