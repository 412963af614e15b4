"""Text for the user: in colour on a terminal, everywhere else as it is."""

import re
import sys

import typer

_KIND = re.compile(r"\s*(error|bad|FAILED|look|note)(?=:|  )")
_STYLES = {"look": "yellow", "note": "dim"}
#: Numbers by themselves, not those in names, paths, addresses and options.
_NUMBER = r"(?<![\w./:=+-])\d+(?:,\d{3})*(?:\.\d+)?(?=%|[,;:.)]*(?:\s|$))"


def say(text: str, *, err: bool = False) -> None:
    """Print a text; a terminal has colours, and wraps lines itself, so that a command is copied in one piece."""
    stream = sys.stderr if err else sys.stdout
    if not stream.isatty():
        typer.echo(text, err=err)
        return
    from rich.console import Console
    from rich.text import Text

    console = Console(file=stream)
    for line in text.split("\n"):
        shown = Text(line)
        shown.highlight_regex(_NUMBER, "bold")
        if kind := _KIND.match(line):
            shown.stylize(_STYLES.get(kind[1], "bold red"), 0, len(line) if kind[1] == "note" else kind.end())
        console.print(shown, soft_wrap=True)
