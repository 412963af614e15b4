"""One FineDance label -> the genre of its clip, or a problem."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dancedata.core.text import listed, quoted
from dancedata.datasets.finedance.facts import facts
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import parse_json

__all__ = ["Label", "read_label"]

KEY = "style2"
#: Labels have about a hundred bytes; larger files are not read.
MAX_BYTES = 1 << 20
#: Characters of a genre in messages.
SHOWN = 40


@dataclass(frozen=True)
class Label:
    """The content of a label.

    Attributes
    ----------
    genre
        Canonical name of the genre, "" if the label has none.
    reason, problem
        The problem, as a code ("missing_label", "broken_label", "unknown_genre") and in words.
    """

    genre: str = ""
    reason: str = ""
    problem: str = ""


def read_label(path: Path | None, clip: str) -> Label:
    """Read ``label_json/NNN.json``: ``style2`` is the genre; ``style1`` (coarse) and the song's name are not used.

    Parameters
    ----------
    path
        The file; None if it does not exist.
    clip
        Id, for messages.
    """
    name = f"label_json/{clip}.json"
    if path is None:
        return Label(reason="missing_label", problem=f"there is no {name}")
    try:
        content = parse_json(read_regular(path, MAX_BYTES).decode("utf-8-sig"))
    except (OSError, ValueError) as error:
        return _broken(name, str(error))
    if not isinstance(content, dict):
        return _broken(name, f"a {type(content).__name__}, not an object with {KEY}")
    style = content.get(KEY)
    if style is None or style == "":
        found = listed(content, show=quoted) or "none"
        return Label(reason="missing_label", problem=f"{name} has no {KEY}; keys found: {found}")
    genre = facts().genre(style) if isinstance(style, str) else ""
    if genre:
        return Label(genre)
    allowed = ", ".join(facts().genre_ids)
    return Label(reason="unknown_genre", problem=f"{name}: {KEY} is {quoted(style, SHOWN)}, not one of {allowed}")


def _broken(name: str, problem: str) -> Label:
    return Label(reason="broken_label", problem=f"{name} cannot be read: {problem}")
