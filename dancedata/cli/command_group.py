"""The commands as one group."""

from typing import Any

from typer.core import TyperGroup


class Commands(TyperGroup):
    """Commands whose omitted flags are False, also `--help`; except --normalized.

    Typer leaves some of them None, and then loads pydantic, which takes as long as the rest of Typer.
    An id of a clip that begins with "-" is not an option: the error for an unknown option names "--".
    """

    def invoke(self, ctx: Any) -> Any:
        """Run a command; an unknown short option may be an id."""
        try:
            return super().invoke(ctx)
        except Exception as raised:
            error: Any = raised  # not by its class: recent versions of Typer have their own copy of Click
            if not str(getattr(error, "option_name", "--")).startswith("--"):
                error.message += '. A name that begins with "-" goes last, after --: dancedata view OUT -- -NAME'
            raise

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the options of the group."""
        return [_false_by_default(parameter) for parameter in super().get_params(ctx)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, None if there is none of this name."""
        command = super().get_command(ctx, cmd_name)
        for parameter in [] if command is None else command.get_params(ctx):
            _false_by_default(parameter)
        return command


def _false_by_default(parameter: Any) -> Any:
    if getattr(parameter, "is_flag", False) and parameter.default is None and parameter.name != "normalized":
        parameter.default = False
    return parameter
