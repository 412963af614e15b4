"""FileFeature: the base class of features whose rows come from files."""

from abc import abstractmethod
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import ClipRef
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid, Number
from dancedata.core.plugins.audio_feature import AudioFeature


@dataclass(frozen=True)
class FileSpan:
    """The rows of a file on a clip's grid."""

    first: int  # row from frame 0 that is the first within the file; may be below 0
    n_rows: int  # rows within the file
    phase: Fraction  # place of the first in the file, in its rows
    step: Fraction  # distance of two, in rows of the file


class FileFeature(AudioFeature):
    """Rows that come from files beside the motion, not from a signal.

    Attributes
    ----------
    grid
        The grid of the files' rows.
    path
        Where files are below the source, for messages.
    tolerance_s
        Most seconds by which a file may be longer or shorter than its clip's motion; None: lengths are not compared.
    """

    from_files: ClassVar[bool] = True

    path: str
    tolerance_s: Number | None

    @property
    @abstractmethod
    def grid(self) -> FrameGrid:
        """The grid of the files' rows."""

    @property
    @abstractmethod
    def hashed_keys(self) -> dict[str, Any]:
        """All that shapes rows beside the file and its place, as JSON."""

    @abstractmethod
    def file_of(self, ref: ClipRef, source: Path) -> Path | None:
        """Return the file of a clip; None if it cannot have one."""

    @abstractmethod
    def length(self, path: Path) -> int:
        """Return the number of rows of a file, from its header; DataError for a file that cannot be used."""

    @abstractmethod
    def begin_s(self, audio_start: Fraction) -> Fraction:
        """Return the second of row 0, counted from frame 0 of a clip whose frame 0 is that second of its music."""

    @abstractmethod
    def placed(self, n_rows: int, begin_s: Fraction, grid: FrameGrid) -> FileSpan:
        """Place a file of `n_rows` rows, of which row 0 is at second `begin_s` of the clip, on the clip's grid."""

    @abstractmethod
    def rows(self, path: Path, placed: FileSpan) -> npt.NDArray[Any]:
        """Return the (placed.n_rows, D) rows of a file on a clip's grid, in `dtype`."""

    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> npt.NDArray[Any]:
        """Raise UsageError: a signal has no file."""
        raise UsageError(
            f"the feature {self.name} takes rows from files: it cannot be computed from a song",
            where=self.path,
            fix="name a feature that computes its rows, or compute the rows with the program that wrote the files",
        )
