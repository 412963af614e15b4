"""Takes: 1..n dancers in one world and one time; described here, loaded by workers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from dancedata.building.inputs import Music, RowsFile
from dancedata.core.clip import ClipRef
from dancedata.core.errors import error_note
from dancedata.core.grid import FrameGrid, WindowSpec
from dancedata.core.hashing import json_sha256
from dancedata.core.motion import Motion
from dancedata.core.plugin_files import plugin_file
from dancedata.core.plugins import Dataset, Plugin
from dancedata.core.quality import Flag
from dancedata.core.rejects import changed, require_same
from dancedata.core.segments import Segment
from dancedata.execution.cache import Cache
from dancedata.files.documents import clip_identity, content_hashes, document_of

if TYPE_CHECKING:
    import numpy.typing as npt

    from dancedata.core.columns import Columns

#: Up to this many values, motions remember matrices and joints: 200 MB.
_REMEMBERED = 2**23


@dataclass(frozen=True)
class Time:
    """Frames of a motion, their exact rate, and the first that belongs to the dance."""

    n_frames: int
    rate: Fraction
    trim: int = 0
    first: int = 0  # of a part, in the whole motion
    n_whole: int | None = None  # frames of the whole
    recorded: Fraction | None = None  # rate of the file, where it is another one

    @property
    def whole(self) -> Time:
        """The time of the whole motion."""
        return replace(self, n_frames=self.n_whole or self.n_frames, first=0, n_whole=None)

    @property
    def begin(self) -> Fraction:
        """The second of the whole motion at frame 0."""
        return self.first / self.rate

    @property
    def grid(self) -> FrameGrid:
        """The grid of the frames."""
        return FrameGrid(self.rate)

    @property
    def seconds(self) -> Fraction:
        """The length."""
        return self.n_frames / self.rate

    def frames_on(self, grid: FrameGrid) -> int:
        """Return the number of frames on another grid."""
        return self.grid.resampled_length(self.n_frames, grid)

    def trim_on(self, grid: FrameGrid) -> int:
        """Return the first frame of the dance on another grid."""
        return min(self.grid.rows_up(self.trim, of=grid), self.frames_on(grid) - 1)

    def part(self, start: int, stop: int) -> Time:
        """Return the time of frames start .. stop - 1."""
        trim = self.trim - start
        trim = trim if 0 < trim < stop - start else 0
        first, n_whole = self.first + start, self.n_whole or self.n_frames
        return replace(self, n_frames=stop - start, trim=trim, first=first, n_whole=n_whole)


@dataclass(frozen=True)
class Dancer:
    """A dancer of a take: the id to store it under, the clip on disk, and the state of its files."""

    id: str
    ref: ClipRef
    sha256: str  # of the motion file
    music: Music
    files: Mapping[str, RowsFile] = field(default_factory=dict)  # those with rows, by field
    made_of: str = ""  # as in `StoredClip`
    slice_of: str = ""


@dataclass(frozen=True)
class SourceReader:
    """A dataset's reader, and the hashes of the files that its parameters name."""

    dataset: Dataset
    content: Mapping[str, str]

    @cached_property
    def key(self) -> str:
        """Hash of all that shapes what it reads, except the clip."""
        dataset = self.dataset
        return json_sha256([dataset.name, dataset.version, document_of(dataset, loading=True), dict(self.content)])


