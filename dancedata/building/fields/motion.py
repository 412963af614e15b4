"""Fields of motion: representations, and those that a plug-in makes of all dancers of a take."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from dancedata.building.plugins import Ask, Field, Reach, maker_hash
from dancedata.building.result import Nothing, Rows
from dancedata.building.rows import stored_rows
from dancedata.building.take import Take
from dancedata.core.bodies import CROSSING, SMPLX52
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Plugin, Representation
from dancedata.core.text import shown
from dancedata.core.typing import override
from dancedata.files.documents import content_hashes, document_of

if TYPE_CHECKING:
    from dancedata.store.stored_clip import LazyArray

#: Raised by hand when the stage gives other numbers for the same motion.
_STAGE = 6
_FINGERS = frozenset(SMPLX52.joints[22:])
T = TypeVar("T")
#: Rows (T, D), or why a clip has none.
Encoded = npt.NDArray[np.float32] | Nothing


class MotionField(Field):
    """Rows of the motion of each dancer of a take, all in one scene."""

    stage = "motion"
    without: tuple[str, ...] = ()  # names of transforms

    @property
    def hashed_values(self) -> list[Any]:
        """Names and versions of the plug-ins that shape rows."""
        return [self.name, self.version]

    @cached_property
    def sha256(self) -> str:
        """Hash of all that shapes the rows of a motion."""
        files = [content_hashes(plugin) for plugin in self.plugins.values()]
        return maker_hash(_STAGE, CROSSING, self.slot, *self.hashed_values, self.document(), str(self.grid), files)

    @override
    def block(self, rows: Rows | Nothing, take: Take, dancer: int, grid: FrameGrid) -> LazyArray:
        return stored_rows(rows, self, take, dancer)

    @override
    def asks(self, take: Take) -> Sequence[Ask]:
        steps = [step for step in take.motion_steps if step.name not in self.without]
        return [self.motion_ask(take, k, steps) for k in range(len(take.dancers))]

    @override
    def n_rows(self, take: Take, dancer: int) -> int:
        return take.time.frames_on(self.grid)

    @override
    def reach(self, take: Take, dancer: int, grid: FrameGrid) -> Reach:
        beyond = f"ends after the last of the rows at {self.grid} per second"
        return Reach(0, self.grid.rows_down(take.time.frames_on(self.grid), of=grid), beyond=beyond)

    @override
    def make(self, loaded: Any, parts: Sequence[Any]) -> Sequence[Encoded]:
        scene = loaded.after(parts[0][0])
        motions = [self.nothing_on_error(partial(self._on_grid, motion)) for motion in scene.motions]
        return self.encoded(motions, [k for _, k in parts], in_group=bool(scene.refs[0].group))

    @abstractmethod
    def encoded(
        self, motions: Sequence[Motion | Nothing], dancers: Sequence[int], *, in_group: bool
    ) -> list[Encoded]:
        """Return the rows of some dancers of a scene, whose motions are at the field's rate."""

    def require(self, motion: Motion) -> None:
        """Raise DataError for motion that lacks joints without which rows would say nothing."""

    def _on_grid(self, motion: Motion) -> Motion:
        if self.optional:
            self.require(motion)
        return motion.resampled(self.grid)

    def nothing_on_error(self, call: Callable[[], T]) -> T | Nothing:
        """Return the result of a call; Nothing where an optional field cannot take a motion."""
        try:
            return call()
        except (DataError, UsageError) as error:  # the latter where a plug-in cannot take the skeleton
            if not self.optional:
                raise
            return Nothing(str(error))


