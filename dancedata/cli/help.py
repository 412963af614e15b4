"""The help of commands, 80 columns wide: a summary by -h, all of it by --help."""

import inspect
import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import typer

#: Sections of options that a summary only names.
RARE = "Rarely needed"
#: On the page of all commands: options that are described once, for all.
SEVERAL = "Of several commands"
SAMPLES = "Samples that do not say what they are"
_WIDTH = 80
#: Columns of the names of options, of arguments and commands.
_OPTION, _NAME = 22, 9
GROUPS = {"Every week": 10, "Now and then": 4}
_CODES = """Exit codes: 0 done; 1 the data do not allow it, or something is wrong or differs;
2 wrong usage; 130 and 143 interrupted, the same command resumes."""


def print_help(*, full: bool) -> Callable[..., None]:
    """Return the callback of an option that prints help and ends the command."""

    def show(ctx: typer.Context, value: bool) -> None:
        if value:
            typer.echo(help_text(ctx, ctx.command, full=full))
            raise typer.Exit

    return show


def help_text(ctx: Any, command: Any, *, full: bool) -> str:
    """Return the help of a command or of the whole command line."""
    parts = _group(command, full=full) if hasattr(command, "commands") else _command(ctx, command, full=full)
    return "\n\n".join(parts)


def _group(group: Any, *, full: bool) -> Iterator[str]:
    yield "Usage: dancedata COMMAND ..."
    yield textwrap.fill(group.help, _WIDTH)
    commands = list(group.commands.items())
    for title, n in GROUPS.items():
        rows, commands = commands[:n], commands[n:]
        yield _section(title, [(name, command.help.split(".\n")[0].removesuffix(".")) for name, command in rows], 10)
    about = "A summary; --help also lists what is rarely needed"
    yield "\n".join([_row("-h, --help", about, 13), _row("--version", "The version", 13)])
    if full:
        yield f"{_CODES}\nThe cache is $DANCEDATA_CACHE, else your cache folder."
    yield "Try it:  dancedata build demo && dancedata view data/demo"


def _command(ctx: Any, command: Any, *, full: bool) -> Iterator[str]:
    parameters = command.get_params(ctx)
    arguments = [p for p in parameters if p.param_type_name == "argument"]
    options = [p for p in parameters if p.param_type_name == "option" and not p.hidden]
    required = [f"{p.opts[-1]} {p.metavar}" for p in options if p.required]
    names = [p.metavar if p.required else f"[{p.metavar}]" for p in arguments]
    yield textwrap.fill(
        " ".join([f"Usage: dancedata {ctx.info_name}", *names, *required, "[OPTIONS]"]),
        _WIDTH,
        subsequent_indent="    ",
    )
    about, *rest = inspect.cleandoc(command.help).split("\n\n")
    yield textwrap.fill(about, _WIDTH)
    examples = [part for part in rest if part.lstrip().startswith("dancedata ")]
    yield from (textwrap.indent(textwrap.dedent(part), "  ") for part in examples)
    if arguments:
        yield _section("Arguments", [(p.metavar, p.help) for p in arguments], _NAME)
    sections: dict[str, list[Any]] = {"Options": []}
    for option in options:
        sections.setdefault(option.rich_help_panel or "Options", []).append(option)
    for title in sorted(sections, key=[*(t for t in sections if t not in (SAMPLES, RARE)), SAMPLES, RARE].index):
        if (full or title not in (SAMPLES, RARE)) and title != SEVERAL:
            if sections[title]:
                yield describe_options(title, sections[title])
        else:
            listed = ", ".join(f"{p.opts[-1]} {p.metavar or ''}".strip() for p in sections[title])
            line = f"{title}{' (--help)' * (not full)}: {listed}"
            yield textwrap.fill(line, _WIDTH, subsequent_indent="  ", break_on_hyphens=False)
    yield from (textwrap.fill(part, _WIDTH) for part in rest if part not in examples)


def describe_options(title: str, options: Sequence[Any]) -> str:
    """Return a section of the help, with a row for each option."""
    return _section(title, [(_names(option), option.help) for option in options], _OPTION)


def _names(option: Any) -> str:
    """Return the names of an option, the short one first."""
    names = ", ".join([*sorted(option.opts, key=len), *option.secondary_opts])
    return f"{names} {option.metavar}" if option.metavar and not option.is_flag else names


def _section(title: str, rows: Sequence[tuple[str, str]], column: int) -> str:
    return "\n".join([f"{title}:", *(_row(name, about, column) for name, about in rows)])


def _row(name: str, about: str, column: int) -> str:
    indent = " " * (column + 2)
    first = f"  {name.ljust(column)}" if len(name) < column else f"  {name}\n{indent}"
    return first + textwrap.fill(about, _WIDTH - len(indent), break_on_hyphens=False).replace("\n", f"\n{indent}")
