"""Base classes of plug-ins that change clips when a dataset is built, or samples when it is read."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, ClassVar, Literal

from dancedata.core.columns import Columns
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins.plugin import Float32Array, Plugin
from dancedata.core.plugins.representation import SampleField
from dancedata.core.rotations import Float64Array


class Augmentation(Plugin):
    """Common base of the two kinds: a plug-in derives from `CopyAugmentation`, `SampleAugmentation`, or both.

    Attributes
    ----------
    acts_on
        What changes in a group of dancers: "world", one change for all of them, by the group's draw and about one
        axis; "body", each dancer by a draw of his own. None: groups are refused.
    """

    acts_on: ClassVar[Literal["world", "body"] | None] = None

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if cls.__module__ != __name__ and not issubclass(cls, (CopyAugmentation, SampleAugmentation)):
            raise UsageError("Augmentation is not a base class of plug-ins",
                             where=f"{cls.__module__}.{cls.__qualname__}",
                             fix="derive the class from CopyAugmentation (change_motion, change_rows, speed), from "
                             "SampleAugmentation (change_sample, choose_start, dropped), or from both")  # fmt: skip


class CopyAugmentation(Augmentation):
    """Makes one copy of every train clip when a dataset is built.

    A copy has the frames, windows and music of its clip, unless its time differs: then its motion is resampled on the
    recipe's grid, its music is stretched, and windows, features, contacts and key motions are computed again.

    Attributes
    ----------
    changes
        "rows": only `change_rows` is called, when a shard is written. "motion": so is `change_motion`, and copies are
        encoded. "time": copies also have their own `speed`.
    mirrors
        Whether left and right change places, so that segments of copies have the words of a mirrored dancer.
    """

    changes: ClassVar[Literal["rows", "motion", "time"]] = "motion"
    mirrors: ClassVar[bool] = False

    def check(self, columns: Columns) -> None:
        """Raise UsageError if copies of a motion or key motion field with these columns cannot be made."""
        return

    def change_motion(self, motion: Motion, clip: str, about: Float64Array | None = None) -> Motion:
        """Return the motion of the copy: as many frames, the same rate and trim_start, a body of the same family.

        Parameters
        ----------
        motion
            The clip as the dataset loads it, at the rate of its source.
        clip
            Its id, for what differs from clip to clip, such as a seed; of a group, where the class acts on worlds.
        about
            A point (3,) of the axis that a group turns about, as a translation of this dancer; None: his own root.
        """
        return motion

    def change_rows(
        self, rows: Float32Array, columns: Columns, *, kind: Literal["motion", "keymotion"], clip: str
    ) -> Float32Array:
        """Return the rows of a clip's copy, in the shape and dtype of `rows`, (T, D) and read-only.

        `kind` says whether the field is a representation or holds key motions.
        """
        return rows

    def speed(self, clip: str) -> Fraction:
        """Return the speed of a copy relative to its clip: 2 takes half the time, 1 keeps the time."""
        return Fraction(1)


class SampleAugmentation(Augmentation):
    """Changes samples when a dataset is read.

    All that is random comes from the `Draw` that a method is called with, which is a pure function of (seed, epoch,
    index) and equal for all fields of a sample.

    Attributes
    ----------
    chooses_windows
        Whether `choose_start` is called, so that other windows are read than those of the dataset.
    """

    chooses_windows: ClassVar[bool] = False

    def check_sample(self, field: SampleField) -> None:
        """Raise UsageError, with the reason, if samples with this field cannot be changed when they are read."""
        return

    def change_sample(
        self, rows: Float32Array, field: SampleField, draw: Draw, about: Float64Array | None = None
    ) -> Float32Array:
        """Return the rows of one field of one sample, in the shape and dtype of `rows`; for motion and key motions.

        Parameters
        ----------
        rows
            (L, D), read-only, not normalised.
        draw
            Random numbers of the sample; each field gets the same ones.
        about
            A point (3,) of the axis that a group turns about, in the columns' world; None: the root in the first row.
        """
        return rows

    def choose_start(self, start: int, starts: range, stride: int, draw: Draw) -> int:
        """Return the first frame of the window that is read instead of another one.

        Parameters
        ----------
        start
            First frame of the other window.
        starts
            First frames that a window of this length can have in the clip; one of them is returned.
        stride
            Frames from one of the dataset's windows to the next.
        """
        return start

    def droppable(self, fields: Sequence[SampleField]) -> tuple[str, ...]:
        """Return the names of the fields that `dropped` may return; UsageError if there are none."""
        return ()

    def dropped(self, fields: Sequence[SampleField], draw: Draw) -> tuple[str, ...]:
        """Return the names of the fields of a sample that are masked."""
        return ()

    def scaler_bounds(
        self, low: Float64Array, high: Float64Array, field: SampleField
    ) -> tuple[Float64Array, Float64Array]:
        """Return the range (D,) that the scaler of a motion field needs, from the range of the stored rows."""
        return low, high
