"""A window filter as a rule of a build: it judges the rows of each window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import ClassVar, Literal

from dancedata.building.plugins import Seen, WindowRule
from dancedata.building.take import RecipeField
from dancedata.core.clip import Reject
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.plugins import WindowFilter
from dancedata.core.text import shown
from dancedata.core.typing import override


@dataclass(frozen=True)
class Filtered(WindowRule):
    """Judges the rows of each window; of a group one dancer who stands still is choreography."""

    version: ClassVar[int] = 1
    of_group: ClassVar[Literal["any", "all"]] = "all"

    chosen: WindowFilter

    name = property(attrgetter("chosen.name"))
    parameters = property(attrgetter("chosen"))

    @override
    def check(self, fields: Sequence[RecipeField]) -> None:
        of_motion = {field.name: field for field in fields if field.kind != "audio"}
        named = self.chosen.field
        if named not in of_motion:
            default = " (the default)" if named == getattr(type(self.chosen), "field", None) else ""
            raise UsageError(f"{self.name}.field: no such field in motion or keymotion: {shown(named)}{default}",
                             fix=did_you_mean(named, of_motion))  # fmt: skip
        if of_motion[named].optional:
            raise UsageError(f"{self.name}: {named} is optional, and clips without it cannot be filtered",
                             fix="name a field that every clip has")  # fmt: skip
        try:
            self.chosen.check(of_motion[named].columns)
        except UsageError as error:
            raise UsageError(f"{self.name}: field {named}: {error}") from error

    @override
    def judge(self, seen: Seen, dancer: int, starts: Sequence[int]) -> list[Reject]:
        if seen.result.take.split not in self.chosen.splits:
            return []
        field = seen.field(self.chosen.field)
        rows, length = seen.rows(field.name, dancer), seen.grid.rows(seen.length, of=field.grid)
        rejects = []
        for start in starts:
            first = seen.grid.rows(start, of=field.grid)
            window = rows[first : first + length]
            window.flags.writeable = False
            reject = self.chosen.reject(window, field.columns, field.grid)
            rejects += [] if reject is None else [replace(reject, window=start)]
        return rejects
