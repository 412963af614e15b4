"""What the stages of `pipeline` read of annotators."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from dancedata.core.hashing import canonical_json
from dancedata.core.segments import Layer
from dancedata.core.sided_words import ENGLISH, Lexicon
from dancedata.metrics.events import KINDS, MIRROR, UNITS

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
