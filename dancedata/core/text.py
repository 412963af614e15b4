"""Untrusted text made safe to print: truncated, and without control characters of terminals.

Every string of a file, and every file name, in a message, a note or a table goes through this module.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from numbers import Integral, Real
from typing import Any
from unicodedata import category

#: Most characters of a value in a message.
_MAX_SHOWN = 200
#: Most names of a list in a message, and characters of each: the longest file name.
_NAMES, _NAME = 6, 255
#: Most entries of a list value in a message, and characters of each.
_ENTRIES, _ENTRY = 8, 40
#: Larger integers are shown by their size: writing them out takes quadratic time.
_MAX_BITS = 128


def printable(text: str, *, lines: bool = False) -> str:
    """Replace control and format characters and lone surrogates by backslash sequences; `lines`: keep line breaks."""
    if text.isprintable():
        return text
    return "".join(c if _prints(c) or (lines and c == "\n") else c.encode("unicode_escape").decode() for c in text)


def _prints(character: str) -> bool:
    # isprintable() is false for all spaces except one, also those of other scripts.
    return character.isprintable() or category(character) == "Zs"


def is_unicode(text: str) -> bool:
    """Return whether a text can be written as UTF-8; one from a file name in another encoding cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def shown(value: object, limit: int = _MAX_SHOWN) -> str:
    """Return a short, printable text for any value, in constant time: containers of a hostile file may be huge.

    Lists show their first numbers and texts, other containers their type and length, errors their type and message.
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


def quoted(value: object, limit: int = _MAX_SHOWN) -> str:
    """Return `shown`, with quotation marks around text."""
    return f"'{shown(value, limit)}'" if isinstance(value, str) else shown(value, limit)


def _scalar(value: object, limit: int) -> str:
    if value is None or isinstance(value, bool):
        return str(value)
    if isinstance(value, Integral):
        bits = int(value).bit_length()
        return str(int(value)) if bits <= _MAX_BITS else f"an integer of {bits:,} bits"
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
    """Return the first entries of a list, as Python writes them; nested lists by their type and length."""
    inner = [
        f"{type(v).__name__} of {len(v):,}" if isinstance(v, list | tuple) else quoted(v, _ENTRY)
        for v in value[:_ENTRIES]
    ]
    more = f", ... {len(value) - _ENTRIES:,} more" if len(value) > _ENTRIES else ""
    if isinstance(value, list):
        return f"[{', '.join(inner)}{more}]"
    return f"({', '.join(inner)}{',' if len(inner) == 1 else ''}{more})"


def _message(error: BaseException) -> str:
    """Return the message of an error; with arguments from a file, as in a KeyError, only a text among them."""
    if all(_is_plain(argument) for argument in error.args):
        return str(error)
    return next((argument for argument in error.args if isinstance(argument, str)), "")


def _is_plain(value: object) -> bool:
    if isinstance(value, int):
        return value.bit_length() <= _MAX_BITS
    return value is None or isinstance(value, str | bytes | float)


def listed(names: Iterable[object], most: int = _NAMES, show: Callable[[object, int], str] = shown) -> str:
    """Join the first names of a list, and count further ones: "a, b, c and 12 more"; "" for none."""
    names = list(names)
    text = ", ".join(show(name, _NAME) for name in names[:most])
    return text if len(names) <= most else f"{text} and {len(names) - most:,} more"


def counted(n: int, noun: str) -> str:
    """Return a number with its noun: "1 clip", "1,408 clips"."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


def size_text(n_bytes: float) -> str:
    """Return a size in bytes as text with a decimal unit."""
    for unit in ("B", "kB", "MB"):
        if n_bytes < 1000:
            return f"{n_bytes:.3g} {unit}"
        n_bytes /= 1000
    return f"{n_bytes:.4g} GB"
