"""Commands, run in this process."""

import json
from typing import Any

from typer.testing import CliRunner, Result

from dancedata.cli.app import app


def run(*args: object, code: int = 0) -> Result:
    """Run a command and check its exit code."""
    result = CliRunner().invoke(app, [str(arg) for arg in args])
    assert result.exit_code == code, f"{result.exit_code}: {result.output} {result.exception!r}"
    return result


def as_json(*args: object, code: int = 0) -> Any:
    """Run a command with --json and return its document."""
    return json.loads(run(*args, "--json", code=code).stdout)
