"""Key motions as fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from dancedata.building.fields.motion import Encoded, MotionField
from dancedata.building.result import Nothing
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import KeyMotionFinder, Plugin
from dancedata.core.typing import override
from dancedata.files.documents import document_of


@dataclass(frozen=True)
class KeyMotionField(MotionField):
    """The key motions of each dancer."""

    slot = "keymotion"
    kind = "keymotion"

    name: str  # type: ignore[misc]
    grid: FrameGrid
    finder: KeyMotionFinder
    optional: bool = False

    columns = property(attrgetter("finder.columns"))

    @property
    @override
    def plugins(self) -> Mapping[str, Plugin]:
        return {f"keymotion {self.name}": self.finder}

    @property
    @override
    def description(self) -> str:
        return f"key motions, {', '.join(self.columns.labels)}"

    @property
    @override
    def hashed_values(self) -> list[Any]:
        return [self.finder.name, (self.finder.version, 0)]

    @override
    def document(self) -> dict[str, Any]:
        return {**document_of(self.finder), "optional": self.optional}

    @override
    def encoded(
        self, motions: Sequence[Motion | Nothing], dancers: Sequence[int], *, in_group: bool
    ) -> list[Encoded]:
        return [self._analysed(motions[k]) for k in dancers]

    def _analysed(self, motion: Motion | Nothing) -> Encoded:
        if isinstance(motion, Nothing):
            return motion
        return self.nothing_on_error(lambda: np.asarray(self.finder.analyse(motion)))
