"""Copies of train takes: an augmentation as a transform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.building.take import Scene, Take, Transform
from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.segments import Segment
from dancedata.core.spatial import middle_of
from dancedata.recipes.copies import CopySpec, copied_segment, is_copied


@dataclass(frozen=True)
class Copy(Transform):
    """One copy of every train take; where time changes, motion and music change together.

    Attributes
    ----------
    spec
        The augmentation, and the name of its copies.
    other_side
        The left and right joints of the skeleton: (joint, that of the other side).
    """

    version: ClassVar[int] = 1
    changes_rows: ClassVar[bool] = True

    spec: CopySpec
    other_side: tuple[tuple[int, int], ...] = ()

    @property
    def moves(self) -> bool:  # type: ignore[override]
        """Whether the augmentation changes motion, not rows."""
        return self.spec.augmentation.changes != "rows"

    @property
    def keeps_time(self) -> bool:  # type: ignore[override]
        """Whether the augmentation keeps the time."""
        return self.spec.augmentation.changes != "time"

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the copies, part of their ids."""
        return self.spec.name

    def expand(self, take: Take) -> Sequence[Take]:
        """Return a take of the source and its copy."""
        if take.parent is not None or not is_copied(take.split):
            return [take]
        if take.group and self.spec.augmentation.acts_on is None:
            raise UsageError(f"the augmentation {self.spec.name} does not say what it does to a group",
                             fix='set `acts_on` in its class: "world" for one change of all dancers, "body" for one '
                                 'of each')  # fmt: skip
        if self.keeps_time:
            return [take, take.copy(self, self.spec.clip_id)]
        if any(step.cuts for step in take.steps):
            raise UsageError("a part of a clip has no copy at another speed", where=f"augment.{self.spec.name}",
                             found=f"clip {take.name}", fix="leave it out, or build whole clips")  # fmt: skip
        speed = self.spec.speed_of(take.name)
        dancers = [
            replace(d, music=d.music.at_speed(speed, self.spec.music_of(d.music.name, take.name)))
            for d in take.dancers
        ]
        time = replace(take.time, rate=take.time.rate * speed)
        return [take, take.copy(self, self.spec.clip_id, dancers=dancers, time=time)]

    def scene(self, scene: Scene) -> Scene:
        """Change the motion of each dancer, or of all as one world."""
        refs, motions = scene.refs, scene.motions
        if not refs[0].group or self.spec.augmentation.acts_on == "body":
            return scene.with_motions([self.spec.motion_of(m, r.id) for m, r in zip(motions, refs, strict=True)])
        pelves = np.stack([motion.part(0, 1).joints()[0, 0] for motion in motions])
        middle = middle_of(pelves)
        # As a translation of each dancer: without the place of his pelvis at rest.
        axes = [middle - (pelvis - motion.translation[0]) for pelvis, motion in zip(pelves, motions, strict=True)]
        group = refs[0].group
        return scene.with_motions([self.spec.motion_of(m, group, at) for m, at in zip(motions, axes, strict=True)])

    def rows(self, rows: npt.NDArray[Any], columns: Columns, kind: str, take: Take, dancer: int) -> npt.NDArray[Any]:
        """Change the rows of a copy; what changes a world draws by the group."""
        source = take.root
        is_world = source.group and self.spec.augmentation.acts_on == "world"
        drawn_by = source.group if is_world else source.dancers[dancer].id
        return self.spec.rows_of(rows, columns, kind, drawn_by)  # type: ignore[arg-type]

    def segment(self, segment: Segment, take: Take) -> Segment | None:
        """Return a segment at the speed of the copy, and in the words of a mirrored dancer."""
        return copied_segment(segment, self.spec, take.root.name, dict(self.other_side))

    def key(self) -> list[Any]:
        """Return what decides the motion of copies; their name does not."""
        return self.spec.key()
