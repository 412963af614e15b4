"""Windows that a window filter rejects are left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

from dancedata.building.plugins import RULES, Seen, WindowRule
from dancedata.core.clip import Reject
from dancedata.core.plugins import WindowFilter


@RULES.register("filter")
@dataclass(frozen=True)
class Filtered(WindowRule):
    """Judges the rows of each window; of a group one dancer who stands still is choreography.

    Attributes
    ----------
    chosen
        The filter.
    """

    version: ClassVar[int] = 1
    of_group: ClassVar[Literal["any", "all"]] = "all"

    chosen: WindowFilter

    def judge(self, seen: Seen, dancer: int, starts: Sequence[int]) -> list[Reject]:
        """Return the rejects of the filter."""
        if seen.result.take.split not in self.chosen.splits:
            return []
        field = seen.field(self.chosen.field)
        rows, length = seen.rows(field, dancer), seen.grid.rows(seen.length, of=field.grid)
        rejects = []
        for start in starts:
            first = seen.grid.rows(start, of=field.grid)
            window = rows[first : first + length]
            window.flags.writeable = False
            reject = self.chosen.reject(window, field.columns, field.grid)
            rejects += [] if reject is None else [replace(reject, window=start)]
        return rejects
