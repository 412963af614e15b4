"""The kinds of plug-ins: one abstract base class for each, with defaults for everything that is optional.

A plug-in is a frozen dataclass, derived from one of these classes and registered under a name. Its fields are the
keys that a recipe may set. It has to define the abstract members, and may replace the others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.columns import Columns
from dancedata.core.dance import Dance, Undefined
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton
from dancedata.core.spatial import Spatial

if TYPE_CHECKING:  # an export reads a whole dataset: the only plug-in that takes more than values of core
    from dancedata.exporting.folder import ExportFolder
    from dancedata.exporting.job import ExportJob, Lack

__all__ = [
    "AudioFeature",
    "Augmentation",
    "Better",
    "ContactRule",
    "Dataset",
    "Export",
    "Float32Array",
    "KeyMotionFinder",
    "Metric",
    "Plugin",
    "Representation",
    "SampleField",
    "WindowFilter",
]

Float32Array = npt.NDArray[np.float32]
#: What is better for a score: more, less, or what is closer to the ground truth's.
Better = Literal["higher", "lower", "closer"]


class Plugin(ABC):
    """Base of all plug-ins.

    Attributes
    ----------
    name
        What recipes call it; set by the registry.
    version
        Raised by hand whenever the same input gives other numbers: it is part of the cache keys.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    __dataclass_fields__: ClassVar[dict[str, Any]]


class Dataset(Plugin):
    """Reads a source folder: which clips there are, and the motion of each in canonical form.

    Attributes
    ----------
    licence, citation
        Text for the dataset card of whatever is built from it.
    generates
        Whether `scan` writes the source where there is none.
    generic
        Whether it takes files of many layouts, so that `check` does not choose it by itself.
    genre_ids
        The dataset's own number for each genre, for trainers that use it.
    """

    licence: ClassVar[str]
    citation: ClassVar[str]
    generates: ClassVar[bool] = False
    generic: ClassVar[bool] = False

    @property
    def genre_ids(self) -> Mapping[str, int]:
        """Number of each genre; empty where the dataset has none."""
        return {}

    @abstractmethod
    def scan(self, source: Path) -> Scan:
        """List the clips. Reads no motion. SourceError if the folder as a whole cannot be used."""

    @abstractmethod
    def load(self, ref: ClipRef) -> Motion:
        """Read one clip's motion into canonical form. DataError for anything wrong with it."""

    @abstractmethod
    def make_example(self, folder: Path) -> None:
        """Write a tiny source in this dataset's layout: 2-4 clips of about 6 s, with music. For tests."""


class ContactRule(Plugin):
    """Labels the ground contacts of the feet."""

    @abstractmethod
    def __call__(self, joints: Float64Array, grid: FrameGrid, skeleton: Skeleton) -> Float32Array:
        """Return labels (T, 4), 0 or 1, for skeleton.feet from joint positions (T, J, 3), metres."""


