"""Copies of train clips in a recipe: their augmentation and name."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import CopyAugmentation
from dancedata.core.rotations import Float64Array
from dancedata.core.segments import Segment
from dancedata.core.sided_words import mirrored_segment
from dancedata.recipes.documents import document_of
from dancedata.recipes.fields import FieldSpec

#: The split whose clips are copied.
_SPLIT = "train"
#: Speeds of copies: beyond these a phase vocoder's music is noise.
_SLOWEST, _FASTEST = Fraction(1, 4), Fraction(4)


@dataclass(frozen=True)
class CopySpec:
    """One copy of every train clip.

    `name`: The augmentation's name, or PLUGIN.NAME where a recipe has several of one plug-in; part of the ids of
        copies.
    """

    name: str
    augmentation: CopyAugmentation

    def check(self, fields: Iterable[FieldSpec]) -> None:
        """Raise UsageError, which begins with its name, if there are no copies of a field of motion."""
        for field in (field for field in fields if field.kind != "audio"):
            try:
                self.augmentation.check(field.columns)
            except UsageError as error:
                raise UsageError(f"{self.name}: field {field.name}: {error}") from error

    def key(self) -> list[Any]:
        """Return what decides the motion of copies, for keys of the cache."""
        return [self.augmentation.name, self.augmentation.version, document_of(self.augmentation)]

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
        if speed != 1 and self.augmentation.changes != "time":
            raise UsageError(f"the augmentation {self.name} changes the time, and its class does not declare it",
                             where=f"clip {clip}", found=f"changes = {self.augmentation.changes!r}, speed {speed}",
                             fix='declare it in the class: changes: ClassVar = "time"')  # fmt: skip
        return speed

    def music_of(self, music: str, clip: str) -> str:
        """Return the name of a copy's music: that of the clip's, with the speed if it is another, "mBR0__1.1x"."""
        speed = self.speed_of(clip)
        return f"{music}__{float(speed):.6g}x" if music and speed != 1 else music

    def motion_of(self, motion: Motion, clip: str, about: Float64Array | None = None) -> Motion:
        """Return the motion of a clip's copy, at another rate where it has another speed.

        Of a group `clip` is its name, and `about` a point of the axis that it turns about.

        Raises UsageError: if `change_motion` changes frames, rate or trim_start.
        """
        changed = (
            self.augmentation.change_motion(motion, clip)
            if about is None
            else self.augmentation.change_motion(motion, clip, about=about)
        )
        times = [(m.n_frames, str(m.grid), m.trim_start) for m in (changed, motion)]
        if times[0] != times[1]:
            raise UsageError(f"the augmentation {self.name} changes frames, rate or trim_start", where=f"clip {clip}",
                             found="{} frames at {} per second, trim_start {}".format(*times[0]),
                             allowed="{} frames at {} per second, trim_start {}".format(*times[1]))  # fmt: skip
        speed = self.speed_of(clip)
        # The same frames in less time: resampling and contact rules then see the new instants.
        return changed if speed == 1 else replace(changed, grid=FrameGrid(changed.grid.rate * speed))

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


def copied_segment(segment: Segment, spec: CopySpec, unit: str, other_side: Mapping[int, int]) -> Segment | None:
    """Return a segment of a clip in its copy: at its speed, and in the words of a mirrored dancer.

    None for words that may name a side, and have no mirrored ones, in mirrored copies.

    `unit`: Name of the group, or the clip's id.
    `other_side`: The left and right joints.
    """
    speed, data = spec.speed_of(unit), segment.data
    if "period" in data:
        data = {**data, "period": data["period"] / speed}
    segment = replace(segment, start=segment.start / speed, end=segment.end / speed, data=data)
    if spec.augmentation.mirrors:
        if not segment.can_be_mirrored:
            return None
        segment = mirrored_segment(segment, other_side)
    return replace(segment, other=spec.clip_id(segment.other) if segment.other else "")


def is_copied(split: str) -> bool:
    """Return whether clips of a split are copied: those of train are."""
    return split == _SPLIT


def copies_per_clip(specs: tuple[CopySpec, ...], split: str) -> int:
    """Return how many clips with the time of a clip are stored for each clip of a split, itself included."""
    return 1 + sum(spec.augmentation.changes != "time" for spec in specs) if is_copied(split) else 1
