"""Words that name a side: what a text says of a mirrored dancer."""

from __future__ import annotations

import re
from collections import defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from dancedata.core.segments import Layer, Segment

_WORDS = re.compile(r"\w+(?:-\w+)*")
#: A letter, and the mark of a border in camel case, which no text has: a noncharacter of Unicode.
_L, _CAMEL = r"[^\W\d_]", "\uffff"
_LETTERS = re.compile(f"{_L}+")
#: What a blank of a pair stands for.
_BLANKS = re.compile(rf"[\s_\-{_CAMEL}]+")
#: Letters of a word that is looked for inside of others.
_LEAST_INSIDE = 4


@dataclass(frozen=True)
class Lexicon:
    """Words of one language that are exchanged in texts about a mirrored dancer.

    Letters alone are inside a word: "turn_left", "left2" and "LeftKick" have the word "left". Blanks in a pair
    stand for any blanks, hyphens and underscores.

    `language`: BCP 47 tag; texts in a variety of it ("en-GB") are read with it.
    `pairs`: (a, b): a becomes b, and b becomes a where no earlier pair has it. In any case of letters.
    `exact`: Pairs that are compared with their case, such as ("L", "R"). Single letters also count in small where
        they are joined to another word: "l_arm", "hand.l", "lArm".
    `same`: Phrases that stay as they are: "right away".
    `whole_words`: False for scripts without spaces between words.
    `alone`: Phrases that stay, unless a side follows at once: "cross right behind left" names two.
    """

    language: str
    pairs: tuple[tuple[str, str], ...] = ()
    exact: tuple[tuple[str, str], ...] = ()
    same: tuple[str, ...] = ()
    whole_words: bool = True
    alone: tuple[str, ...] = ()

    def names_side(self, text: str) -> bool:
        """Whether a text has one of the words."""
        return any(match.lastgroup not in ("same", "alone") for match in self._pattern.finditer(_split(text)))

    def mirrored(self, text: str) -> str:
        """Return a text with the words exchanged; their capitals stay."""
        return self._pattern.sub(self._exchanged, _split(text)).replace(_CAMEL, "")

    def unread(self, text: str) -> str:
        """Return a word that has one of the words inside, such as "leftkick"; "" for none."""
        rest = self._pattern.sub(" ", _split(text)).replace(_CAMEL, "")
        words = (word for word in _LETTERS.findall(rest) if any(side in word.lower() for side in self._inside))
        return next(words, "") if self.whole_words else ""

    def _exchanged(self, match: re.Match[str]) -> str:
        word = match[0]
        if match.lastgroup in ("same", "alone"):
            return word
        if match.lastgroup == "exact":
            return self._exact[word]
        if match.lastgroup == "joined":
            return self._exact[word.upper()].lower()
        other = self._any_case[_spaced(word)]
        if word.isupper() and len(word) > 1:
            return other.upper()
        return other[:1].upper() + other[1:] if word[:1].isupper() else other

    @cached_property
    def _exact(self) -> Mapping[str, str]:
        return _both_ways(self.exact)

    @cached_property
    def _any_case(self) -> Mapping[str, str]:
        exchanged = _both_ways((a.lower(), b.lower()) for a, b in self.pairs)
        return {_spaced(word): other for word, other in exchanged.items()}

    @cached_property
    def _inside(self) -> tuple[str, ...]:
        return tuple(word for word in self._any_case if len(word) >= _LEAST_INSIDE and word.isalpha())

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        def group(name: str, words: Iterable[str], flags: str, blanks: str = _BLANKS.pattern) -> str:
            # The longest first: "counter clockwise" before "clockwise".
            ordered = (map(re.escape, word.split()) for word in sorted(words, key=lambda word: (-len(word), word)))
            return f"(?P<{name}>(?{flags}:{'|'.join(map(blanks.join, ordered)) or '(?!)'}))"

        joint = rf"[_.\-{_CAMEL}]"
        letters = "|".join(sorted({re.escape(word.lower()) for word in self._exact if len(word) == 1})) or "(?!)"
        joined = rf"(?P<joined>(?-i:(?<={_L}{_L}{joint})(?:{letters})|(?:{letters})(?={joint}{_L}{_L})))"
        # "is_left" is a side, "is left" is not.
        same = group("same", self.same, "i", r"\s+")
        sides = "|".join(re.escape(word) for word in self._any_case if word.isalpha())
        alone = rf"(?!-|\s+(?:(?:of|the|to|your|his|her|their|my)\s+)*(?i:{sides or '(?!)'})(?!{_L}))"
        alone = group("alone", self.alone, "i", r"\s+") + alone
        parts = "|".join((same, alone, group("exact", self._exact, "-i"), group("any", self._any_case, "i"), joined))
        return re.compile(rf"(?<!{_L})(?:{parts})(?!{_L})" if self.whole_words else parts)


