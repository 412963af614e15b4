"""What a check of the installation found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from dancedata.core.text import shown

#: Most characters of an error or a list in a line.
_SHOWN = 600


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes
    ----------
    name
        What was checked: "cache".
    status
        "ok"; "note" for what limits the installation without breaking it; "failed".
    text
        What was found.
    fix
        What to do about it; "" where nothing has to be done.
    """

    name: str
    status: Literal["ok", "note", "failed"]
    text: str
    fix: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {"check": self.name, "status": self.status, "found": self.text, "fix": self.fix}

    def __str__(self) -> str:
        """Return one line."""
        status = "FAILED" if self.status == "failed" else self.status
        return f"{status:<6}  {self.name}: {self.text}{'; ' * bool(self.fix)}{self.fix}"


def ok(name: str, text: str) -> Finding:
    """Return the finding of a check that passed."""
    return Finding(name, "ok", text)


def note(name: str, text: str, fix: str = "") -> Finding:
    """Return a finding that limits the installation without breaking it."""
    return Finding(name, "note", text, fix)


def failed(name: str, text: object, fix: str) -> Finding:
    """Return the finding of a check that failed."""
    return Finding(name, "failed", shown(str(text), _SHOWN), fix)
