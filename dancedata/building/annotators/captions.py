"""Segments that the source states: words, moves, sections, and the genre. Nothing of them is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import yaml

from dancedata.building.plugins import Annotator, Ask
from dancedata.building.take import Scene, Take
from dancedata.core.errors import UsageError
from dancedata.core.registry import ANNOTATORS
from dancedata.core.segments import CLIP_END, Layer, Segment
from dancedata.core.text import shown
from dancedata.core.typing import override
from dancedata.files.yaml import read_yaml

if TYPE_CHECKING:
    from dancedata.core.sided_words import Lexicon

_GENRE = Layer("genre", by="genre", sided="no")
_ALLOWED = "{language: de, pairs: [[links, rechts]], exact: [...], same: [...], alone: [...], whole_words: true}"


class Stated(Annotator):
    """An annotator that computes nothing: its segments follow from what the source says of a clip."""

    @override
    def asks(self, take: Take) -> Sequence[Ask]:
        return []

    @override
    def annotate(self, scene: Scene) -> list[list[Any]]:
        return [[] for _ in scene.motions]


@ANNOTATORS.register("captions")
@dataclass(frozen=True)
class Captions(Stated):
    """Takes over the segments of the source: words, moves and sections. Every build has it.

    Attributes
    ----------
    lexicon
        Words of another language that change with the sides of the body: a YAML file, or its content.
    """

    version: ClassVar[int] = 1

    lexicon: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "lexicon", None if self.lexicon is None else _lexicon(self.lexicon))

    @property
    def lexicons(self) -> tuple[Lexicon, ...]:  # type: ignore[override]
        """The one that the recipe states; words that it lacks are looked up in English."""
        return () if self.lexicon is None else (self.lexicon,)

    @override
    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        return list(take.recording.reader.dataset.segments(take.dancers[dancer].ref))


@ANNOTATORS.register("genre")
@dataclass(frozen=True)
class Genre(Stated):
    """Adds the genre of each clip as a span: the layer `genre`."""

    version: ClassVar[int] = 1

    @override
    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        genre = take.dancers[dancer].ref.genre
        return [Segment(_GENRE, Fraction(0), CLIP_END, genre)] if genre else []


def _lexicon(value: Any) -> Lexicon:
    """Return the lexicon of a file, or of a mapping."""
    from dancedata.core.sided_words import Lexicon  # few recipes name one
    from dancedata.recipes.plugins import make_dataclass

    if isinstance(value, Lexicon):
        return value
    where = ""
    if isinstance(value, str | Path):
        where = f"{shown(str(value))}: "
        try:
            value = read_yaml(Path(value).expanduser())
        except (OSError, ValueError, yaml.YAMLError) as error:
            raise UsageError("lexicon: the file cannot be read", found=f"{where}{shown(error)}") from error
    problems: list[str] = []
    if isinstance(value, dict):  # a file may have the key of a list without one
        value = {k: v for k, v in value.items() if v is not None or k in ("language", "whole_words")}
    lexicon = make_dataclass(Lexicon, "lexicon", value, problems)
    if lexicon is not None and isinstance(value.get("whole_words", True), bool):
        words = [lexicon.language, *lexicon.same, *lexicon.alone, *chain(*lexicon.pairs, *lexicon.exact)]
        if all(words) and (lexicon.pairs or lexicon.exact):
            return replace(lexicon, language=lexicon.language.lower())
    found = f"{where}{'; '.join(problems) or shown(value)}"
    raise UsageError("lexicon: not a lexicon", found=found, allowed=_ALLOWED)
