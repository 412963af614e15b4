"""Words of others against computed facts: "says jump, no flight found"."""

import json
import re
from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple

from dancedata.core.segments import Segment
from dancedata.core.sided_words import lexicon_of
from dancedata.core.text import counted, quoted
from dancedata.store import Problem, Store

#: Facts that begin or end this long outside of a text still belong to it.
_MARGIN_S = Fraction(1, 2)
#: Most notes that name a text.
_MAX_NOTES = 20


class _Claim(NamedTuple):
    """What English words say: the kind of facts that would show it, its labels, and the message without them."""

    words: str
    kind: str
    labels: tuple[str, ...]
    missing: str


_TURNS = ("turn left", "turn right")
_CLAIMS = (
    _Claim(r"jump(?:s|ed|ing)?|leap(?:s|ed|ing)?|hop(?:s|ped|ping)?", "jumps", ("jump",), "no flight found"),
    _Claim(r"spin(?:s|ning)?|pirouettes?|twirl(?:s|ed|ing)?|turns? around", "turns", _TURNS, "no turn found"),
    _Claim(r"(?:lies|lying|sits?|sitting|kneel(?:s|ing)?|crawl(?:s|ing)?)(?: \w+)?", "floor_work", ("floor work",),
           "no floor work found"),
    _Claim(r"(?:turn|spin)(?:s|ning|ing)?(?: \w+)? (?:to the |to (?:his|her|their) )?left", "turns", ("turn left",),
           "no turn to the left found"),
    _Claim(r"(?:turn|spin)(?:s|ning|ing)?(?: \w+)? (?:to the |to (?:his|her|their) )?right", "turns", ("turn right",),
           "no turn to the right found"),
)  # fmt: skip


def word_notes(store: Store) -> list[Problem]:
    """Return notes on English texts that say what the facts of their clip, where it has some, do not show."""
    kinds = _kinds(store)
    if not kinds:
        return []
    findings = list(_findings(store, kinds))
    notes = [Problem("note", clip, message) for clip, message in findings[:_MAX_NOTES]]
    if len(findings) > _MAX_NOTES:
        message = f"{counted(len(findings) - _MAX_NOTES, 'more text')} that facts do not show"
        notes.append(Problem("note", str(store.path), message))
    return notes


def _kinds(store: Store) -> set[str]:
    """Return the kinds of facts that a dataset has, by what made its layer."""
    made_by = [layer.by for layer in store.layers if layer.name == "facts" and layer.by.startswith("facts ")]
    kinds: set[str] = set()
    for by in made_by:
        try:
            kinds |= set(json.loads(by.split(" ", 2)[2]).get("kinds", ()))
        except (ValueError, IndexError, AttributeError, TypeError):
            continue
    return kinds


def _findings(store: Store, kinds: set[str]) -> Iterator[tuple[str, str]]:
    for clip in store:
        if clip.source:
            continue  # the words of a copy are those of its clip
        segments = store.segments(clip.id)
        facts = [segment for segment in segments if segment.layer.name == "facts"]
        for segment in segments:
            if segment.layer.name == "facts" or lexicon_of(segment.layer.language) is None:
                continue
            for text in segment.texts:
                claims = [c for c in _CLAIMS if c.kind in kinds and _contradicted(c, text, segment, facts)]
                if claims:
                    span = f"{float(segment.start):.1f} to {float(segment.end):.1f} s"
                    says = f"says {quoted(text, 80)}, {claims[0].missing}"
                    yield clip.id, f"layer {segment.layer.name}, {span}: {says}"


def _contradicted(claim: _Claim, text: str, segment: Segment, facts: list[Segment]) -> bool:
    if not re.search(rf"\b(?:{claim.words})\b", text, re.IGNORECASE):
        return False
    near = [f for f in facts if f.start < segment.end + _MARGIN_S and f.end > segment.start - _MARGIN_S]
    if len(claim.labels) == 1 and claim.kind == "turns":
        # A side: contradicted only by a turn to the other one.
        return any(f.label in _TURNS for f in near) and not any(f.label in claim.labels for f in near)
    return not any(f.label in claim.labels for f in near)