@dataclass(frozen=True)
class Recording:
    """What a worker loads for a take: the motion files of its dancers. Copies and slices of it share one."""

    reader: SourceReader
    dancers: tuple[tuple[ClipRef, str], ...]

    @cached_property
    def key(self) -> str:
        """Hash of all that shapes what is loaded."""
        files = [[*clip_identity(ref), sha256] for ref, sha256 in self.dancers]
        group = self.dancers[0][0].group  # what changes its world draws by its name
        return Cache.key("recording", reader=self.reader.key, dancers=files, group=group)

    @property
    def path(self) -> Path:
        """A file of it, for messages."""
        return self.dancers[0][0].motion_path

    def load(self) -> Scenes:
        """Load the dancers into one world, cut to one length; DataError for one that cannot be loaded."""
        refs = tuple(ref for ref, _ in self.dancers)
        motions = [self.reader.dataset.load(refs[0])] if not refs[0].group else self.reader.dataset.load_group(refs)
        length, trim = min(m.n_frames for m in motions), max(m.trim_start for m in motions)
        cut = [m if m.n_frames == length else m.part(0, length) for m in motions]
        trim = min(trim, length - 1)
        cut = [m if m.trim_start == trim else replace(m, trim_start=trim) for m in cut]
        return Scenes(Scene(tuple(cut), refs, ((),) * len(cut)))

    def check(self, cache: Cache) -> None:
        """Raise DataError if a file has changed since it was hashed."""
        for ref, sha256 in self.dancers:
            require_same(ref.motion_path, sha256, cache.file_sha256)
        content = content_hashes(self.reader.dataset, cache.file_sha256)
        for named in sorted({*content, *self.reader.content}):
            if content.get(named) != self.reader.content.get(named):
                raise changed(f"{self.path} ({named})")


@dataclass(frozen=True)
class Take:
    """1..n dancers in one world and one time: what is known of them before they are loaded."""

    recording: Recording
    dancers: tuple[Dancer, ...]
    time: Time  # of its motion, all steps applied
    steps: tuple[Transform, ...] = ()  # transforms that make it of the recording
    parent: Take | None = None  # the take that it is a copy of
    group: str = ""  # "" for a single dancer

    @property
    def split(self) -> str:
        """Split of all its dancers."""
        return self.dancers[0].ref.split

    @property
    def name(self) -> str:
        """The group, or the single dancer."""
        return self.group or self.dancers[0].id

    @property
    def id(self) -> tuple[str, str]:
        """What tells it from all other takes; a group may have the name of a clip."""
        return self.group, "" if self.group else self.dancers[0].id

    @property
    def origin(self) -> Take:
        """Its parent, or itself."""
        return self.parent or self

    def then(self, step: Transform, **changes: Any) -> Take:
        """Return the take with one more step."""
        return replace(self, steps=(*self.steps, step), **changes)

    def copy(self, step: Transform, rename: Callable[[str], str], **changes: Any) -> Take:
        """Return a copy of the take, its dancers renamed."""
        dancers = tuple(replace(d, id=rename(d.id)) for d in changes.pop("dancers", self.dancers))
        group = rename(self.group) if self.group else ""
        return self.then(step, dancers=dancers, group=group, parent=self, **changes)

    @property
    def motion_steps(self) -> tuple[Transform, ...]:
        """The steps that change motion."""
        return tuple(step for step in self.steps if step.moves)

    @property
    def row_steps(self) -> tuple[Transform, ...]:
        """The steps that change rows."""
        return tuple(step for step in self.steps if step.changes_rows)

    def changed_rows(self, rows: npt.NDArray[Any], columns: Columns, kind: str, dancer: int) -> npt.NDArray[Any]:
        """Return (T, D) rows of a field after the steps that change rows."""
        for step in self.row_steps:
            rows = step.rows(rows, columns, kind, self, dancer)
        return rows


class RecipeField(Protocol):
    """A field of a recipe, as other plug-ins see it."""

    @property
    def name(self) -> str:
        """Name, which is unique."""

    @property
    def kind(self) -> str:
        """Kind in the dataset."""

    @property
    def columns(self) -> Columns:
        """The D columns."""

    @property
    def optional(self) -> bool:
        """Whether clips may be without it."""


class RecipePart(Plugin):
    """A plug-in of a recipe that has to fit its fields."""

    def check(self, fields: Sequence[RecipeField]) -> None:
        """Raise UsageError, which begins with its name, if it does not fit the fields of a recipe."""
        return

    def notes(self, splits: Collection[str]) -> Sequence[str]:
        """Return what `plan` and dataset.json say of it, for a source with these splits."""
        return ()


