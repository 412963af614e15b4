"""Bases of what a build is made of, beside transforms: fields, annotators, window rules."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from dancedata.building.inputs import RowsFile
from dancedata.building.result import Nothing, Result
from dancedata.building.take import RecipePart, Scene, Take, Transform
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.codebook import Codebook, DType
from dancedata.core.columns import Columns
from dancedata.core.grid import FrameGrid, WindowSpec
from dancedata.core.hashing import json_sha256
from dancedata.core.packages import package_version
from dancedata.core.plugins import Dataset, Plugin
from dancedata.core.segments import Segment
from dancedata.execution.arithmetic import expected
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs
from dancedata.files.documents import content_hashes, document_of

if TYPE_CHECKING:
    from dancedata.core.sided_words import Lexicon


class Loadable(Protocol):
    """Something that a worker loads once for all that is made of it."""

    @property
    def key(self) -> str:
        """Hash of its content."""

    @property
    def path(self) -> Path:
        """A file of it, for messages."""

    def load(self) -> Any:
        """Load it; DataError if it cannot be loaded."""

    def check(self, cache: Cache) -> None:
        """Raise DataError if it has changed since it was identified."""


class Ask(NamedTuple):
    """One result that a maker is asked for; parts of one source `within` the same scene are made together."""

    source: Loadable
    key: str
    part: Any = None
    offset: int = 0
    within: Any = None


@dataclass(frozen=True)
class Reach:
    """The frames [first, end) that a field covers, and what is said of windows beyond."""

    first: int
    end: int
    window: str = "short_field"  # reason of rejects of windows beyond
    clip: str = "too_short"  # of clips without any window
    beyond: str = ""  # of the window: "reaches beyond the end of song.wav"
    short: str = ""  # of the clip
    file: str = ""  # that ends too early; "" for the motion
    numbers: Mapping[str, float | int] = field(default_factory=dict)


class Maker(ABC):
    """Makes results of takes: rows of a field, or segments. All are computed, cached and shared in one way."""

    stage: ClassVar[str]  # folder of its results in the cache
    suffix: ClassVar[Literal["npy", "json"]]  # arrays, or JSON data

    @property
    def batch(self) -> int:
        """Results at most that are computed before they are published; a killed build loses at most these."""
        return 128

    @property
    def lane(self) -> str:
        """Makers of one lane run together, a network alone; "" where results are the same on every processor."""
        return ""

    @property
    @abstractmethod
    def id(self) -> str:
        """What tells it from all other makers of a recipe."""

    @property
    @abstractmethod
    def sha256(self) -> str:
        """Hash of all that shapes its results, beside the source and the part."""

    def workers(self, jobs: int) -> int:
        """Return how many processes run its lane, of `jobs`."""
        return jobs

    @abstractmethod
    def asks(self, take: Take) -> Sequence[Ask]:
        """Return what is asked for each dancer, or nothing at all; equal keys are computed once."""

    @abstractmethod
    def make(self, loaded: Any, parts: Sequence[Any]) -> Sequence[Any]:
        """Return an array or JSON data, or Nothing, for each part of what was loaded. DataError rejects them all."""

    def motion_ask(self, take: Take, dancer: int, steps: Sequence[Transform]) -> Ask:
        """Return what is asked of a take's motion: of its recording, after steps."""
        within = tuple(step.sha256 for step in steps)
        of = {"maker": self.sha256, "recording": take.recording.key, "steps": within, "dancer": dancer}
        return Ask(take.recording, Cache.key(self.stage, **of), (steps, dancer), within=within)


#: Of the kinds of fields: the attribute of `StoredClip` with their rows.
_STORED_AS = {"motion": "motion", "keymotion": "motion", "audio": "audio"}


