"""Cutting a song into contexts of Jukebox's transformer, on frames and codes that meet."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid

#: Seconds at a context's end whose rows are left to the next one: Fourier resampling takes a context as periodic, so
#: its ends ring into each other, and the last codes do not hear what follows.
TAIL_S = Fraction(16, 30)


@dataclass(frozen=True)
class Context:
    """A stretch of a song that the transformer sees at once.

    Attributes
    ----------
    first_code, n_codes
        Codes of the song.
    first_row
        Row of the song at the context's beginning.
    keep_from, keep_to
        Rows of the context that become the song's.
    """

    first_code: int
    n_codes: int
    first_row: int
    keep_from: int
    keep_to: int


def unit_of(code_rate: Fraction, fps: Fraction) -> tuple[int, int]:
    """Return the least number of codes, and of rows, that take equally long: 735 and 64 at 30 rows a second."""
    return FrameGrid(code_rate).common_period(FrameGrid(fps))


def contexts_of(
    n_codes: int, *, n_ctx: int, code_rate: Fraction, fps: Fraction, overlap_s: Fraction
) -> list[Context]:
    """Cut a song's codes into contexts that overlap by at least `overlap_s`.

    Each begins at an instant that is both a code's and a row's. The first part of every context but the song's
    first is warm-up and dropped, and so is a short tail of every one but the last; what is kept of
    neighbours joins without a gap.

    Raises
    ------
    UsageError
        If a context is too short for the overlap, or for one unit of codes and rows.
    """
    codes, rows = unit_of(code_rate, fps)
    per_context = n_ctx // codes
    grid = FrameGrid(fps)
    tail = grid.frames_up(TAIL_S)
    overlap = FrameGrid(fps / rows).frames_up(overlap_s)
    if per_context < 1:
        raise UsageError(
            "jukebox: contexts cannot overlap at this rate: codes and rows never meet within one",
            found=f"{fps} rows a second, {codes} codes to {rows} rows",
            allowed=f"rates at which they meet within {n_ctx} codes, such as 30, 60, 25 or 24",
            fix="choose one of these",
        )
    if overlap >= per_context or overlap * rows <= tail:
        raise UsageError(
            "jukebox: contexts cannot overlap like that",
            found=f"overlap_s {float(overlap_s):g} at {fps} rows a second",
            allowed=f"above {float(grid.seconds(tail)):.2f} s and below "
            f"{float(grid.seconds((per_context - 1) * rows)):.2f} s, in a context of "
            f"{float(grid.seconds(per_context * rows)):.2f} s",
        )
    found = []
    step = per_context - overlap
    first = 0
    while True:
        begin = first * codes
        last = begin + per_context * codes >= n_codes
        length = min(per_context * codes, n_codes - begin)
        n_rows = FrameGrid(code_rate).rows_up(length, of=grid)
        keep_from = 0 if first == 0 else overlap * rows - tail
        found.append(Context(begin, length, first * rows, keep_from, n_rows if last else n_rows - tail))
        if last:
            return found
        first += step
