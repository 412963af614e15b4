"""Representation and ContactRule: the base classes of columns of motion, and of labels of contacts among them."""

from abc import abstractmethod
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal

import numpy.typing as npt

from dancedata.core.columns import Columns, Spatial
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins.plugin import Float32Array, Plugin
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton


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
    axes
        Axes of the columns, as text for dataset.json.
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
        """Return the (T, D) columns of a motion, +Y up, at its own rate.

        It is on a body of the skeleton's family; joints that the columns lack are left out. `contacts` is None where
        there are no columns of contacts, or where they are the representation's own. UsageError for another family of
        bodies, a missing rule, or one that is not needed.
        """

    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        """Decode columns (T, D), not normalised, into a motion at the rate of `grid`, +Y up.

        Axis-angle vectors have a length of at most pi. UsageError for another shape, or if nothing can be decoded;
        DataError "nan", or "bad_rotation" where columns do not hold a rotation.
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
        """Return (T, D) columns of a motion that `decode` returned and that was changed, at the columns' height.

        A representation that is `grounded` replaces this, as `encode` would move the dancer to the ground once more.
        """
        if self.grounded:
            raise UsageError(f"motion decoded from {self.name} loses its height above the floor if encoded again")
        return self.encode(motion, contacts)

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.decodes = cls.decode is not Representation.decode

    def placed(self, motion: Motion, rows: npt.ArrayLike) -> Motion:
        """Return a motion put where its dancer was: one turn about the vertical and one shift, by the first row.

        It was decoded from columns without a place, of the same frames as `rows`, (T, D) columns that `holds_places`,
        not normalised. UsageError for rows of another shape or number, and if they hold no places.
        """
        raise UsageError(f"the columns of {self.name} hold no places of dancers")


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
