"""What a plug-in of each kind has to offer."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import ClipRef, Scan
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton

Float32Array = npt.NDArray[np.float32]


class Dataset(Protocol):
    """Turns a folder of somebody's files into clips.

    Attributes
    ----------
    version
        Raised by hand whenever `load` gives other numbers for the same file.
    generates
        Whether `scan` writes the source where there is none; False where it is left out.
    generic
        Whether it takes files of many layouts, so that `check` must not choose it by itself; False where it is
        left out.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    licence: ClassVar[str]
    citation: ClassVar[str]

    def scan(self, source: Path) -> Scan:
        """List what is there. Reads no motion. SourceError if the folder as a whole cannot be used."""
        ...

    def load(self, ref: ClipRef) -> Motion:
        """Read one clip's motion into canonical form. DataError for anything wrong with it."""
        ...

    def make_example(self, folder: Path) -> None:
        """Write a tiny source in this dataset's layout: 2-4 clips of about 6 s, with music. For tests."""
        ...


class ContactRule(Protocol):
    """Labels the ground contacts of the feet."""

    name: ClassVar[str]
    version: ClassVar[int]

    def __call__(self, joints: Float64Array, grid: FrameGrid, skeleton: Skeleton) -> Float32Array:
        """Return labels (T, 4), 0 or 1, for skeleton.feet from joint positions (T, J, 3), metres."""
        ...


class Representation(Protocol):
    """Turns motion into a trainer's columns.

    Attributes
    ----------
    default_contacts
        Contact rule where a recipe names none; None if the representation holds no contacts.
    skeleton
        Whose joints the columns hold. `encode` takes motions on any body of its family.
    rate
        Frames a second of the columns, where it is the representation's own; None: the recipe's.
    grounded
        Whether `encode` moves the dancer up or down to the ground, so that `decode` gives back the motion but
        for a constant height.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    default_contacts: ClassVar[str | None]
    rate: ClassVar[Fraction | None]
    grounded: ClassVar[bool]
    #: What dataset.json says of the columns' axes and of the 6D convention.
    axes: ClassVar[str]
    rotation_6d: ClassVar[str | None]

    @property
    def skeleton(self) -> Skeleton:
        """Whose joints the columns hold."""
        ...

    @property
    def columns(self) -> Columns:
        """The D columns of the array."""
        ...

    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> Float32Array:
        """Return (T, D) float32."""
        ...

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Return the motion of (T, D) columns at the rate of `grid`."""
        ...


class KeyMotionFinder(Protocol):
    """Finds key motions of a clip: rows a frame that say where they are."""

    name: ClassVar[str]
    version: ClassVar[int]

    @property
    def columns(self) -> Columns:
        """The D columns."""
        ...

    def analyse(self, motion: Motion) -> Float32Array:
        """Return (T, D) rows of a clip at the recipe's rate."""
        ...


class AudioFeature(Protocol):
    """Turns a signal into feature rows.

    Attributes
    ----------
    packages
        Distributions whose version shapes the numbers; they are part of the cache key.
    windows_a_call
        Windows that `extract_windows` takes at once, after which they are published; all of a song where it is
        left out.
    resolved
        ``resolved(hash_file) -> feature``, where a build has to fix something first, such as a precision or the hash
        of weights. Left out by most.
    workers
        ``workers(jobs) -> int``: processes it is worth running in, if that is not `jobs`.
    exact
        False if bits may differ between machines, within a tolerance, as those of a network on a GPU do; it is then
        computed in whichever process asks. Else, and where it is left out, bits are the same on every machine.
    uses_tempo
        False if it makes nothing of `start_bpm`, which is then no part of the cache key.
    estimated_bpm, estimated_window_bpms
        ``estimated_bpm(signal, grid) -> float`` and ``estimated_window_bpms(signal, starts, n_samples, grid)``, a
        list: the tempos that `extract` and `extract_windows` estimate where `start_bpm` is None, for people to see.
    reads_ahead
        True if it computes on a device, so that the next song may be decoded meanwhile.
    make_example
        ``make_example(folder) -> feature``, a class method for tests, where it needs files to run.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    packages: ClassVar[tuple[str, ...]]

    @property
    def columns(self) -> Columns:
        """The D columns."""
        ...

    @property
    def dtype(self) -> str:
        """Type on disk: "float32" or "float16"."""
        ...

    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Return how many rows `extract` gives, without computing them."""
        ...

    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> npt.NDArray[Any]:
        """Return (T, D) rows of a whole signal at the rate of `grid` (scope: track)."""
        ...

    def extract_windows(
        self,
        signal: AudioSignal,
        starts: npt.NDArray[np.int64],
        n_samples: int,
        grid: FrameGrid,
        n_rows: int,
        *,
        start_bpm: float | None = None,
    ) -> npt.NDArray[Any]:
        """Return (W, n_rows, D): windows of `n_samples` samples, each by itself, as EDGE does (scope: window)."""
        ...
