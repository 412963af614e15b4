"""The fields of a dataset: made once from the recipe, used by all later stages."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import SMPLX52
from dancedata.core.codebook import Codebook, DType
from dancedata.core.columns import Columns
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid, WindowGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import AudioFeature, ContactRule, KeyMotionFinder, Representation
from dancedata.recipes.documents import document_of

Kind = Literal["motion", "keymotion", "audio"]
_FINGERS = frozenset(SMPLX52.joints[22:])


@dataclass(frozen=True)
class WindowSpec(WindowGrid):
    """Windows in frames of a grid."""

    grid: FrameGrid

    @property
    def length_s(self) -> float:
        """Length in seconds."""
        return float(self.grid.seconds(self.length))

    @property
    def stride_s(self) -> float:
        """Stride in seconds."""
        return float(self.grid.seconds(self.stride))

    def numbers(self, starts: tuple[int, ...]) -> tuple[int, ...]:
        """Return the numbers of windows among all those of their clip, from their first frames."""
        return tuple(map(self.number, starts))

    def document(self) -> dict[str, Any]:
        """Return all keys, defaults included."""
        return {"length_frames": self.length, "stride_frames": self.stride}


@dataclass(frozen=True)
class FieldSpec(ABC):
    """One field: its name, the grid of its rows, and the plug-in that makes it.

    `name`: The plug-in's name, or PLUGIN.NAME where a recipe has several of one plug-in.
    `grid`: Grid of the rows.
    `optional`: Whether clips whose motion the plug-in cannot take are kept, without rows of this field; never of
        music.
    """

    kind: ClassVar[Kind]

    name: str
    grid: FrameGrid
    optional: bool = field(default=False, kw_only=True)

    @property
    @abstractmethod
    def columns(self) -> Columns:
        """The D columns."""

    @property
    def dtype(self) -> DType:
        """Type on disk."""
        return "float32"

    @property
    def codebook(self) -> Codebook | None:
        """The codebook of a field of codes; None for real values."""
        return None

    @property
    def stored_kind(self) -> Kind:
        """Kind of the field in a dataset."""
        return self.kind

    @property
    def holds_places(self) -> bool:
        """Whether its columns are the places of dancers, for fields without them."""
        return False

    @abstractmethod
    def document(self) -> dict[str, Any]:
        """Return all parameters, defaults included, as in a recipe."""

    def require_whole(self, windows: WindowSpec) -> None:
        """Raise UsageError unless windows begin and end at rows of the field."""
        for what, frames in (("length", windows.length), ("stride", windows.stride)):
            windows.grid.rows(frames, of=self.grid, what=f"windows: the {what} for field {self.name}")


@dataclass(frozen=True)
class FieldOfMotion(FieldSpec):
    """A field that is encoded of the motion of a dancer.

    `grounded`: Whether rows are relative to a floor, which the dancers of a group share.
    `placeless`: Whether columns have no places: those of dancers anywhere would be equal.
    """

    grounded: ClassVar[bool] = False
    placeless: ClassVar[bool] = False

    @property
    @abstractmethod
    def plugin(self) -> Representation | KeyMotionFinder:
        """The plug-in."""

    @property
    @abstractmethod
    def version(self) -> tuple[int, int]:
        """Versions of the plug-in and of its contact rule, 0 without one."""

    def require(self, motion: Motion) -> None:
        """Raise DataError for motion that lacks joints without which rows would say nothing."""

    def floor(self, motion: Motion) -> float:
        """Return the height of a dancer's ground, metres."""
        return 0.0

    @abstractmethod
    def encode(self, motion: Motion) -> npt.NDArray[np.float32]:
        """Return (T, D) rows of a motion at the field's rate."""

    def encode_above(self, motion: Motion, floor_m: float) -> npt.NDArray[np.float32]:
        """Return the rows of a dancer of a group whose ground is at a height, metres."""
        return self.encode(motion)