ENGLISH = Lexicon(
    "en",
    pairs=(
        ("left", "right"), ("lefts", "rights"), ("lft", "rgt"), ("lt", "rt"),
        *((f"left{end}", f"right{end}") for end in (
            "ward", "wards", "most", "hand", "handed", "hander", "foot", "footed", "side", "sided", "y")),
        ("lefties", "righties"),
        ("clockwise", "counterclockwise"), ("anticlockwise", "clockwise"), ("anti clockwise", "clockwise"),
        ("counter clockwise", "clockwise"), ("cw", "ccw"), ("acw", "cw"),
        *((f"{a} {clock}", f"{b} {clock}") for clock in ("o'clock", "o\N{RIGHT SINGLE QUOTATION MARK}clock", "oclock")
          for a, b in (("1", "11"), ("2", "10"), ("3", "9"), ("4", "8"), ("5", "7"), ("one", "eleven"),
                       ("two", "ten"), ("three", "nine"), ("four", "eight"), ("five", "seven"))),
    ),
    exact=(("L", "R"), ("LH", "RH"), ("LF", "RF")),
    same=(
        "right away", "right now", "right on time", "right on the beat", "right on beat", "right there", "right here",
        "right at the", "right angle", "right angles", "right angled", "right-angled", "right side up",
        "right way up", "the right way", "all right", "just right", "R&B", "R & B",
        *(f"left the {place}" for place in ("stage", "floor", "frame", "room", "ground", "circle", "group", "scene")),
        "left alone", "nothing left", "anything left", "the right thing",
        *(f"{start}right{end}" for start, ends in (
            ("up", ("", "s", "ness")), ("b", ("", "er", "est", "ly", "ness", "en", "ens", "ened", "ening")),
            ("f", ("", "s", "en", "ens", "ened", "ening", "ful")), ("", ("ful", "fully", "ly", "eous", "eously")),
            ("sp", ("ly",)), ("copy", ("", "ed")), ("w", ("", "s")), ("playw", ("",)), ("birth", ("",)),
            ("al", ("",)), ("a", ("",)), ("out", ("",)), ("down", ("",)), ("forth", ("",))) for end in ends),
        "cleft", "leftover", "leftovers", "leftist",
    ),
    alone=(
        "right behind", "right in front", "right next to", "right before", "right after", "left behind",
        "is left", "are left", "has left", "have left", "had left",
    ),
)  # fmt: skip


def _split(text: str) -> str:
    """Mark the borders in "LeftKick" and "LKick"."""
    parts = []
    for before, letter, after in zip(" " + text, text, text[1:] + " ", strict=False):
        if letter.isupper() and before.isalpha() and (not before.isupper() or after.islower()):
            parts.append(_CAMEL)
        parts.append(letter)
    return "".join(parts)


def _spaced(phrase: str) -> str:
    """Return a phrase in small letters with one blank between its words."""
    return _BLANKS.sub(" ", phrase.lower())


