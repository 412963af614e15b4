"""Finds the known name closest to an unknown one, for messages."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

#: Least similarity of a suggestion; 1 is equal.
CUTOFF = 0.6
#: Similarities of names where one is a run of whole parts of the other ("edge" of "aist++-edge-exact"), or a prefix.
_PART, _PREFIX = 0.9, 0.8
#: Shorter parts are too frequent to count.
_MIN_PART = 3
#: Most characters of a name that are compared.
_LONGEST = 100
# Letters and digits are parts of their own: "edge" of "edge151".
_PARTS = re.compile(r"[^\W\d_]+|\d+")


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the most similar of the known names, or None if none is similar.

    Case and separators of parts are ignored; a single part matches the whole name.
    """
    query = _Query(name[:_LONGEST])
    best, most = None, CUTOFF
    for candidate in known:
        alike = query.likeness(candidate[:_LONGEST], most)
        if alike > most:
            best, most = candidate, alike
    return best


class _Query:
    """The unknown name."""

    def __init__(self, name: str) -> None:
        self.parts = _parts(name)
        self.plain = "".join(self.parts)
        self.joined = f"-{'-'.join(self.parts)}-"
        # SequenceMatcher caches its second sequence, the one that is compared with many.
        self.matcher = difflib.SequenceMatcher(None, "", self.plain, autojunk=False)

    def likeness(self, known: str, most: float) -> float:
        """Return the similarity to a known name, at most 1; if it is below `most`, any lower bound."""
        parts = _parts(known)
        plain = "".join(parts)
        if not self.plain or not plain:
            return 0.0
        if self.plain == plain:
            return 1.0
        # Of several names with the part, the shortest is preferred.
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
        # Upper bounds first, which are fast.
        if self.matcher.real_quick_ratio() <= most or self.matcher.quick_ratio() <= most:
            return 0.0
        return self.matcher.ratio()


def _parts(name: str) -> list[str]:
    # "aistpp" is a common spelling of "aist++".
    return _PARTS.findall(name.lower().replace("+", "p"))
