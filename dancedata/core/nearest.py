"""The known name that is closest to an unknown one, for messages."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

#: Names that are less alike than this are not suggested; 1 is equal.
CUTOFF = 0.6
#: Of names, one is a run of whole parts of the other ("edge" of "aist++-edge-exact"); or it begins with it.
_PART, _PREFIX = 0.9, 0.8
#: Parts that are shorter are too frequent to count.
_MIN_PART = 3
#: Characters of a name that are compared.
_LONGEST = 100
# Letters and digits are parts of their own: "edge" of "edge151".
_PARTS = re.compile(r"[^\W\d_]+|\d+")


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the most similar of the known names, or None if there is none that is similar.

    Case, and signs between the parts of a name, do not count; a part stands for the whole name.
    """
    wanted = _Wanted(name[:_LONGEST])
    best, most = None, CUTOFF
    for candidate in known:
        alike = wanted.likeness(candidate[:_LONGEST], most)
        if alike > most:
            best, most = candidate, alike
    return best


class _Wanted:
    """The unknown name."""

    def __init__(self, name: str) -> None:
        self.parts = _parts(name)
        self.plain = "".join(self.parts)
        self.joined = f"-{'-'.join(self.parts)}-"
        # What is compared with many is its second sequence: its table is made once.
        self.matcher = difflib.SequenceMatcher(None, "", self.plain, autojunk=False)

    def likeness(self, known: str, most: float) -> float:
        """Return how similar a known name is, 1 at most; below `most`, anything that is below."""
        parts = _parts(known)
        plain = "".join(parts)
        if not self.plain or not plain:
            return 0.0
        if self.plain == plain:
            return 1.0
        # Of names that have the part, the shorter one is meant.
        share = 0.1 * len(self.plain) / max(len(self.plain), len(plain))
        if len(self.plain) >= _MIN_PART:
            if self.joined in f"-{'-'.join(parts)}-":
                return _PART + share
            if plain.startswith(self.plain):
                return _PREFIX + share
        of_parts = (_PREFIX * self._ratio(part, most / _PREFIX) for part in parts if len(part) >= _MIN_PART)
        return max(self._ratio(plain, most), *of_parts, 0.0)

    def _ratio(self, text: str, most: float) -> float:
        self.matcher.set_seq1(text)
        # Upper bounds, which are quick.
        if self.matcher.real_quick_ratio() <= most or self.matcher.quick_ratio() <= most:
            return 0.0
        return self.matcher.ratio()


def _parts(name: str) -> list[str]:
    # "aistpp" is how people type "aist++".
    return _PARTS.findall(name.lower().replace("+", "p"))