class Field(RecipePart, Maker):
    """A field: rows on a grid; plug-ins of motion derive from `building.fields.motion.SceneField`."""

    suffix = "npy"
    slot: ClassVar[str] = "fields"  # key of a recipe under which it is named
    name: str  # type: ignore[misc]  # unique: that of the plug-in, or PLUGIN.NAME
    grid: FrameGrid
    kind: Literal["motion", "keymotion", "audio"] = "motion"  # "audio" is shared by a song's clips
    dtype: DType = "float32"
    codebook: Codebook | None = None  # None for real values
    optional: bool = False  # whether clips that it cannot take are kept without rows
    without: tuple[str, ...] = ()  # names of transforms that it is made without, such as repairs
    holds_places: bool = False  # whether its columns are the places of dancers
    from_files: bool = False  # whether rows may begin before frame 0
    needs_music: bool = False  # whether every clip has decoded music
    unit: str = "clips"  # what a result is of: "clips", "songs", "files"
    axes: str = ""  # text for dataset.json
    packages: Sequence[str] = ()  # that shape the numbers, beside numpy and scipy
    about: Mapping[str, Any] = MappingProxyType({})  # its network, for dataset.json; not part of any key

    def on(self, grid: FrameGrid) -> Field:
        """Return the field for a recipe of this rate."""
        return self

    @property
    @abstractmethod
    def columns(self) -> Columns:
        """The D columns."""

    @property
    def id(self) -> str:
        """What tells it from all other makers of a recipe."""
        return f"field {self.name}"

    @property
    def stored_as(self) -> str:
        """Attribute of `StoredClip` with its rows; key motions are beside motion."""
        return _STORED_AS[self.kind]

    @property
    def plugins(self) -> Mapping[str, Plugin]:
        """The plug-ins that a recipe names for it, by kind and name."""
        return {f"field {self.name}": self}

    @property
    def description(self) -> str:
        """What the card of a dataset says of it."""
        return f"{self.columns.width} columns"

    def document(self) -> dict[str, Any]:
        """Return all parameters, defaults included, as in a recipe."""
        return document_of(self)

    def resolved(self, hash_file: Callable[[Path], str]) -> Field:
        """Return the field with everything fixed that depends on this machine, see `AudioFeature.resolved`."""
        return self

    def require_whole(self, windows: WindowSpec) -> None:
        """Raise UsageError unless windows begin and end at rows of the field."""
        for what, frames in (("length", windows.length), ("stride", windows.stride)):
            windows.grid.rows(frames, of=self.grid, what=f"windows: the {what} for field {self.name}")

    @abstractmethod
    def block(self, rows: Any, take: Take, dancer: int, grid: FrameGrid) -> Any:
        """Return what is stored of a dancer's `Rows`, or `Nothing`; `grid` is that of the recipe."""

    def with_path(self, ref: ClipRef, source: Path) -> ClipRef:
        """Return a clip with its file of this field, if the field has any."""
        return ref

    def file_of(
        self, cache: Cache, ref: ClipRef, hash_file: Callable[[Cache, Path], str]
    ) -> RowsFile | Reject | None:
        """Return the file of a clip beside motion and music, or why it cannot be used; None where there is none."""
        return None

    def not_for_groups(self, fields: Sequence[Field]) -> str:
        """Return why takes of several dancers cannot have it, beside these fields; "" if they can."""
        return ""

    @abstractmethod
    def n_rows(self, take: Take, dancer: int) -> int:
        """Return the number of rows of a result, by lengths alone."""

    @abstractmethod
    def reach(self, take: Take, dancer: int, grid: FrameGrid) -> Reach | Reject:
        """Return the frames of a grid that the field covers, or why a dancer cannot have it; of lengths alone."""


