"""Beats of a clip's music, as clips are measured with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import MusicBeats
from dancedata.core.grid import FrameGrid

__all__ = ["BEAT", "ClipMusic", "beats_after"]

#: Group of the beats in an audio feature.
BEAT = "beat"


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
    def of_rows(cls, rows: npt.NDArray[Any], column: int, grid: FrameGrid) -> ClipMusic:
        """Return the beats of feature rows (T, D): where the column is not 0."""
        beats = np.flatnonzero(np.asarray(rows)[:, column])
        return cls(MusicBeats.of(beats, grid), float(grid.seconds(len(rows))))

    def after(self, start: int, grid: FrameGrid) -> MusicBeats:
        """Return the beats of the piece that begins at frame `start` of `grid`, counted from there."""
        if self.by_piece is not None:
            return self.by_piece.get(start, MusicBeats.of([], self.beats.grid))
        return beats_after(self.beats, start, grid)

    def identity(self) -> list[Any]:
        """Return JSON data for cache keys."""
        pieces = None
        if self.by_piece is not None:
            pieces = [[start, beats.frames.tolist()] for start, beats in sorted(self.by_piece.items())]
        return [str(self.beats.grid), self.beats.frames.tolist(), pieces]


def beats_after(beats: MusicBeats, start: int, grid: FrameGrid) -> MusicBeats:
    """Return the beats at or after frame `start` of `grid`, counted from there."""
    if grid.is_whole(start, of=beats.grid):
        frames, rate = beats.frames - grid.rows(start, of=beats.grid), beats.grid
    else:
        own, clip = beats.grid.rate, grid.rate
        rate = FrameGrid(Fraction(own.numerator * clip.numerator))
        frames = beats.frames * (own.denominator * clip.numerator) - start * clip.denominator * own.numerator
    return MusicBeats(frames[frames >= 0], rate)