class Representation(Plugin):
    """Turns motion into the columns that a trainer reads.

    Attributes
    ----------
    default_contacts
        Contact rule where a recipe names none; None if the representation holds no contacts.
    rate
        Frames per second of the columns, where it is the representation's own; None: the recipe's.
    grounded
        Whether `encode` moves the dancer up or down to the ground, so that `decode` returns the motion except for a
        constant height.
    axes, rotation_6d
        What dataset.json says of the columns' axes and of the 6D convention.
    spatial
        How the columns follow when the dancer is turned or shifted, for augmentations of samples; None: such samples
        cannot be turned or shifted.
    decodes
        Whether the class has a `decode` of its own; set by itself.
    fits
        Whether `decode` returns a motion with the joint positions of the columns only, on bones of their own: where
        the dancer stood and faced, the body's bones and how they turn about themselves are lost in `encode`.
    """

    default_contacts: ClassVar[str | None] = None
    rate: ClassVar[Fraction | None] = None
    grounded: ClassVar[bool] = False
    axes: ClassVar[str]
    rotation_6d: ClassVar[str | None] = None
    spatial: ClassVar[Spatial | None] = None
    decodes: ClassVar[bool] = False
    fits: ClassVar[bool] = False

    @property
    @abstractmethod
    def skeleton(self) -> Skeleton:
        """Skeleton of the columns' joints. `encode` takes motions on any body of its family."""

    @property
    @abstractmethod
    def columns(self) -> Columns:
        """The D columns of the array."""

    @abstractmethod
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> Float32Array:
        """Return (T, D) float32."""

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Return the motion of (T, D) columns at the rate of `grid`. UsageError where that is not possible."""
        raise UsageError(f"the representation {self.name} cannot be decoded", allowed="encoding")

    def encode_again(self, motion: Motion, contacts: ContactRule | None = None) -> Float32Array:
        """Return (T, D) columns of a motion that `decode` returned and that was changed since.

        The dancer stays at the height that the decoded columns had. A representation that is `grounded` replaces
        this, as `encode` would move the dancer to the ground once more.
        """
        if self.grounded:
            raise UsageError(f"the representation {self.name} cannot be encoded again at the same height")
        return self.encode(motion, contacts)

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.decodes = cls.decode is not Representation.decode


class KeyMotionFinder(Plugin):
    """Finds the key motions of a clip, as rows per frame."""

    @property
    @abstractmethod
    def columns(self) -> Columns:
        """The D columns."""

    @abstractmethod
    def analyse(self, motion: Motion) -> Float32Array:
        """Return (T, D) rows of a clip at the recipe's rate."""