@dataclass(frozen=True, kw_only=True)
class SceneField(MotionField):
    """A plug-in of a recipe's `fields`: it has `columns`, and encodes the motion of all dancers of a take.

    Attributes
    ----------
    fps
        Rows per second: a number, or a fraction such as "30000/1001"; None: the recipe's.
    optional
        Whether clips that it cannot take are kept without rows.
    """

    fps: Any = None
    optional: bool = False

    @override
    def on(self, grid: FrameGrid) -> SceneField:
        return replace(self, fps=str(grid if self.fps is None else FrameGrid.of(self.fps)))

    @cached_property
    def grid(self) -> FrameGrid:  # type: ignore[override]
        """Grid of the rows."""
        return FrameGrid.of(self.fps)

    @abstractmethod
    def encode(self, motions: Sequence[Motion]) -> Sequence[npt.NDArray[np.float32]]:
        """Return rows (T, D) of each dancer of a take, whose motions are of one length, at the field's rate."""

    @override
    def encoded(
        self, motions: Sequence[Motion | Nothing], dancers: Sequence[int], *, in_group: bool
    ) -> list[Encoded]:
        lost = [motion for motion in motions if isinstance(motion, Nothing)]
        present = [motion for motion in motions if not isinstance(motion, Nothing)]
        rows: Any = lost[0] if lost else self.nothing_on_error(partial(self.encode, present))
        if isinstance(rows, Nothing):
            return [rows for _ in dancers]
        if not isinstance(rows, Sequence | np.ndarray) or len(rows) != len(present):
            answer = f"{len(rows)} arrays" if isinstance(rows, Sequence | np.ndarray) else type(rows).__name__
            raise UsageError(f"the field {self.name} does not give each dancer rows", found=answer,
                             allowed=f"a list of {len(present)} arrays", fix="correct the plug-in")  # fmt: skip
        return [self._as_stored(np.asarray(rows[k])) for k in dancers]

    def _as_stored(self, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return rows in the field's type; UsageError if that changes a code, or for what is not a real number."""
        wrong = str(rows.dtype)
        if rows.dtype.kind in "biuf":
            with np.errstate(invalid="ignore"):  # a code that is NaN
                stored = rows.astype(self.dtype)
            if self.codebook is None or np.array_equal(stored, rows):
                return stored
            wrong = shown(rows[stored != rows][0])
        raise UsageError(f"the field {self.name} gives values that its type cannot hold", found=wrong,
                         allowed=self.dtype, fix="correct the plug-in")  # fmt: skip


@dataclass(frozen=True)
class RepresentationField(MotionField):
    """A representation of each dancer, with its contact rule; those of a group stand on one floor."""

    slot = "motion"

    name: str  # type: ignore[misc]
    grid: FrameGrid
    representation: Representation
    contacts: ContactRule | None = None
    without: tuple[str, ...] = ()
    optional: bool = False

    columns = property(attrgetter("representation.columns"))
    axes = property(attrgetter("representation.axes"))
    holds_places = property(attrgetter("representation.holds_places"))

    @property
    @override
    def plugins(self) -> Mapping[str, Plugin]:
        contacts = {} if self.contacts is None else {f"contacts {self.contacts.name}": self.contacts}
        return {f"motion {self.name}": self.representation, **contacts}

    @property
    @override
    def description(self) -> str:
        rule = f", contacts by {self.contacts.name}" if self.contacts is not None else ""
        return f"{self.columns.width} columns, {self.axes}{rule}"

    @property
    @override
    def hashed_values(self) -> list[Any]:
        contacts = 0 if self.contacts is None else self.contacts.version
        return [self.representation.name, (self.representation.version, contacts)]

    @override
    def document(self) -> dict[str, Any]:
        document = {**document_of(self.representation), "optional": self.optional}
        if self.contacts is not None:
            document["contacts"] = {self.contacts.name: document_of(self.contacts)}
        return document

    @override
    def not_for_groups(self, fields: Sequence[Field]) -> str:
        # Dancers in different places would have equal columns.
        spatial = self.representation.spatial
        if spatial is None or not spatial.placeless or self.grid in {f.grid for f in fields if f.holds_places}:
            return ""
        return (
            f"its columns have no places: store them beside it, motion: {{root_place: {{fps: {self.grid}}}}}, or "
            "choose a representation that has them, such as edge151"
        )

    @override
    def require(self, motion: Motion) -> None:
        """Raise DataError for a field with fingers where the motion has none; hands, jaw and eyes may be missing."""
        fingers = [joint for joint in self.representation.skeleton.joints if joint in _FINGERS]
        if fingers and not _FINGERS & set(motion.skeleton.joints):
            joints = f"{motion.skeleton.n_joints} joints, without {fingers[0]} and {len(fingers) - 1} more"
            raise DataError(f"the motion has no fingers, which {self.representation.name} has",
                            reason="missing_joints", found=joints)  # fmt: skip

    @override
    def encoded(
        self, motions: Sequence[Motion | Nothing], dancers: Sequence[int], *, in_group: bool
    ) -> list[Encoded]:
        floor = self._floor(motions) if in_group else None
        return [self._encoded(motions[k], floor) for k in dancers]

    def _encoded(self, motion: Motion | Nothing, floor: float | None) -> Encoded:
        if isinstance(motion, Nothing):
            return motion
        plugin, rule = self.representation, self.contacts
        if floor is None:
            return self.nothing_on_error(lambda: np.asarray(plugin.encode(motion, contacts=rule)))
        return self.nothing_on_error(lambda: np.asarray(plugin.encode_above(motion, floor, contacts=rule)))

    def _floor(self, motions: Sequence[Motion | Nothing]) -> float | None:
        """Return the floor of a group, of the dancers that the field can take; None where rows have none."""
        if not self.representation.grounded:
            return None
        present = [m for m in motions if not isinstance(m, Nothing)]
        floors = [self.nothing_on_error(partial(self.representation.floor, m)) for m in present]
        return min((height for height in floors if not isinstance(height, Nothing)), default=0.0)
