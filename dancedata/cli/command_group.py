"""The commands as one group: their order in the help, and flags that are False."""

from typing import Any

from typer.core import TyperGroup

#: Groups of commands in the help; most characters of a sentence there.
_ORDER = {
    "Make a dataset": ("manifest", "build", "plan", "check", "quality", "align"),
    "Look at it": ("view", "report", "info", "study", "study-results"),
    "Use it": ("export", "evaluate", "decode"),
}
_SENTENCE = 55


class Commands(TyperGroup):
    """Commands whose omitted flags are False, also `--help`; except --normalized.

    Typer leaves some of them None, and then loads pydantic, a fifth of the time of `list`, to convert None.
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

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in groups, in the order in which they are used."""
        commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        groups = {title: [name for name in names if name in commands] for title, names in _ORDER.items()}
        known = [name for names in groups.values() for name in names]
        groups["The rest"] = [name for name in commands if name not in known]
        width = max(map(len, commands))
        for title, names in ((title, names) for title, names in groups.items() if names):
            with formatter.section(title):
                formatter.write_dl(
                    [(name.ljust(width), commands[name].get_short_help_str(_SENTENCE)) for name in names]
                )

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