class AudioFeature(Plugin):
    """Turns a signal into feature rows.

    Attributes
    ----------
    packages
        Distributions whose version shapes the numbers; they are part of the cache key.
    exact
        Whether bits are the same on every machine. False for networks, whose bits differ within a tolerance; they are
        computed in the calling process.
    uses_tempo
        Whether `start_bpm` has an effect; if not, it is not part of the cache key.
    reads_ahead
        Whether it computes on a device, so that the next song may be decoded meanwhile.
    """

    packages: ClassVar[tuple[str, ...]]
    exact: ClassVar[bool] = True
    uses_tempo: ClassVar[bool] = True
    reads_ahead: ClassVar[bool] = False

    @property
    @abstractmethod
    def columns(self) -> Columns:
        """The D columns."""

    @property
    def dtype(self) -> Literal["float32", "float16"]:
        """Type on disk."""
        return "float32"

    @property
    def windows_a_call(self) -> int | None:
        """Windows that `extract_windows` takes at once, after which they are published; None: all of a song."""
        return None

    @abstractmethod
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Return how many rows `extract` gives, without computing them."""

    @abstractmethod
    def extract(self, signal: AudioSignal, grid: FrameGrid, *, start_bpm: float | None = None) -> npt.NDArray[Any]:
        """Return (T, D) rows of a whole signal at the rate of `grid` (scope: track)."""

    @abstractmethod
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

    def resolved(self, hash_file: Callable[[Path], str]) -> Self:
        """Return the feature with everything fixed that depends on this machine, such as a precision.

        Parameters
        ----------
        hash_file
            Gives the SHA-256 of a file, such as one with weights.
        """
        return self

    def with_weights(self, folder: Path) -> Self:
        """Return the feature with the weights in a folder; one that has no weights stays as it is."""
        return self

    def workers(self, jobs: int) -> int:
        """Return how many processes to run in, of `jobs`: one for each card, for example."""
        return jobs

    def estimated_bpm(self, signal: AudioSignal, grid: FrameGrid) -> float | None:
        """Return the tempo that `extract` estimates where `start_bpm` is None; None if it estimates none."""
        return None

    def estimated_window_bpms(
        self, signal: AudioSignal, starts: npt.NDArray[np.int64], n_samples: int, grid: FrameGrid
    ) -> list[float] | None:
        """Return the tempos that `extract_windows` estimates, one per window; None if it estimates none."""
        return None

    @classmethod
    def make_example(cls, folder: Path) -> Self:
        """Return the feature with its defaults, for tests; one that needs files writes small ones into the folder."""
        return cls()


@dataclass(frozen=True)
class SampleField:
    """A field of the samples that a reader gives, as augmentations see it.

    Attributes
    ----------
    grid
        Grid of the rows.
    representation, contacts
        Of a motion field: the plug-ins that made its columns, as the dataset's recipe names them; None where they are
        not known, or for contacts where the field has none.
    """

    name: str
    kind: Literal["motion", "keymotion", "audio"]
    columns: Columns
    grid: FrameGrid
    representation: Representation | None = None
    contacts: ContactRule | None = None


class Augmentation(Plugin):
    """Changes clips when a dataset is built, samples when it is read, or both.

    *Building.* An augmentation that defines `change_motion`, `change_rows` or `speed` makes one copy of every train
    clip. A copy has the frames, windows and music of its clip, unless `speed` changes the time: then its motion is
    resampled on the recipe's grid, its music is stretched, and windows, features, contacts and key motions are
    computed anew.

    *Reading.* An augmentation that defines `change_sample`, `choose_start` or `dropped` changes samples. All that is
    random comes from the `Draw` that it is given, which is a pure function of (seed, epoch, index) and equal for all
    fields of a sample.

    Attributes
    ----------
    changes_motion, changes_time, makes_copies
        Whether the copies of a class are encoded, whether their time may differ from that of their clips, and whether
        it makes copies at all; set automatically.
    changes_samples, chooses_windows, drops_fields
        Whether the class defines `change_sample`, `choose_start`, `dropped`; set automatically.
    """

    changes_motion: ClassVar[bool] = False
    changes_time: ClassVar[bool] = False
    makes_copies: ClassVar[bool] = False
    changes_samples: ClassVar[bool] = False
    chooses_windows: ClassVar[bool] = False
    drops_fields: ClassVar[bool] = False

    def check(self, columns: Columns) -> None:
        """Raise UsageError if copies of a motion or key motion field with these columns cannot be made."""
        return

    def change_motion(self, motion: Motion, clip: str) -> Motion:
        """Return the motion of the copy: as many frames, the same rate and trim_start, a body of the same family.

        Parameters
        ----------
        motion
            The clip as the dataset loads it, at the rate of its source.
        clip
            Id of the clip, for what differs from clip to clip, such as a seed.
        """
        return motion

    def change_rows(
        self, rows: Float32Array, columns: Columns, *, kind: Literal["motion", "keymotion"], clip: str
    ) -> Float32Array:
        """Return the rows of the copy, in the shape and dtype of `rows`.

        Parameters
        ----------
        rows
            Read-only: (T, D) in track scope, (W, L, D) in window scope.
        kind
            Whether the field is a representation or holds key motions.
        clip
            Id of the clip.
        """
        return rows

    def speed(self, clip: str) -> Fraction:
        """Return how many times as fast as its clip a copy is: 2 takes half the time, 1 leaves the time as it is."""
        return Fraction(1)

    def check_sample(self, field: SampleField) -> None:
        """Raise UsageError, with the reason, if samples with this field cannot be changed when they are read."""
        return

    def change_sample(self, rows: Float32Array, field: SampleField, draw: Draw) -> Float32Array:
        """Return the rows of one field of one sample, in the shape and dtype of `rows`; for motion and key motions.

        Parameters
        ----------
        rows
            (L, D), read-only, not normalised.
        draw
            Random numbers of the sample; each field gets the same ones.
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

    def cover(self, low: Float64Array, high: Float64Array, field: SampleField) -> tuple[Float64Array, Float64Array]:
        """Return the range (D,) that the scaler of a motion field needs, from the range of the stored rows."""
        return low, high

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        base = Augmentation
        cls.changes_time = cls.speed is not base.speed
        cls.changes_motion = cls.changes_time or cls.change_motion is not base.change_motion
        cls.makes_copies = cls.changes_motion or cls.change_rows is not base.change_rows
        cls.changes_samples = cls.change_sample is not base.change_sample
        cls.chooses_windows = cls.choose_start is not base.choose_start
        cls.drops_fields = cls.dropped is not base.dropped


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
        """Name of the field that is looked at; usually a parameter."""

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that are filtered; windows of the others are all kept."""
        return ("train",)

    def check(self, columns: Columns) -> None:
        """Raise UsageError if windows of a field with these columns cannot be judged."""
        return

    @abstractmethod
    def reject(self, rows: Float32Array, columns: Columns, grid: FrameGrid) -> Reject | None:
        """Return why a window is left out, ``Reject(self.reason, detail=..., numbers=...)``; None if it is kept.

        Parameters
        ----------
        rows
            (L, D) rows of the window, not normalised, read-only.
        columns, grid
            Columns and rate of the rows.
        """


class Metric(Plugin):
    """Measures dances: numbers of each clip, and the scores of a set of clips from these.

    Attributes
    ----------
    source
        Where the definition is from: paper and equation, or repository and file.
    needs_music
        Whether `measure` needs the beats of the music.
    needs_pool
        Whether `summarise` compares the set with a pool of other clips, such as all ground truth.
    better
        What is better for each score: "higher", "lower", or "closer" to the ground truth's. Scores that are not named
        stand beside the others, such as a chance level.
    """

    source: ClassVar[str]
    needs_music: ClassVar[bool] = False
    needs_pool: ClassVar[bool] = False
    better: ClassVar[Mapping[str, Better]] = {}

    @property
    @abstractmethod
    def columns(self) -> tuple[str, ...]:
        """Names of the C numbers of a clip."""

    @abstractmethod
    def measure(self, dance: Dance) -> Float64Array:
        """Return the numbers of one clip, (C,), finite.

        Raises
        ------
        Undefined
            If the metric has no value for this clip. The clip is set aside and counted by its name.
        DataError
            If the joints cannot be measured: too few of them, for example.
        """

    def summarise(self, rows: Float64Array, pool: Float64Array | None = None) -> dict[str, float]:
        """Return the scores of a set: by default the mean of each column.

        Parameters
        ----------
        rows
            (N, C) numbers of the clips that have a value.
        pool
            (M, C) numbers of the pool, where `needs_pool`.

        Raises
        ------
        Undefined
            If there are too few clips.
        """
        if not len(rows):
            raise Undefined("few_clips", found="0 clips", allowed="at least 1")
        return dict(zip(self.columns, rows.mean(axis=0).tolist(), strict=True))


class Export(Plugin):
    """Writes a built dataset as the files that one trainer or program reads.

    Attributes
    ----------
    recipe
        Keys of a recipe whose datasets have all that the export needs, as in a recipe's YAML. Errors show them, and
        the conformance suite builds such a dataset.
    reference
        Repository and commit of the code that reads the files; "" where there is none.
    listed_folders
        Folders of which a loader opens every file: besides its own files nothing may be written there.
    """

    recipe: ClassVar[Mapping[str, Any]]
    reference: ClassVar[str] = ""
    listed_folders: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def lacks(self, job: ExportJob) -> list[Lack]:
        """Return everything that the dataset lacks for this export; nothing is written while there is something.

        `dancedata.exporting.needs` has the usual checks: fields, rates, splits, scope, names, music.
        """

    @abstractmethod
    def write(self, job: ExportJob, folder: ExportFolder) -> None:
        """Write the files. Called once `lacks` has returned nothing.

        Parameters
        ----------
        folder
            Its methods write files by their path below the folder of the export.
        """

    @abstractmethod
    def guide(self, job: ExportJob) -> str:
        """Return Markdown for the README of the export.

        The trainer's command, its caches that have to be removed, and where it is known to stop.
        """
