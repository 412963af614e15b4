"""The command line. Heavy imports happen inside the commands, so that help answers at once."""

import sys
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from dancedata.cli.build import build, check, init
from dancedata.cli.cache import cache
from dancedata.cli.command import fail
from dancedata.cli.help import help_text
from dancedata.cli.hubs import export, pull, push
from dancedata.cli.info import info
from dancedata.cli.options import Summary, WholeHelp
from dancedata.cli.pages import report, study, view
from dancedata.cli.samples import decode, evaluate, features
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.version import __version__


class _Helpful:
    """Help of two lengths; flags that are not given are False, except --normalized.

    Typer leaves some of them None, and then loads pydantic, which takes as long as the rest of Typer.
    """

    def get_help(self, ctx: Any) -> str:
        return help_text(ctx, self, full=False)

    def get_params(self, ctx: Any) -> list[Any]:
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        return [_false_by_default(parameter) for parameter in parameters]


class Command(_Helpful, TyperCommand):
    """A command."""


class Commands(_Helpful, TyperGroup):
    """All commands. Wrong usage is an error like every other, as JSON where that is asked for."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the options of the group."""
        ctx.meta["arguments"] = list(args)
        if not args:
            typer.echo(self.get_help(ctx))
            raise typer.Exit(2)
        rest: list[str] = _checked(ctx, lambda: super(Commands, self).parse_args(ctx, args))
        return rest

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        return _checked(ctx, lambda: super(Commands, self).invoke(ctx))


def _checked(ctx: Any, call: Any) -> Any:
    """Call a function; where it finds wrong usage, end the command with an error."""
    try:
        return call()
    except Exception as raised:
        error: Any = raised  # not by its class: Typer has its own copy of Click
        if not hasattr(error, "format_message"):
            raise
        arguments = ctx.meta["arguments"]
        name = next((argument for argument in arguments if not argument.startswith("-")), "")
        fix = f"see: dancedata {name} -h"
        if name not in ctx.command.commands:
            fix = did_you_mean(name, ctx.command.commands)
        elif not str(getattr(error, "option_name", "--")).startswith("--"):
            fix = f"a name that begins with - goes last, after --: dancedata {name} ... -- -NAME"
        problem = error.format_message().rstrip(".")
        fail(UsageError(problem[:1].lower() + problem[1:], fix=fix), "--json" in arguments, name)


def _false_by_default(parameter: Any) -> Any:
    if getattr(parameter, "is_flag", False) and parameter.default is None and parameter.name != "normalized":
        parameter.default = False
    return parameter


app = typer.Typer(
    cls=Commands,
    help="Turn dance motion capture and music into training data, and judge what a model makes of it.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": []},
)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="The version.")] = False,
    summary: Summary = False,
    whole_help: WholeHelp = False,
) -> None:
    if version:
        typer.echo(f"dancedata {__version__}")
        raise typer.Exit


#: In the order of the help: those of every week, then the others.
for function in (
    init, build, check, info, view, report, evaluate, decode, export, features,
    pull, push, study, cache,
):  # fmt: skip
    app.command(function.__name__, cls=Command, help=function.__doc__)(function)


def main() -> None:
    """Run the command line."""
    # A path need not be UTF-8, and results name it.
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    app(prog_name="dancedata")
