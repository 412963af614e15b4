"""Cutting a song into contexts of Jukebox's transformer, at instants of both a frame and a code."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid

#: Seconds at the end of a context whose rows come from the next one: Fourier resampling treats a context as periodic,
#: so its ends ring into each other, and the last codes lack the samples that follow.
TAIL_S = Fraction(16, 30)


@dataclass(frozen=True)
class Context:
    """A part of a song that the transformer processes at once.

    Attributes
    ----------
    first_code, n_codes
        Codes of the song.
    first_row
        Row of the song at the beginning of the context.
    keep_from, keep_to
        Rows of the context that become rows of the song.
    """

    first_code: int
    n_codes: int
    first_row: int
    keep_from: int
    keep_to: int


def unit_of(code_rate: Fraction, fps: Fraction) -> tuple[int, int]:
    """Return the least numbers of codes and of rows of equal duration: 735 and 64 at 30 rows per second."""
    return FrameGrid(code_rate).common_period(FrameGrid(fps))


def contexts_of(
    n_codes: int, *, n_ctx: int, code_rate: Fraction, fps: Fraction, overlap_s: Fraction
) -> list[Context]:
    """Cut a song's codes into contexts that overlap by at least `overlap_s`.

    Each begins at an instant of both a code and a row. Except in the song's first context, the first rows are warm-up
    and dropped; except in its last one, so is a short tail. The rows that are kept join without a gap.

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
            "jukebox: contexts cannot overlap at this frame rate: codes and rows do not coincide within a context",
            found=f"{fps} rows per second, {codes} codes to {rows} rows",
            allowed=f"rates at which they coincide within {n_ctx} codes, such as 30, 60, 25 or 24",
        )
    if overlap >= per_context or overlap * rows <= tail:
        raise UsageError(
            "jukebox: invalid value for overlap_s",
            found=f"{float(overlap_s):g} s at {fps} rows per second",
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