def _both_ways(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    exchanged: dict[str, str] = {}
    for a, b in pairs:
        exchanged.setdefault(a, b)
        exchanged.setdefault(b, a)
    return exchanged


def lexicon_of(language: str, lexicons: Iterable[Lexicon] = ()) -> Lexicon | None:
    """Return the lexicon of a language, or of the one that it is a variety of, `ENGLISH` last; None without one."""
    tag = language.lower()
    return next((e for e in (*lexicons, ENGLISH) if tag == e.language or tag.startswith(f"{e.language}-")), None)


def with_mirrored_words(
    clips: Sequence[Sequence[Segment]], lexicons: Sequence[Lexicon] = ()
) -> list[tuple[Segment, ...]]:
    """Return the segments of clips with the words of mirrored dancers, and layers that tell whether they name sides.

    `Layer.sided` "unknown" becomes "no" where no word of a layer names a side, "mirrored" where all mirrored words
    are stated or a lexicon of the layer's language makes them, and "mirrored" becomes "unknown" where neither holds
    (`unread_word`). Labels that name a side get a pair in `Layer.mirror`.
    """
    by_layer: dict[Layer, list[Segment]] = defaultdict(list)
    for segment in (segment for segments in clips for segment in segments):
        by_layer[segment.layer].append(segment)
    found = {layer: lexicon_of(layer.language, lexicons) for layer in by_layer}
    layers = {layer: _sided_layer(layer, segments, found[layer]) for layer, segments in by_layer.items()}
    return [tuple(_completed(s, layers[s.layer], found[s.layer]) for s in segments) for segments in clips]


def unread_word(layer: Layer, segments: Iterable[Segment], lexicon: Lexicon) -> str:
    """Return a word of a layer of which its lexicon cannot tell whether it names a side; "" without one."""
    stated = {label for pair in layer.mirror for label in pair}
    said = (text for s in segments for text in ({s.label} - stated).union(() if s.texts_mirrored else s.texts))
    return next(filter(None, map(lexicon.unread, said)), "")


def _sided_layer(layer: Layer, segments: Sequence[Segment], lexicon: Lexicon | None) -> Layer:
    stated = {label for pair in layer.mirror for label in pair}
    labels = sorted({s.label for s in segments} - stated - {""})
    if layer.sided == "no":
        return layer
    words = [s for s in segments if s.texts]
    if lexicon is None:
        if layer.sided == "mirrored":
            return layer if all(s.texts_mirrored for s in words) else replace(layer, sided="unknown")
        if labels or not all(s.texts_mirrored for s in words):
            return layer
        return replace(layer, sided="mirrored" if words or stated else "no")
    if unread_word(layer, segments, lexicon):
        return replace(layer, sided="unknown")
    sides = [(label, lexicon.mirrored(label)) for label in labels if lexicon.names_side(label)]
    pairs = tuple(dict.fromkeys((min(a, b), max(a, b)) for a, b in sides))
    named = stated or pairs or any(s.texts_mirrored or any(map(lexicon.names_side, s.texts)) for s in words)
    if named or layer.sided == "mirrored":
        return replace(layer, sided="mirrored", mirror=(*layer.mirror, *pairs))
    return replace(layer, sided="no")


def _completed(segment: Segment, layer: Layer, lexicon: Lexicon | None) -> Segment:
    texts = segment.texts_mirrored
    if layer.sided == "mirrored" and not texts and lexicon is not None:
        texts = tuple(map(lexicon.mirrored, segment.texts))
    return replace(segment, layer=layer, texts_mirrored=texts)


def mirrored_segment(segment: Segment, joints: Mapping[int, int] | None = None) -> Segment:
    """Return a segment of a mirrored dancer: label, texts, tokens and joint exchanged, by pairs of `joints`."""
    pairs = _both_ways(segment.layer.mirror)
    texts = segment.texts_mirrored or segment.texts
    changes = list(zip(segment.texts, texts, strict=True))
    tokens = tuple(_mirrored_tokens(t, *change) for t, change in zip(segment.tokens, changes, strict=False))
    return replace(
        segment,
        label=pairs.get(segment.label, segment.label),
        texts=texts,
        texts_mirrored=segment.texts,
        tokens=tokens,
        joint=(joints or {}).get(segment.joint, segment.joint),
    )


def _mirrored_tokens(tokens: str, text: str, mirrored: str) -> str:
    if text == mirrored:
        return tokens
    before, after = _WORDS.findall(text.lower()), _WORDS.findall(mirrored.lower())
    if len(before) != len(after):
        return ""
    changes: dict[str, deque[str]] = defaultdict(deque)
    for a, b in zip(before, after, strict=True):
        changes[a].append(b)
    result = []
    for token in tokens.split(" "):
        word, slash, kind = token.rpartition("/")
        queue = changes.get(word.lower())
        result.append(f"{queue.popleft()}{slash}{kind}" if queue else token)
    return " ".join(result)
