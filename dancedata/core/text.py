"""Text that comes from files, made fit to be shown: cut, and without characters that a terminal obeys.

Every string of a file, and every file name, that becomes part of a message, a note or a table goes through here.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from numbers import Integral, Real
from typing import Any
from unicodedata import category

__all__ = ["MAX_SHOWN", "counted", "is_unicode", "json_text", "listed", "printable", "quoted", "shown", "table"]

#: Characters of a value that a message shows.
MAX_SHOWN = 200
#: Names of a list that a message shows, and characters of each: as many as a file name has.
_NAMES, _NAME = 6, 255
#: Entries of a value that is a list, and characters of each.
_ENTRIES, _ENTRY = 8, 40
#: Larger whole numbers are shown by their size: writing them out takes time that grows with its square.
_MAX_BITS = 128


def printable(text: str, *, lines: bool = False) -> str:
    r"""Write characters that do not print as backslash sequences: control and format characters, lone surrogates.

    What comes out can be printed on any terminal and written as UTF-8. A byte of a file name that is not UTF-8,
    which Python holds as a lone surrogate, becomes ``\udcff``.

    Parameters
    ----------
    text
        Any text.
    lines
        Whether line breaks stay as they are.
    """
    if text.isprintable():
        return text
    return "".join(c if _prints(c) or (lines and c == "\n") else _escaped(c) for c in text)


def _prints(character: str) -> bool:
    # isprintable() takes all blanks but one for unprintable, also those of other scripts.
    return character.isprintable() or category(character) == "Zs"


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def is_unicode(text: str) -> bool:
    """Tell whether a text can be written as UTF-8; one that Python made of a file name in another encoding cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def shown(value: object, limit: int = MAX_SHOWN) -> str:
    """Return a short, printable text of any value, in a time that does not depend on what the value holds.

    Containers are not unfolded: what a file describes in a thousand bytes may be larger than any memory. Of lists
    the first numbers and texts are shown, of other containers their type and length, of errors type and message.

    Parameters
    ----------
    value
        Anything, from anywhere.
    limit
        Most characters that are shown; "..." follows where there are more.
    """
    if isinstance(value, str):
        text = value
    elif isinstance(value, BaseException):
        text = f"{type(value).__name__}: {_message(value)}"
    elif isinstance(value, list | tuple):
        text = _list(value)
    else:
        text = _scalar(value, limit)
    text = printable(text[: limit + 1])
    return text if len(text) <= limit else f"{text[:limit]}..."


def quoted(value: object, limit: int = MAX_SHOWN) -> str:
    """Return `shown`, text between quotation marks."""
    return f"'{shown(value, limit)}'" if isinstance(value, str) else shown(value, limit)


def _scalar(value: object, limit: int) -> str:
    if value is None or isinstance(value, bool):
        return str(value)
    if isinstance(value, Integral):
        bits = int(value).bit_length()
        return str(int(value)) if bits <= _MAX_BITS else f"a whole number of {bits:,} bits"
    if isinstance(value, Fraction):
        return f"{_scalar(value.numerator, limit)}/{_scalar(value.denominator, limit)}".removesuffix("/1")
    if isinstance(value, Real):
        return repr(float(value))
    if isinstance(value, bytes | bytearray):
        return repr(bytes(value[:limit]))
    if isinstance(value, os.PathLike):
        return str(value)
    if isinstance(value, type):
        return value.__name__
    if isinstance(value, Mapping | set | frozenset):
        return f"{type(value).__name__} of {len(value):,}"
    return type(value).__name__


def _list(value: list[Any] | tuple[Any, ...]) -> str:
    """First entries of a list, as Python writes them; lists within it by their type and length."""
    inner = [
        f"{type(v).__name__} of {len(v):,}" if isinstance(v, list | tuple) else quoted(v, _ENTRY)
        for v in value[:_ENTRIES]
    ]
    more = f", ... {len(value) - _ENTRIES:,} more" if len(value) > _ENTRIES else ""
    if isinstance(value, list):
        return f"[{', '.join(inner)}{more}]"
    return f"({', '.join(inner)}{',' if len(inner) == 1 else ''}{more})"


def _message(error: BaseException) -> str:
    """Message of an error; of one that carries something from a file, such as a KeyError, only its texts."""
    if all(_is_plain(argument) for argument in error.args):
        return str(error)
    return next((argument for argument in error.args if isinstance(argument, str)), "")


def _is_plain(value: object) -> bool:
    if isinstance(value, int):
        return value.bit_length() <= _MAX_BITS
    return value is None or isinstance(value, str | bytes | float)


def listed(names: Iterable[object], most: int = _NAMES, show: Callable[[object, int], str] = shown) -> str:
    """Join the first names of a list, made printable by `show`, and say how many more there are.

    "a, b, c and 12 more"; "" for an empty list.
    """
    names = list(names)
    text = ", ".join(show(name, _NAME) for name in names[:most])
    return text if len(names) <= most else f"{text} and {len(names) - most:,} more"


#: Characters that JSON leaves as they are and that a terminal may obey, or no file takes.
_UNPRINTABLE = re.compile(r"[\x7f-\xff\u0100-\U0010ffff]")


def json_text(obj: Any) -> str:
    """Return JSON for people and programs: indented, readable letters, all other characters as JSON's sequences."""
    text = json.dumps(obj, indent=1, ensure_ascii=False)
    if text.isascii() and "\x7f" not in text:
        return text
    return _UNPRINTABLE.sub(lambda found: found[0] if _prints(found[0]) else json.dumps(found[0])[1:-1], text)


def counted(n: int, noun: str) -> str:
    """Return a number of things in words: "1 clip", "1,408 clips"."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> list[str]:
    """Return the lines of a table, indented by two spaces: the first column to the left, the others to the right."""
    cells = [[shown(cell) for cell in row] for row in [head, *rows]]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    return [
        "  "
        + "  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        for row in cells
    ]
