"""Metric: the base class of measures of dances."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from math import inf
from typing import TYPE_CHECKING, ClassVar, Literal

from dancedata.core.plugins.plugin import Plugin
from dancedata.core.rotations import Float64Array

if TYPE_CHECKING:
    from dancedata.core.dance import Dance

#: Better direction of a score: higher, lower, or closer to the ground truth's.
Better = Literal["higher", "lower", "closer"]


class Metric(Plugin):
    """Measures dances: numbers of each clip, and the scores of a set of clips from these.

    Attributes
    ----------
    source
        Where the definition is from: paper and equation, or repository and file.
    needs_music
        Whether `measure` needs the beats of the music.
    needs_instants
        Whether `measure` reads the instants of beats, `MusicBeats.seconds`, not their frames alone; cache keys then
        hold them.
    of_groups
        Whether `measure` takes a group, whose joints are (P, T, J, 3).
    needs_pool
        Whether `summarise` compares the set with a pool of other clips, such as all ground truth.
    better
        What is better for each score: "higher", "lower", or "closer" to the ground truth's. Scores that are not named
        accompany the others, such as a chance level.
    bounds
        Lowest and highest value that scores can have, for their intervals: none, a lowest (0, inf), or both (0, 1).
    """

    source: ClassVar[str]
    needs_music: ClassVar[bool] = False
    needs_pool: ClassVar[bool] = False
    of_groups: ClassVar[bool] = False
    better: ClassVar[Mapping[str, Better]] = {}
    bounds: ClassVar[tuple[float, float]] = (-inf, inf)

    @property
    def needs_instants(self) -> bool:
        """By default, all its inputs are in the key."""
        return self.needs_music

    @property
    @abstractmethod
    def columns(self) -> tuple[str, ...]:
        """Names of the C numbers of a clip."""

    @abstractmethod
    def measure(self, dance: Dance) -> Float64Array:
        """Return the numbers of one clip, (C,), finite.

        Undefined if the metric has no value for this clip, which is set aside and counted by its name; DataError if
        the joints cannot be measured, for example because there are too few.
        """

    def summarise(self, rows: Float64Array, pool: Float64Array | None = None) -> dict[str, float]:
        """Return the scores of a set: by default the mean of each column; Undefined if there are too few clips.

        `rows` are numbers (N, C) of the clips that have a value, `pool` those (M, C) of the pool, where `needs_pool`.
        """
        if not len(rows):
            from dancedata.core.dance import Undefined

            raise Undefined("few_clips", found="0 clips", allowed="at least 1")
        return dict(zip(self.columns, rows.mean(axis=0).tolist(), strict=True))
