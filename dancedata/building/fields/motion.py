"""Rows of a take's motion: representations and key motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from dancedata.building.plugins import Ask, Field, Reach, maker_hash
from dancedata.building.result import Nothing, Rows
from dancedata.building.rows import stored_rows
from dancedata.building.take import Take
from dancedata.core.bodies import CROSSING
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.recipes.fields import FieldOfMotion

if TYPE_CHECKING:
    from dancedata.store.stored_clip import LazyArray

#: Raised by hand when the stage gives other numbers for the same motion.
_STAGE = 6
T = TypeVar("T")


@dataclass(frozen=True)
class MotionRows(Field):
    """Rows that are encoded of the motion of each dancer.

    `without`: Names of transforms that it is made without, such as repairs.
    """

    stage: ClassVar[str] = "motion"

    spec: FieldOfMotion
    without: tuple[str, ...] = ()

    @cached_property
    def sha256(self) -> str:
        """Hash of all that shapes the rows of a motion."""
        plugin = self.spec.plugin.name
        return maker_hash(_STAGE, CROSSING, plugin, self.spec.version, self.spec.document(), str(self.grid))

    def block(self, rows: Rows | Nothing, take: Take, dancer: int, grid: FrameGrid) -> LazyArray:
        """Return the rows as they are stored."""
        return stored_rows(rows, self, take, dancer)

    def asks(self, take: Take) -> Sequence[Ask]:
        """Return what is asked for each dancer."""
        steps = [step for step in take.motion_steps if step.name not in self.without]
        return [self.motion_ask(take, k, steps) for k in range(len(take.dancers))]

    def not_for_groups(self, fields: Sequence[Field]) -> str:
        """Return why rows without places cannot hold a group: dancers anywhere would have equal columns."""
        if not self.spec.placeless or self.grid in {field.grid for field in fields if field.spec.holds_places}:
            return ""
        return (
            f"its columns have no places: store them beside it, motion: {{root_place: {{fps: {self.grid}}}}}, or "
            "choose a representation that has them, such as edge151"
        )

    def n_rows(self, take: Take, dancer: int) -> int:
        """Return the number of rows."""
        return take.time.frames_on(self.grid)

    def reach(self, take: Take, dancer: int, grid: FrameGrid) -> Reach:
        """Return the frames that rows of another rate cover."""
        beyond = f"ends after the last of the rows at {self.grid} per second"
        return Reach(0, self.grid.rows_down(take.time.frames_on(self.grid), of=grid), beyond=beyond)

    def make(self, loaded: Any, parts: Sequence[Any]) -> Sequence[npt.NDArray[np.float32] | Nothing]:
        """Encode the motion of dancers of one scene; those of a group on one floor."""
        scene = loaded.after(parts[0][0])
        motions = [self._try(partial(self._on_grid, motion)) for motion in scene.motions]
        floor = self._floor(motions) if scene.refs[0].group else None
        return [self._encoded(motions[k], floor) for _, k in parts]

    def _on_grid(self, motion: Motion) -> Motion:
        if self.optional:
            self.spec.require(motion)
        return motion.resampled(self.grid)

    def _encoded(self, motion: Motion | Nothing, floor: float | None) -> npt.NDArray[np.float32] | Nothing:
        if isinstance(motion, Nothing):
            return motion
        spec = self.spec
        return self._try(
            lambda: np.asarray(spec.encode(motion) if floor is None else spec.encode_above(motion, floor))
        )

    def _floor(self, motions: Sequence[Motion | Nothing]) -> float | None:
        """Return the floor of a group, of the dancers that the field can take; None where rows have none."""
        if not self.spec.grounded:
            return None
        floors = [self._try(partial(self.spec.floor, m)) for m in motions if not isinstance(m, Nothing)]
        return min((height for height in floors if not isinstance(height, Nothing)), default=0.0)

    def _try(self, call: Callable[[], T]) -> T | Nothing:
        """Return the result of a call; Nothing where an optional field cannot take a motion."""
        try:
            return call()
        except (DataError, UsageError) as error:  # the latter where a plug-in cannot take the skeleton
            if not self.optional:
                raise
            return Nothing(str(error))
