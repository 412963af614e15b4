"""The key `segments` of a recipe: layers that a build computes, and the lexicon of mirrored words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.hashing import canonical_json
from dancedata.core.segments import Layer
from dancedata.core.sided_words import ENGLISH, Lexicon
from dancedata.core.text import shown
from dancedata.metrics.events import KINDS, MIRROR, UNITS
from dancedata.recipes.yaml import read_yaml

#: Version of the computed events: a change of any number takes another.
VERSION = 1
GENRE = Layer("genre", by="genre", sided="no")
_KEYS = ("facts", "genre", "lexicon")


@dataclass(frozen=True)
class FactsSpec:
    """Computed events.

    `kinds`: Some of turns, jumps, travel, energy, floor_work, contacts.
    `turn_degrees`, `flight_s`, `travel_m`: Least turn, time in the air, and distance.
    """

    kinds: tuple[str, ...] = KINDS
    turn_degrees: float = 150.0
    flight_s: float = 0.15
    travel_m: float = 1.0

    def document(self) -> dict[str, Any]:
        """Return the parameters as JSON data."""
        return {**asdict(self), "kinds": list(self.kinds)}

    @property
    def layer(self) -> Layer:
        """The layer of the events."""
        by = f"facts {VERSION} {canonical_json(self.document())}"
        units = tuple(sorted(UNITS.items()))
        return Layer("facts", language="en", by=by, units=units, mirror=MIRROR, sided="mirrored")


@dataclass(frozen=True)
class SegmentSpec:
    """What a recipe asks for; see `parse_segments`."""

    facts: FactsSpec | None = None
    genre: bool = False
    lexicon: Lexicon | None = None

    @property
    def lexicons(self) -> tuple[Lexicon, ...]:
        """The recipe's lexicon, and those of the package."""
        return (ENGLISH,) if self.lexicon is None else (self.lexicon, ENGLISH)

    def document(self) -> dict[str, Any]:
        """Return JSON data; with the words of the lexicon, not its path."""
        return {
            "facts": None if self.facts is None else self.facts.document(),
            "genre": self.genre,
            "lexicon": None if self.lexicon is None else asdict(self.lexicon),
        }


def parse_segments(value: Any) -> SegmentSpec:
    """Check the value of the key `segments`; UsageError for a wrong one."""
    if value is None:
        return SegmentSpec()
    if not isinstance(value, Mapping):
        raise UsageError("segments: not a mapping of keys", found=shown(repr(value)), allowed="such as {facts: true}")
    for key in value:
        if key not in _KEYS:
            raise UsageError(f"segments.{shown(str(key))}: unknown key", fix=did_you_mean(str(key), _KEYS))
    genre = value.get("genre", False)
    if not isinstance(genre, bool):
        raise UsageError("segments.genre: must be true or false", found=shown(repr(genre)))
    lexicon = value.get("lexicon")
    return SegmentSpec(_facts(value.get("facts", False)), genre, None if lexicon is None else _lexicon(lexicon))


def _facts(value: Any) -> FactsSpec | None:
    if value is True or value is False or value is None:
        return FactsSpec() if value else None
    if not isinstance(value, Mapping):
        raise UsageError("segments.facts: must be true or a mapping of keys", found=shown(repr(value)))
    keys = [f.name for f in fields(FactsSpec)]
    for key, number in value.items():
        if key not in keys:
            raise UsageError(f"segments.facts.{shown(str(key))}: unknown key", fix=did_you_mean(str(key), keys))
        is_number = isinstance(number, int | float) and not isinstance(number, bool)
        if key != "kinds" and not (is_number and 0 < number < 1e6):
            raise UsageError(f"segments.facts.{key}: must be a number above 0", found=shown(repr(number)))
    kinds = value.get("kinds", list(KINDS))
    kinds = [kinds] if isinstance(kinds, str) else kinds
    unknown = kinds if not isinstance(kinds, Sequence) else [kind for kind in kinds if kind not in KINDS]
    if unknown or not kinds:
        raise UsageError("segments.facts.kinds: unknown kind", found=shown(repr(kinds)), allowed=", ".join(KINDS))
    numbers = {key: float(number) for key, number in value.items() if key != "kinds"}
    return FactsSpec(tuple(kind for kind in KINDS if kind in kinds), **numbers)


def _lexicon(value: Any) -> Lexicon:
    """Return the lexicon of a file, or of a mapping."""
    where: str | None = None
    if isinstance(value, str):
        where = value
        try:
            value = read_yaml(Path(value).expanduser())
        except (OSError, ValueError, UnicodeDecodeError) as error:
            raise UsageError("segments.lexicon: the file cannot be read", where=where, found=shown(error)) from error
    allowed = "{language: de, pairs: [[links, rechts]], exact: [...], same: [...], alone: [...], "
    allowed += "whole_words: true}"
    keys = {f.name for f in fields(Lexicon)}
    try:
        language, whole = value["language"], value.get("whole_words", True)
        pairs, exact = (tuple((a, b) for a, b in value.get(name) or ()) for name in ("pairs", "exact"))
        same, alone = (tuple(value.get(name) or ()) for name in ("same", "alone"))
        words = [language, *same, *alone, *(word for pair in (*pairs, *exact) for word in pair)]
        valid = set(value) <= keys and all(isinstance(word, str) and word for word in words) and (pairs or exact)
        if not valid or not isinstance(whole, bool):
            raise ValueError("not texts")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        problem = "segments.lexicon: not a lexicon"
        raise UsageError(problem, where=where, found=shown(value), allowed=allowed) from error
    return Lexicon(language.lower(), pairs, exact, same, whole, alone)
