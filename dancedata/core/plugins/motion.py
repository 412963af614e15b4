"""Plug-ins on motion: datasets, contact rules, representations, key motion finders, window filters."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy.typing as npt

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins.plugin import Float32Array, Plugin
from dancedata.core.rotations import Float64Array
from dancedata.core.segments import Segment
from dancedata.core.skeleton import Skeleton
from dancedata.core.spatial import Spatial


class Dataset(Plugin):
    """Reader of a source folder: its clips, and the motion of each in canonical form.

    Attributes
    ----------
    licence, citation
        Text for the cards of datasets built from it.
    generates
        Whether `scan` writes a source that does not exist.
    explicit_only
        Whether it accepts many layouts, so that `check` takes it only by name, or where the folder has a listing.
    has_audio
        Whether clips have music; False where it was published as features alone.
    may_share_audio
        Whether the licence allows the music to be passed on, in a page or a video. False where that is unknown.
    may_share_motion
        Whether it allows what is made of the motion to be passed on, such as a built dataset. False where that is
        unknown.
    genre_ids
        The dataset's own number for each genre, for trainers that use it.
    """

    licence: ClassVar[str]
    citation: ClassVar[str]
    has_audio: ClassVar[bool] = True
    may_share_audio: ClassVar[bool] = False
    may_share_motion: ClassVar[bool] = False
    generates: ClassVar[bool] = False
    explicit_only: ClassVar[bool] = False

    @classmethod
    def has_listing(cls, source: Path) -> bool:
        """Whether the folder has a list of clips that is written for this reader."""
        return False

    @property
    def official_split(self) -> bool:
        """Whether the splits are published lists: what they share is then a note of `check`, not an error."""
        return False

    @property
    def genre_ids(self) -> Mapping[str, int]:
        """Number of each genre; empty where the dataset has none."""
        return {}

    def body_of(self, ref: ClipRef) -> Skeleton | None:
        """Return the body of the motion that `load` returns, without reading it; None if that is unknown.

        For keys of evaluations: motion that is transferred from it to another body has separate ones.
        """
        return None

    @abstractmethod
    def scan(self, source: Path) -> Scan:
        """List the clips. Reads no motion.

        Raises
        ------
        SourceError
            If the folder is not a copy of the dataset, or its lists are missing or contradict each other.
        """

    @abstractmethod
    def load(self, ref: ClipRef) -> Motion:
        """Read one clip: metres, radians, +Y up. DataError, with a reject's code, for anything wrong with it."""

    def time_of(self, ref: ClipRef) -> tuple[int, Fraction, int] | None:
        """Return frames, frames per second and trim_start of what `load` returns, by a header; None: load it."""
        return None

    def load_group(self, refs: Sequence[ClipRef]) -> list[Motion]:
        """Read the dancers of one group into one world; by default each by itself."""
        return [self.load(ref) for ref in refs]

    def segments(self, ref: ClipRef) -> Sequence[Segment]:
        """Return the spans and instants that the source states for a clip; by default `ClipRef.segments`.

        Reads no motion. Only those of the scan make a difference between two sources.
        """
        return ref.segments

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
        Axes of the columns and 6D convention, as text for dataset.json.
    spatial
        Roles of the columns when the dancer is turned or shifted, for augmentations of samples; None: samples cannot
        be turned or shifted.
    decodes
        Whether the class defines `decode`; set automatically.
    positions_only
        Whether `decode` returns a motion with the joint positions of the columns only, on bones of the
        clip: placement, facing, the body's bone lengths and twist are lost in `encode`.
    holds_places
        Whether its columns are the places of dancers, for representations without them beside it.
    """

    default_contacts: ClassVar[str | None] = None
    rate: ClassVar[Fraction | None] = None
    grounded: ClassVar[bool] = False
    axes: ClassVar[str]
    rotation_6d: ClassVar[str | None] = None
    spatial: ClassVar[Spatial | None] = None
    holds_places: ClassVar[bool] = False
    decodes: ClassVar[bool] = False
    positions_only: ClassVar[bool] = False

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
        """Encode a motion at its own rate.

        Parameters
        ----------
        motion
            +Y up, on a body of the skeleton's family; joints that the columns lack are left out.
        contacts
            Rule for the columns of contacts; None where there are none, or where they are the representation's own.

        Returns
        -------
        (T, D) float32

        Raises
        ------
        UsageError
            For another family of bodies, a missing rule, or one that is not needed.
        """

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode columns (T, D), not normalised, into a motion at the rate of `grid`, +Y up.

        Axis-angle vectors have a length of at most pi. Contacts are not part of a motion.

        Raises
        ------
        UsageError
            For another shape, or a representation that cannot be decoded.
        DataError
            "nan", or "bad_rotation" where columns do not hold a rotation.
        """
        raise UsageError(f"the representation {self.name} cannot be decoded", allowed="encoding")

    def floor(self, motion: Motion) -> float:
        """Return the height of the ground that `encode` takes off, metres; 0 where it leaves the dancer in place."""
        return 0.0

    def encode_above(self, motion: Motion, floor_m: float, contacts: ContactRule | None = None) -> Float32Array:
        """Return (T, D) columns with the ground at a height: dancers of a group have one, the least of `floor`."""
        if self.grounded:
            raise UsageError(f"the representation {self.name} takes each dancer of a group to the ground")
        return self.encode(motion, contacts)

    def reencode(self, motion: Motion, contacts: ContactRule | None = None) -> Float32Array:
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

    def placed(self, motion: Motion, rows: npt.ArrayLike) -> Motion:
        """Return a motion put where its dancer was, by columns that `holds_places`.

        Parameters
        ----------
        motion
            Decoded from columns without a place, of the same frames as `rows`, from any first frame on.
        rows
            (T, D) columns of this representation, not normalised.

        Returns
        -------
        Motion
            One turn about the vertical and one shift of the whole motion, by the first row.

        Raises
        ------
        UsageError
            For rows of another shape or number, and if the columns hold no places.
        """
        raise UsageError(f"the columns of {self.name} hold no places of dancers")


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
        """Return why a window is left out, ``Reject(self.reason, detail=..., numbers=...)``; None if it is kept.

        Parameters
        ----------
        rows
            (L, D) rows of the window, not normalised, read-only.
        columns, grid
            Columns and rate of the rows.
        """


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