class Annotator(Plugin, Maker):
    """Finds segments of the dancers of a take, of their motion.

    Attributes
    ----------
    copies
        What a copy gets: "own" found in its motion, the "parent"'s changed by the step, or "none".
    stored
        Whether segments are stored, or only judge windows.
    lexicons
        Words that change with the sides of the body, for texts of mirrored dancers.
    """

    stage = "segments"
    suffix = "json"
    copies: ClassVar[Literal["own", "parent", "none"]] = "parent"
    stored: ClassVar[bool] = True
    lexicons: ClassVar[tuple[Lexicon, ...]] = ()

    @property
    def id(self) -> str:
        """What tells it from all other makers of a recipe."""
        return f"annotator {self.name}"

    @cached_property
    def sha256(self) -> str:
        """Hash of name, version and parameters, with the files that these name."""
        return maker_hash(self.name, self.version, document_of(self), content_hashes(self))

    def asks(self, take: Take) -> Sequence[Ask]:
        """Return what is asked for each dancer: of slices that of the whole, of copies only what is their own."""
        if take.parent is not None and self.copies != "own":
            return []
        steps = [step for step in take.motion_steps if not step.is_part]
        return [self.motion_ask(take, k, steps) for k in range(len(take.dancers))]

    def make(self, loaded: Any, parts: Sequence[Any]) -> Sequence[Any]:
        """Return the rows of dancers of one scene."""
        of_dancers = self.annotate(loaded.after(parts[0][0]))
        return [of_dancers[k] for _, k in parts]

    @abstractmethod
    def annotate(self, scene: Scene) -> list[list[Any]]:
        """Return JSON rows of each dancer."""

    def flags(self, rows: Sequence[Any]) -> Sequence[dict[str, Any]]:
        """Return the quality flags among a dancer's JSON rows, as JSON."""
        return ()

    def measured(self, rows: Sequence[Any]) -> Mapping[str, Any]:
        """Return what a dancer's JSON rows say of the clip: attributes of `StoredClip`."""
        return {}

    @abstractmethod
    def segments(self, rows: Sequence[Any], take: Take, dancer: int) -> list[Segment]:
        """Return the segments in a dancer's JSON rows, which are () where nothing was asked for."""


@dataclass(frozen=True)
class Seen:
    """What a rule judges by: a take with its rows, segments of each dancer, and the grid and length of windows."""

    result: Result
    fields: Sequence[Field]
    grid: FrameGrid
    length: int
    segments: Sequence[Sequence[Segment]]

    def field(self, name: str) -> Field:
        """Return a field by its name."""
        return {field.name: field for field in self.fields}[name]

    def rows(self, name: str, dancer: int) -> npt.NDArray[Any]:
        """Return the rows of a field from frame 0 on, as stored, NaN before music that begins later; else (0, D)."""
        chosen, take = self.field(name), self.result.take
        stored = self.result.made[chosen.id][dancer]
        if isinstance(stored, Nothing):
            return np.empty((0, chosen.columns.width), dtype=chosen.dtype)
        rows = np.asarray(stored.array)
        if stored.offset < 0:
            rows = np.concatenate([np.full((-stored.offset, chosen.columns.width), np.nan), rows])
        return take.changed_rows(rows[max(0, stored.offset) :], chosen.columns, chosen.kind, dancer)


class WindowRule(RecipePart):
    """Leaves out windows, or dancers, by segments or rows.

    Attributes
    ----------
    of_group
        Whether a window goes if the rule names it for "any" dancer, or only for "all".
    annotators
        Those whose segments it reads; a build has them without a recipe that names them.
    """

    of_group: ClassVar[Literal["any", "all"]] = "any"
    annotators: ClassVar[tuple[Annotator, ...]] = ()

    @property
    def parameters(self) -> Plugin:
        """The plug-in whose keys a recipe has."""
        return self

    @abstractmethod
    def judge(self, seen: Seen, dancer: int, starts: Sequence[int]) -> list[Reject]:
        """Return rejects of windows of a dancer, or of the dancer, which name no window."""


class StartFinder(Plugin):
    """Finds the second of the music at frame 0 of clips."""

    @abstractmethod
    def find(
        self, cache: Cache, dataset: Dataset, scan: Scan, asked: Sequence[ClipRef], *, jobs: Jobs, progress: Progress
    ) -> Scan:
        """Return a scan with the offsets of the clips `asked`; those of unknown ones are rejects."""


def maker_hash(*values: Any) -> str:
    """Return the hash of what shapes results of motion, with the packages and instructions that compute them."""
    return json_sha256([*values, {name: package_version(name) for name in ("numpy", "scipy")}, expected()])
