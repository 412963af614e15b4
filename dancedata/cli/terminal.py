"""Text for the user: on a terminal wrapped to its width and in colour, everywhere else as it is."""

import os
import re
import shutil
import sys
from typing import TextIO

import typer

#: Columns by which the second line of a message is indented against its first.
_INDENT = 2
_KINDS = {"error": {"fg": "red", "bold": True}, "look": {"fg": "yellow"}, "note": {"dim": True}}
_OTHER_WORDS = {"bad": "error", "FAILED": "error"}
_KIND = re.compile(r"\s*(error|bad|FAILED|look|note)(?=:|  )")
#: Numbers by themselves, not those in names, paths, addresses and options.
_NUMBER = re.compile(r"(?<![\w./:=+-])\d+(?:,\d{3})*(?:\.\d+)?(?=%|[,;:.)]*(?:\s|$))")
#: A word; a command after a colon is one, so that it can be copied.
_WORD = re.compile(r"(?<=: )(?:dancedata|ffmpeg|mv|pip) [^;]*\S|\S+")
#: Two gaps between words: a row of a table, which is not wrapped.
_TABLE = re.compile(r"\S {2,}\S.* {2,}\S")


def say(text: str, *, err: bool = False) -> None:
    """Print a text for the user.

    On a terminal its lines are wrapped between words; kinds of messages and numbers have colours unless NO_COLOR is
    set. The text of pipes and files is unchanged.

    Parameters
    ----------
    text
        One or several lines.
    err
        Print on stderr.
    """
    stream = sys.stderr if err else sys.stdout
    typer.echo(dressed(text, stream) if stream.isatty() else text, err=err)


def dressed(text: str, stream: TextIO) -> str:
    """Return a text as a terminal shows it."""
    width = _width(stream)
    coloured = not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    lines = (_wrapped(line, width) for line in text.split("\n"))
    return "\n".join(map(_coloured, lines) if coloured else lines)


def _width(stream: TextIO) -> int:
    try:
        of_stream = os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):
        of_stream = 80
    return shutil.get_terminal_size((of_stream, 24)).columns if os.environ.get("COLUMNS") else of_stream or 80


def _wrapped(line: str, width: int) -> str:
    """Break a line between words; a longer word, such as a path, has its own line and stays whole."""
    if len(line) <= width or _TABLE.search(line):
        return line
    first, *words = _WORD.findall(line)
    lines = [line[: len(line) - len(line.lstrip())] + first]
    indent = " " * (len(line) - len(line.lstrip()) + _INDENT)
    for word in words:
        if len(lines[-1]) + 1 + len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(indent + word)
    return "\n".join(lines)


def _coloured(line: str) -> str:
    kind = _KIND.match(line)
    start = 0 if kind is None else kind.end()
    name = "" if kind is None else _OTHER_WORDS.get(kind[1], kind[1])
    if name == "note":
        return typer.style(line, dim=True)
    rest = line[start:]
    if not _TABLE.search(rest):
        rest = _NUMBER.sub(lambda number: typer.style(number[0], bold=True), rest)
    return (typer.style(line[:start], **_KINDS[name]) if name else "") + rest  # type: ignore[arg-type]
