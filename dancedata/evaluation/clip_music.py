"""Beats of the music of a clip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Group
from dancedata.core.dance import MusicBeats
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import beat_rows_late
from dancedata.recipes.fields import FeatureJob
from dancedata.store.schema import Field

#: Group of the beats in an audio feature.
BEAT = "beat"
_BEAT_ALONE = Columns((Group(BEAT, 1, "0/1"),), None)


@dataclass(frozen=True, eq=False)
class ClipMusic:
    """Beats of a clip's music.

    Attributes
    ----------
    beats
        Frames from the first frame of the clip.
    end_s
        Length of the music that they are from, seconds; None if unknown.
    by_piece
        For music that is analysed piece by piece: the beats of the piece that begins at a frame.
    """

    beats: MusicBeats
    end_s: float | None = None
    by_piece: Mapping[int, MusicBeats] | None = None

    @classmethod
    def of_rows(cls, rows: npt.NDArray[Any], field: Field | FeatureJob) -> ClipMusic:
        """Return the beats of rows (T, D) of an audio field."""
        rows = np.asarray(rows)
        return cls(field_beats(rows, field), float(field.grid.seconds(len(rows))))

    def after(self, start: int, grid: FrameGrid) -> MusicBeats:
        """Return the beats of the piece that begins at frame `start` of `grid`, counted from there."""
        if self.by_piece is not None:
            return self.by_piece.get(start, MusicBeats.of([], self.beats.grid))
        return beats_after(self.beats, start, grid)

    def identity(self, *, instants: bool) -> list[Any]:
        """Return JSON data for cache keys: frames, and where a metric reads them the instants."""
        pieces = None
        if self.by_piece is not None:
            pieces = [[start, beats.frames.tolist()] for start, beats in sorted(self.by_piece.items())]
        read = [self.beats, *(beats for _, beats in sorted((self.by_piece or {}).items()))] if instants else []
        return [str(self.beats.grid), self.beats.frames.tolist(), pieces, *(b.seconds.tolist() for b in read)]


def field_beats(rows: npt.NDArray[Any], field: Field | FeatureJob) -> MusicBeats:
    """Return the beats of rows (T, D) of an audio field, or of its column of beats alone (T,), at their instants."""
    late = beat_rows_late(field.name)
    if rows.ndim == 1:
        return MusicBeats.of_rows(rows[:, None], _BEAT_ALONE, field.grid, late=late)
    return MusicBeats.of_rows(rows, field.columns, field.grid, late=late)


def beats_after(beats: MusicBeats, start: int, grid: FrameGrid) -> MusicBeats:
    """Return the beats at or after frame `start` of `grid`, counted from there."""
    if grid.is_whole(start, of=beats.grid):
        frames, rate = beats.frames - grid.rows(start, of=beats.grid), beats.grid
    else:
        music, clip = beats.grid.rate, grid.rate
        rate = FrameGrid(Fraction(music.numerator * clip.numerator))
        frames = beats.frames * (music.denominator * clip.numerator) - start * clip.denominator * music.numerator
    instants = None if beats.instants is None else beats.instants[frames >= 0] - float(grid.seconds(start))
    return MusicBeats(frames[frames >= 0], rate, instants)
