"""Names of files that may be of one recording, though they are written differently."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass

#: Least similarity of the letters of two names with equal numbers: mBR0 and mBR5 are different songs.
_ALIKE = 0.8
#: A shorter name within another one is not evidence.
_MIN_PART = 3
_PARTS = re.compile(r"[^\W\d_]+|[0-9]+")


@dataclass(frozen=True)
class Name:
    """A file name, split into letters and numbers; "001" is "1"."""

    text: str
    parts: tuple[str, ...]
    numbers: tuple[str, ...]
    letters: str
    #: All parts in a row, to search one name in another.
    row: str

    @classmethod
    def of(cls, text: str) -> Name:
        """Split a name."""
        words = _PARTS.findall(text.lower())
        parts = tuple(part.lstrip("0") or "0" if part.isdigit() else part for part in words)
        numbers = tuple(part for part in parts if part.isdigit())
        letters = "".join(part for part in parts if not part.isdigit())
        return cls(text, parts, numbers, letters, f" {' '.join(parts)} ")

    def near(self, other: Name) -> bool:
        """Return whether the other name may be this one, written differently or misspelt."""
        if self.parts == other.parts:
            return bool(self.parts)
        if self._has(other) or other._has(self):
            return True
        return self.numbers == other.numbers and self.likeness(other) >= _ALIKE

    def _has(self, part: Name) -> bool:
        # "mBR0 (1)" and "mBR0_48k" contain "mBR0".
        return len(part.text) >= _MIN_PART and part.row in self.row

    def likeness(self, other: Name) -> float:
        """Return the similarity of the letters, 0 to 1."""
        if not self.letters or not other.letters:
            return 0.0
        return difflib.SequenceMatcher(None, self.letters, other.letters, autojunk=False).ratio()
