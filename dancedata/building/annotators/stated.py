"""Segments that the source states, and the genre: nothing of them is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

from dancedata.building.plugins import ANNOTATORS, Annotator, Ask
from dancedata.building.take import Scene, Take
from dancedata.core.segments import CLIP_END, Segment
from dancedata.recipes.segments import GENRE


@ANNOTATORS.register("stated")
@dataclass(frozen=True)
class Stated(Annotator):
    """Takes over words, moves and sections of the source.

    Attributes
    ----------
    genre
        Whether the genre of a clip becomes a segment.
    """

    version: ClassVar[int] = 1

    genre: bool = False

    def asks(self, take: Take) -> Sequence[Ask]:
        """Return nothing: no motion is needed."""
        return []

    def annotate(self, scene: Scene) -> list[list[Any]]:
        """Return nothing of each dancer."""
        return [[] for _ in scene.motions]

    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        """Return the segments of the clip, and its genre."""
        ref = take.dancers[dancer].ref
        genre = [Segment(GENRE, Fraction(0), CLIP_END, ref.genre)] if self.genre and ref.genre else []
        return [*take.recording.reader.dataset.segments(ref), *genre]
