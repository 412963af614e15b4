"""What a check finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Problem:
    """Something wrong ("error") or worth knowing ("note"), and the file or place it is about."""

    severity: Literal["error", "note"]
    where: str
    message: str

    def __str__(self) -> str:
        """Return one line of text."""
        return f"{self.severity}: {self.where}: {self.message}"

    def to_json(self) -> dict[str, str]:
        """Return it as JSON."""
        return {"severity": self.severity, "where": self.where, "message": self.message}
