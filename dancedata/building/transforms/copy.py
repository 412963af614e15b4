"""Copies of train takes: an augmentation as a transform."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.building.take import RecipeField, Scene, Take, Transform
from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.placement import centroid
from dancedata.core.plugins import CopyAugmentation
from dancedata.core.rotations import Float64Array
from dancedata.core.segments import Segment
from dancedata.core.sided_words import mirrored_segment
from dancedata.core.typing import override
from dancedata.files.documents import content_hashes, document_of

#: The split whose clips are copied.
_SPLIT = "train"
#: Speeds of copies: beyond these a phase vocoder's music is noise.
_SLOWEST, _FASTEST = Fraction(1, 4), Fraction(4)


@dataclass(frozen=True)
class Copy(Transform):
    """One copy of every train take; where time changes, motion and music change together."""

    version: ClassVar[int] = 1
    changes_rows: ClassVar[bool] = True

    name: str  # type: ignore[misc]
    augmentation: CopyAugmentation
    other_side: tuple[tuple[int, int], ...] = ()  # left and right joints

    @property
    def moves(self) -> bool:  # type: ignore[override]
        """Whether the augmentation changes motion, not rows."""
        return self.augmentation.changes != "rows"

    @property
    def keeps_time(self) -> bool:  # type: ignore[override]
        """Whether the augmentation keeps the time."""
        return self.augmentation.changes != "time"

    @override
    def key(self) -> list[Any]:
        # The name of the copies does not matter.
        of = self.augmentation
        return [of.name, of.version, document_of(of), content_hashes(of)]

    @override
    def check(self, fields: Sequence[RecipeField]) -> None:
        for field in (field for field in fields if field.kind != "audio"):
            try:
                self.augmentation.check(field.columns)
            except UsageError as error:
                raise UsageError(f"{self.name}: field {field.name}: {error}") from error

    @override
    def expand(self, take: Take) -> Sequence[Take]:
        if take.parent is not None or take.split != _SPLIT:
            return [take]
        if take.group and self.augmentation.acts_on is None:
            raise UsageError(f"the augmentation {self.name} does not say what it does to a group",
                             fix='set `acts_on` in its class: "world" for one change of all dancers, "body" for one '
                             "of each")  # fmt: skip
        if self.keeps_time:
            return [take, take.copy(self, self.clip_id)]
        if any(step.is_part for step in take.steps):
            raise UsageError("a part of a clip has no copy at another speed", where=f"augment.{self.name}",
                             found=f"clip {take.name}", fix="leave it out, or build whole clips")  # fmt: skip
        speed = self.speed_of(_clip(take))
        of_music = (d.music.at_speed(speed, self._music(d.music.name, speed)) for d in take.dancers)
        dancers = [replace(d, music=music) for d, music in zip(take.dancers, of_music, strict=True)]
        time = replace(take.time, rate=take.time.rate * speed)
        return [take, take.copy(self, self.clip_id, dancers=dancers, time=time)]

    def clip_id(self, clip: str) -> str:
        """Return the id of a clip's copy."""
        return f"{clip}__{self.name}"

    def speed_of(self, clip: str) -> Fraction:
        """Return how many times as fast as its clip a copy is; UsageError if that is not a speed."""
        speed = self.augmentation.speed(clip)
        if not (isinstance(speed, Fraction) and _SLOWEST <= speed <= _FASTEST):
            raise UsageError(f"the augmentation {self.name} gives a copy a speed that is not possible",
                             where=f"clip {clip}", found=repr(speed),
                             allowed=f"a Fraction from {_SLOWEST} to {_FASTEST}")  # fmt: skip
        if speed != 1 and self.keeps_time:
            raise UsageError(f"the augmentation {self.name} changes the time, and its class does not declare it",
                             where=f"clip {clip}", found=f"changes = {self.augmentation.changes!r}, speed {speed}",
                             fix='declare it in the class: changes: ClassVar = "time"')  # fmt: skip
        return speed

    def _music(self, name: str, speed: Fraction) -> str:
        """Return the name of a copy's music: that of the clip's, with the speed if it is another, "mBR0__1.1x"."""
        return f"{name}__{float(speed):.6g}x" if name and speed != 1 else name

    @override
    def scene(self, scene: Scene) -> Scene:
        refs, motions = scene.refs, scene.motions
        if not refs[0].group or self.augmentation.acts_on == "body":
            return scene.with_motions([self.motion_of(m, r.id) for m, r in zip(motions, refs, strict=True)])
        pelves = np.stack([motion.part(0, 1).joints()[0, 0] for motion in motions])
        middle = centroid(pelves)
        # As a translation of each dancer: without the place of his pelvis at rest.
        axes = [middle - (pelvis - motion.translation[0]) for pelvis, motion in zip(pelves, motions, strict=True)]
        group = refs[0].group
        return scene.with_motions([self.motion_of(m, group, at) for m, at in zip(motions, axes, strict=True)])

    def motion_of(self, motion: Motion, clip: str, about: Float64Array | None = None) -> Motion:
        """Return the motion of a copy of a clip, or of a dancer of the group `clip`, about the axis at `about`."""
        of_group = {} if about is None else {"about": about}
        changed = self.augmentation.change_motion(motion, clip, **of_group)
        times = [(m.n_frames, str(m.grid), m.trim_start) for m in (changed, motion)]
        if times[0] != times[1]:
            raise UsageError(f"the augmentation {self.name} changes frames, rate or trim_start", where=f"clip {clip}",
                             found="{} frames at {} per second, trim_start {}".format(*times[0]),
                             allowed="{} frames at {} per second, trim_start {}".format(*times[1]))  # fmt: skip
        speed = self.speed_of(clip)
        # The same frames in less time: resampling and contact rules then see the new instants.
        return changed if speed == 1 else replace(changed, grid=FrameGrid(changed.grid.rate * speed))

    @override
    def rows(self, rows: npt.NDArray[Any], columns: Columns, kind: str, take: Take, dancer: int) -> npt.NDArray[Any]:
        drawn_by = _clip(take) if self.augmentation.acts_on == "world" else take.dancers[dancer].ref.id
        return self.rows_of(rows, columns, kind, drawn_by)  # type: ignore[arg-type]

    def rows_of(
        self, rows: npt.NDArray[Any], columns: Columns, kind: Literal["motion", "keymotion"], clip: str
    ) -> npt.NDArray[Any]:
        """Return the rows of a clip's copy; UsageError if the augmentation changes their shape or dtype."""
        view = rows.view()
        view.flags.writeable = False
        changed = np.asarray(self.augmentation.change_rows(view, columns, kind=kind, clip=clip))
        if changed.shape != rows.shape or changed.dtype != rows.dtype:
            raise UsageError(f"the augmentation {self.name} changes the shape or dtype of rows", where=f"clip {clip}",
                             found=f"{changed.shape} {changed.dtype}",
                             allowed=f"{rows.shape} {rows.dtype}")  # fmt: skip
        return changed

    @override
    def segment(self, segment: Segment, take: Take) -> Segment | None:
        return self.segment_of(segment, _clip(take))

    def segment_of(self, segment: Segment, clip: str) -> Segment | None:
        """Return a segment at the copy's speed, in the words of a mirrored dancer; None where these are unknown."""
        speed, data = self.speed_of(clip), segment.data
        if "period" in data:
            data = {**data, "period": data["period"] / speed}
        segment = replace(segment, start=segment.start / speed, end=segment.end / speed, data=data)
        if self.augmentation.mirrors:
            if not segment.can_be_mirrored:
                return None
            segment = mirrored_segment(segment, dict(self.other_side))
        return replace(segment, other=self.clip_id(segment.other) if segment.other else "")


def _clip(take: Take) -> str:
    """Return what a copy is drawn by: the group, or the clip on disk, whose slices have one speed."""
    return take.origin.group or take.dancers[0].ref.id
