"""What a check finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dancedata.core.text import shown

#: Characters that are kept of a path and of a message.
_MAX_WHERE, _MAX_MESSAGE = 4400, 3000


@dataclass(frozen=True)
class Problem:
    """Something wrong ("error") or worth knowing ("note"), and the file or place it is about.

    Its texts come from files of others: they are cut, and what does not print is written as backslash sequences.
    """

    severity: Literal["error", "note"]
    where: str
    message: str

    def __post_init__(self) -> None:
        """Make the texts fit to be printed."""
        object.__setattr__(self, "where", shown(self.where, _MAX_WHERE))
        object.__setattr__(self, "message", shown(self.message, _MAX_MESSAGE))

    def __str__(self) -> str:
        """Return one line of text."""
        return f"{self.severity}: {self.where}: {self.message}"

    def to_json(self) -> dict[str, str]:
        """Return it as JSON."""
        return {"severity": self.severity, "where": self.where, "message": self.message}
