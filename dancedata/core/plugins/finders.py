"""Base classes of what is found in motion: key motions, windows that are left out, primitives."""

from abc import abstractmethod
from typing import Any, ClassVar, Literal

import numpy.typing as npt

from dancedata.core.clip import Reject
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins.plugin import Float32Array, Plugin


class KeyMotionFinder(Plugin):
    """Finds the key motions of a clip, as rows per frame."""

    @property
    @abstractmethod
    def columns(self) -> Columns:
        """The D columns."""

    @abstractmethod
    def analyse(self, motion: Motion) -> Float32Array:
        """Return (T, D) rows of a clip at the recipe's rate."""


class WindowFilter(Plugin):
    """Decides which windows are kept, from the rows of one motion or key motion field.

    Attributes
    ----------
    reason
        Code of its rejects.
    """

    reason: ClassVar[str] = "filtered"

    @property
    @abstractmethod
    def field(self) -> str:
        """Name of the field to inspect; usually a parameter."""

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that are filtered; windows of the others are all kept."""
        return ("train",)

    def check(self, columns: Columns) -> None:
        """Raise UsageError if windows of a field with these columns cannot be judged."""
        return

    @abstractmethod
    def reject(self, rows: Float32Array, columns: Columns, grid: FrameGrid) -> Reject | None:
        """Return why a window of rows (L, D), not normalised, is left out, a `Reject`; None if it is kept."""


#: The name of primitives in samples.
PRIMITIVES = "primitives"


class PrimitiveFinder(Plugin):
    """Finds Lodge's primitives in rows of motion, for samples of windows."""

    @abstractmethod
    def find(
        self,
        rows: npt.NDArray[Any],
        n: int,
        variant: Literal["paper", "code"],
        bias: int,
        key_motion: npt.NDArray[Any] | None,
    ) -> dict[str, npt.NDArray[Any]]:
        """Return the primitives of a window, as entries of a sample; "primitives" are rows of motion.

        `rows`: (N, D), mirrored but not normalised; N is a multiple of `n`, the frames of a local segment.
        `bias`: Frames by which they are shifted.
        `key_motion`: (N, 3) stored key motion of the window; None: they are those of the window alone.
        """