class Transform(RecipePart):
    """Take -> takes: changes motion and music, or makes a copy or several.

    Attributes
    ----------
    moves
        Whether `scene` changes motion.
    changes_rows
        Whether `rows` changes rows.
    keeps_time
        Whether windows of a copy are those of its parent.
    is_part
        Whether it takes a part of the motion: segments are those of the whole, changed by `segment`.
    keeps_original
        Whether a second field, NAME.original, is stored beside each motion field: the motion before this step.
    excerpts
        Windows of which features of music are computed alone; None: of the whole song.
    not_for_groups
        Why takes of several dancers cannot be changed; "" where they can.
    """

    moves: ClassVar[bool] = True
    changes_rows: ClassVar[bool] = False
    keeps_time: ClassVar[bool] = True
    is_part: ClassVar[bool] = False
    keeps_original: ClassVar[bool] = False
    not_for_groups: ClassVar[str] = ""
    excerpts: ClassVar[WindowSpec | None] = None

    def on(self, grid: FrameGrid) -> Transform:
        """Return the transform for a recipe of this rate; by default it is the same for all."""
        return self

    def expand(self, take: Take) -> Sequence[Take]:
        """Return the takes that replace one; by default, the take with this step."""
        return [take.then(self)]

    def scene(self, scene: Scene) -> Scene:
        """Change the loaded motion, in a worker."""
        return scene

    def rows(self, rows: npt.NDArray[Any], columns: Columns, kind: str, take: Take, dancer: int) -> npt.NDArray[Any]:
        """Change (T, D) rows of a field of a kind when they are written."""
        return rows

    def segment(self, segment: Segment, take: Take) -> Segment | None:
        """Return a segment of the parent in a copy; None if it has none."""
        return segment

    def key(self) -> list[Any]:
        """Return all that shapes what it does, as JSON."""
        return [self.name, self.version, document_of(self)]

    @cached_property
    def sha256(self) -> str:
        """Hash of `key`, of the files that parameters name, and of a local plug-in's own."""
        file = plugin_file(type(self))
        return json_sha256([*self.key(), content_hashes(self), "" if file is None else file.sha256])


@dataclass(frozen=True, eq=False)
class Scene:
    """The loaded motions of a take's dancers, their clips, and flags of what was done to each."""

    motions: tuple[Motion, ...]
    refs: tuple[ClipRef, ...]
    flags: tuple[tuple[Flag, ...], ...]

    def with_motions(self, motions: Sequence[Motion], flags: Sequence[Sequence[Flag]] = ()) -> Scene:
        """Return the scene with other motions, and further flags of each dancer."""
        further = flags or ((),) * len(motions)
        joined = tuple((*a, *b) for a, b in zip(self.flags, further, strict=True))
        return Scene(tuple(motions), self.refs, joined)

    def remembered(self) -> Scene:
        """Return the scene with matrices and joints remembered, if they are not too large."""
        motions = (m if m.is_cached or m.rotations.size * 3 > _REMEMBERED else m.with_cache() for m in self.motions)
        return replace(self, motions=tuple(motions))


class Scenes:
    """A loaded recording, and its scenes after steps: those on the way to the last one, which remembers its poses."""

    def __init__(self, scene: Scene) -> None:
        self._made: dict[tuple[str, ...], Scene] = {(): scene}
        self._last: tuple[tuple[str, ...] | None, Scene] = None, scene

    def after(self, steps: Sequence[Transform]) -> Scene:
        """Return the scene after steps, with matrices and joints remembered."""
        wanted = tuple(step.sha256 for step in steps)
        if self._last[0] == wanted:
            return self._last[1]
        self._made = {done: scene for done, scene in self._made.items() if done == wanted[: len(done)]}
        scene = self._made[()]
        self._last = None, scene
        with error_note(f"dancedata: after the transforms {', '.join(step.name for step in steps)}"):
            for n, step in enumerate(steps, 1):
                if wanted[:n] not in self._made:
                    self._made[wanted[:n]] = step.scene(scene)
                scene = self._made[wanted[:n]]
            self._last = wanted, scene.remembered()
        return self._last[1]
