"""Problem: a finding of a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dancedata.core.text import shown

#: Most characters of a path and of a message.
_MAX_WHERE, _MAX_MESSAGE = 4400, 3000


@dataclass(frozen=True)
class Problem:
    """An error or a note, and the file or place it is about.

    Its texts come from foreign files: they are cut, and characters that do not print become backslash sequences.
    """

    severity: Literal["error", "note"]
    where: str
    message: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "where", shown(self.where, _MAX_WHERE))
        object.__setattr__(self, "message", shown(self.message, _MAX_MESSAGE))

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.message}"

    def to_json(self) -> dict[str, str]:
        """Return it as JSON."""
        return {"severity": self.severity, "where": self.where, "message": self.message}