@dataclass(frozen=True)
class MotionField(FieldOfMotion):
    """A field that follows from a clip's motion: a representation with its contact rule.

    `without`: Names of the transforms that it is made without, such as repairs.
    """

    kind: ClassVar[Literal["motion"]] = "motion"

    representation: Representation
    contacts: ContactRule | None
    without: tuple[str, ...] = ()

    @property
    def columns(self) -> Columns:
        """The representation's columns."""
        return self.representation.columns

    @property
    def plugin(self) -> Representation:
        """The representation."""
        return self.representation

    @property
    def version(self) -> tuple[int, int]:
        """Versions of representation and contact rule."""
        return self.representation.version, 0 if self.contacts is None else self.contacts.version

    @property
    def repaired(self) -> bool:
        """Whether it goes through all transforms."""
        return not self.without

    def document(self) -> dict[str, Any]:
        """Return the representation's parameters, the contact rule, and whether it is optional."""
        document = {**document_of(self.representation), "optional": self.optional}
        if self.contacts is not None:
            document["contacts"] = {self.contacts.name: document_of(self.contacts)}
        return document

    def encode_above(self, motion: Motion, floor_m: float) -> npt.NDArray[np.float32]:
        """Return the rows of a dancer of a group whose ground is at a height, metres."""
        return self.representation.encode_above(motion, floor_m, contacts=self.contacts)

    @property
    def grounded(self) -> bool:  # type: ignore[override]
        """Whether rows are relative to a floor."""
        return self.representation.grounded

    @property
    def placeless(self) -> bool:  # type: ignore[override]
        """Whether columns have no places."""
        spatial = self.representation.spatial
        return spatial is not None and spatial.placeless

    @property
    def holds_places(self) -> bool:
        """Whether its columns are the places of dancers."""
        return self.representation.holds_places

    def require(self, motion: Motion) -> None:
        """Raise DataError for a field with fingers where the motion has none: they would not move.

        The hands of SMPL's 24 joints, jaw and eyes are not required: few captures have them.
        """
        fingers = [joint for joint in self.representation.skeleton.joints if joint in _FINGERS]
        if fingers and not _FINGERS & set(motion.skeleton.joints):
            joints = f"{motion.skeleton.n_joints} joints, without {fingers[0]} and {len(fingers) - 1} more"
            raise DataError(f"the motion has no fingers, which {self.representation.name} has",
                            reason="missing_joints", found=joints)  # fmt: skip

    def floor(self, motion: Motion) -> float:
        """Return the height of a dancer's ground, metres."""
        return self.representation.floor(motion)

    def encode(self, motion: Motion) -> npt.NDArray[np.float32]:
        """Return (T, D) columns of a motion at the field's rate."""
        return self.representation.encode(motion, contacts=self.contacts)


@dataclass(frozen=True)
class KeyMotionField(FieldOfMotion):
    """A field with a clip's key motions."""

    kind: ClassVar[Literal["keymotion"]] = "keymotion"

    finder: KeyMotionFinder

    @property
    def columns(self) -> Columns:
        """The finder's columns."""
        return self.finder.columns

    @property
    def plugin(self) -> KeyMotionFinder:
        """The finder."""
        return self.finder

    @property
    def version(self) -> tuple[int, int]:
        """Version of the finder; 0 for the contact rule that it does not have."""
        return self.finder.version, 0

    def document(self) -> dict[str, Any]:
        """Return the finder's parameters, and whether the field is optional."""
        return {**document_of(self.finder), "optional": self.optional}

    def encode(self, motion: Motion) -> npt.NDArray[np.float32]:
        """Return (T, D) rows of a motion at the recipe's rate."""
        return self.finder.analyse(motion)


@dataclass(frozen=True)
class FeatureJob(FieldSpec):
    """A field of music, and all that units of work need to compute it: of whole songs, or of windows.

    `windows`: Windows in frames of the recipe of which rows are computed alone; None: of whole songs.
    `own_rate`: Whether `grid` was given for this field, not for the whole recipe.
    """

    kind: ClassVar[Kind] = "audio"

    feature: AudioFeature
    windows: WindowSpec | None = None
    own_rate: bool = False

    @property
    def columns(self) -> Columns:
        """The feature's columns."""
        return self.feature.columns

    @property
    def dtype(self) -> DType:
        """The feature's type on disk."""
        return self.feature.dtype

    @property
    def codebook(self) -> Codebook | None:
        """The feature's codebook."""
        return self.feature.codebook

    @property
    def stored_kind(self) -> Kind:
        """Motion for rows that describe the dancer, else audio."""
        return "motion" if self.feature.of_motion else "audio"

    @property
    def window_rows(self) -> int:
        """Rows of a window."""
        return self.window_spec.grid.rows_down(self.window_spec.length, of=self.grid)

    def document(self) -> dict[str, Any]:
        """Return the feature's parameters, and the rate if it is the field's own."""
        document = document_of(self.feature)
        return {**document, "fps": str(self.grid)} if self.own_rate else document

    def window_length(self, samples: FrameGrid) -> int:
        """Return the length of a window in samples, rounded down."""
        return self.window_spec.grid.rows_down(self.window_spec.length, of=samples)

    def window_start(self, number: int, samples: FrameGrid) -> int:
        """Return the first sample of a window, rounded down."""
        return self.window_spec.grid.rows_down(self.window_spec.start(number), of=samples)

    @property
    def window_spec(self) -> WindowSpec:
        """The windows; UsageError for a field of whole songs."""
        if self.windows is None:
            raise UsageError("a field of whole songs has no windows", where=self.name)
        return self.windows
