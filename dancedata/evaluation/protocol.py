"""Protocols as data: joints, rate, pieces, metrics, music and published figures.

A published number means something only together with all of these. A protocol derives from `Protocol`, has no
parameters and is registered under a name, in one file (docs/tutorials/add-your-own.md).
"""

from collections.abc import Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Literal

from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import Metric, Plugin
from dancedata.core.registry import METRICS
from dancedata.core.registry import PROTOCOLS as PROTOCOLS  # where plug-ins look for it

#: Clips are ground truth or come from a model: some protocols cut the two differently.
Role = Literal["truth", "generated"]
ROLES: tuple[Role, ...] = ("truth", "generated")
#: Bodies that a protocol may require: SMPL's 24 joints, the first 24 of SMPL-X or all 55, the 22 that both share.
Body = Literal["smpl24", "smplx24", "smplx55", "body22"]

_MS = FrameGrid.of(1000)
#: Longest piece, seconds: eleven days.
_MAX_S = 1_000_000


@dataclass(frozen=True)
class MotionRule:
    """The joints that a protocol measures.

    Attributes
    ----------
    body
        "smpl24": SMPL's joints. "smplx24": the first 24 joints of SMPL-X, whose last two are jaw and left eye.
        "smplx55": all joints of SMPL-X.
        "body22": the 22 joints that both share, on the dancer's own bones.
    fps
        Frames per second. Motion at a whole multiple is decimated, other rates are refused. None: any rate, but one
        for all clips.
    up
        Axis that points up in the coordinates that metrics get.
    turned
        Whether they are turned by 90 degrees about z after that: (x, y, z) becomes (-y, x, z).
    pelvis
        "any": constant shifts do not change the numbers. "body": the pelvis has to lie where the body has it.
        "translation": it is at SMPL's translation, as in EDGE's kinematics, which omit its rest position.
    """

    body: Body
    fps: int | None
    up: Literal["y", "z"] = "y"
    turned: bool = False
    pelvis: Literal["any", "body", "translation"] = "any"

    def __post_init__(self) -> None:
        _ = self.grid  # UsageError for an invalid rate

    @property
    def grid(self) -> FrameGrid | None:
        """The grid of the frames; None for any."""
        return None if self.fps is None else FrameGrid.of(self.fps)


@dataclass(frozen=True)
class Pieces:
    """Pieces of a clip that are measured: by default the whole clip.

    Attributes
    ----------
    skip
        Frames at the beginning that are not measured, such as the seed of a model.
    first
        Largest number of frames after these; None: all.
    length, stride
        Length and distance of pieces, frames; None: one piece. Clips shorter than a piece have none.
    seconds
        Instead of `length` and `stride`, both in seconds, for protocols of any rate: lengths and first frames are
        rounded down.
    shorter
        Whether a clip shorter than `length` is one piece.
    multiple
        Pieces are shortened to a multiple of this number of frames.
    """

    skip: int = 0
    first: int | None = None
    length: int | None = None
    stride: int | None = None
    seconds: tuple[float, float] | None = None
    shorter: bool = False
    multiple: int = 1

    def __post_init__(self) -> None:
        for name, least in (("skip", 0), ("first", 1), ("length", 1), ("stride", 1), ("multiple", 1)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise UsageError(f"invalid value for {name} of pieces", found=value, allowed=f"{least} and above")
        if (self.length is None) != (self.stride is None):
            raise UsageError("pieces have only one of length and stride", allowed="both, or neither for whole clips")
        if self.seconds is not None and (self.length is not None or not all(0 < s <= _MAX_S for s in self.seconds)):
            found = f"seconds {self.seconds}, length {self.length}"
            allowed = f"above 0, to {_MAX_S:,}, without length"
            raise UsageError("invalid seconds of pieces", found=found, allowed=allowed)

    def of(self, n_frames: int, grid: FrameGrid) -> list[tuple[int, int]]:
        """Return first frame and length of each piece of a clip."""
        n = max(0, n_frames - self.skip)
        n = n if self.first is None else min(n, self.first)
        length, stride = self.frames(grid)
        if length is None or stride is None or (self.shorter and n < length):
            cuts = [(0, n)] if n else []
        else:
            starts = [k * stride for k in range(n // stride + 1)]
            if self.seconds is not None:  # a stride that is rounded down would drift
                starts = [_MS.rows_down(k * round(1000 * self.seconds[1]), of=grid) for k in range(len(starts))]
            cuts = [(start, length) for start in starts if start + length <= n]
        whole = [(self.skip + start, size - size % self.multiple) for start, size in cuts]
        return [cut for cut in whole if cut[1]]

    def frames(self, grid: FrameGrid) -> tuple[int | None, int | None]:
        """Return length and stride in frames of a grid."""
        if self.seconds is None:
            return self.length, self.stride
        length, stride = (_MS.rows_down(round(1000 * s), of=grid) for s in self.seconds)
        if length < 1 or stride < 1:
            raise UsageError("the frame rate is too low for pieces of this length", found=str(grid))
        return length, stride

    @property
    def identity(self) -> str:
        """Key of the cuts, for the cache and for pools."""
        return repr(self) + "; exact starts" * (self.seconds is not None)

    def __str__(self) -> str:
        """Text of the cut of clips, for tables: "5 s every 2.5 s", "the first 1,200 frames", "whole clips"."""
        parts = []
        if self.seconds is not None:
            parts.append(f"pieces of {self.seconds[0]:g} s every {self.seconds[1]:g} s")
        elif self.length is not None:
            parts.append(f"pieces of {self.length:,} frames every {self.stride:,}")
        if self.skip:
            parts.append(f"frames {self.skip:,} and later")
        if self.first is not None:
            parts.append(f"the first {self.first:,} frames")
        if self.multiple > 1:
            parts.append(f"cut to multiples of {self.multiple}")
        return ", ".join(parts) or "whole clips"


@dataclass(frozen=True)
class Measure:
    """One metric of a protocol.

    Attributes
    ----------
    metric
        The metric with its variant.
    fps
        Joint positions are interpolated linearly to this rate first; None: as they are.
    steady
        Instead, they are taken at 120 frames per second by `dancedata.metrics.root.steady`, so that numbers do not
        depend on the clip's rate.
    first, first_generated
        Largest number of frames of a piece that are measured: of every piece, and of generated motion; None: all.
    """

    metric: Metric
    fps: int | None = None
    first: int | None = None
    first_generated: int | None = None
    steady: bool = False

    def frames(self, role: Role) -> int | None:
        """Return the largest number of frames of a piece that are measured; None: all."""
        limits = [self.first, self.first_generated if role == "generated" else None]
        return min((n for n in limits if n is not None), default=None)


@dataclass(frozen=True)
class MusicRule:
    """Source of the beats of the music.

    Attributes
    ----------
    features
        Audio features that have them, in the group "beat"; the first one that a store has is used, and the first of
        all is computed from music files.
    fps
        Rate of their rows. None: as stored, or the motion's.
    by_piece
        Whether they are found in each piece by itself, not in whole songs.
    tempo
        Whether the beat tracker starts from the tempo that the dataset states.
    about
        How the original finds beats, where that differs.
    """

    features: tuple[str, ...] = ("librosa35",)
    fps: int | None = None
    by_piece: bool = False
    tempo: bool = True
    about: str = ""

    def __post_init__(self) -> None:
        _ = self.grid  # UsageError for a rate that is none

    @property
    def grid(self) -> FrameGrid | None:
        """Grid of the rows; None for any."""
        return None if self.fps is None else FrameGrid.of(self.fps)


@dataclass(frozen=True)
class PaperResult:
    """A row of a published table that belongs to a protocol.

    Attributes
    ----------
    what
        "ground truth", or the name of a model.
    values
        Figures by the names of scores.
    source
        Paper and table, repository or thread.
    note
        Known facts of its computation.
    dataset, splits
        Reader and splits of the ground truth, which is compared with that dataset alone; empty for models, and where
        that is not known.
    """

    what: str
    values: Mapping[str, float]
    source: str
    note: str = ""
    dataset: str = ""
    splits: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle as its arguments: mappings that are read-only cannot be pickled."""
        return type(self), (self.what, dict(self.values), self.source, self.note, self.dataset, self.splits)


@dataclass(frozen=True)
class Protocol(Plugin):
    """Base of protocols: everything that a number depends on, except the motion.

    A protocol with a metric of groups measures groups; its other metrics are means over the dancers of a group.

    Attributes
    ----------
    citation
        Citation of the metrics.
    source
        Repository, commit and files, or paper and section.
    licence_note
        Licence of that code. None of it is in this package unless stated.
    motion
        Joints, rate and axes.
    truth, generated
        Pieces of ground truth and of the clips of a model.
    pool_split
        Split of a dataset that is the pool, where none is chosen; "all", or one that it lacks: the whole dataset.
    measures
        The metrics, in the order of the table.
    music
        Source of the beats of music; None without beat metrics.
    published
        Figures published under the protocol.
    notes
        Remarks for readers of its numbers.
    not_computable
        Scores of the published tables that dancedata cannot compute, and why.
    """

    citation: ClassVar[str]
    source: ClassVar[str]
    licence_note: ClassVar[str] = ""
    motion: ClassVar[MotionRule]
    truth: ClassVar[Pieces] = Pieces()
    generated: ClassVar[Pieces] = Pieces()
    pool_split: ClassVar[str] = "train"
    measures: ClassVar[tuple[Measure, ...]]
    music: ClassVar[MusicRule | None] = None
    published: ClassVar[tuple[PaperResult, ...]] = ()
    notes: ClassVar[tuple[str, ...]] = ()
    not_computable: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def __post_init__(self) -> None:
        missing = [name for name in ("citation", "source", "motion", "measures") if not hasattr(self, name)]
        if missing:
            raise UsageError(f"the protocol lacks {', '.join(missing)}", where=self.name, fix="see Protocol")

    def pieces(self, role: Role) -> Pieces:
        """Return the cut of the clips of a role."""
        return self.truth if role == "truth" else self.generated

    @property
    def of_groups(self) -> bool:
        """Whether groups are measured, not single dancers."""
        return any(measure.metric.of_groups for measure in self.measures)

    @property
    def label(self) -> str:
        """Name and version, as a pool is keyed: "bailando-aistpp, version 1"."""
        return f"{self.name}, version {self.version}"


def with_metrics(protocol: Protocol, names: Iterable[str]) -> Protocol:
    """Return a protocol with further metrics after its own, by their names; UsageError for one that does not fit.

    They get the joints, rate and pieces of the protocol and their default parameters. Names that the protocol has, of
    metrics or scores, and unknown ones are skipped.
    """
    taken = {name for measure in protocol.measures for name in (measure.metric.name, *measure.metric.better)}
    metrics = [METRICS.make(name, {}) for name in dict.fromkeys(names) if name not in taken and name in METRICS]
    for metric in metrics:
        if metric.of_groups and not protocol.of_groups:
            raise UsageError(f"the metric {metric.name} measures groups, and the protocol single dancers",
                             where=f"protocol {protocol.name}",
                             fix="choose a protocol of groups, see dancedata info protocols")  # fmt: skip
    if not metrics:
        return protocol
    extended = copy(protocol)
    object.__setattr__(extended, "measures", (*protocol.measures, *map(Measure, metrics)))
    if protocol.music is None and any(metric.needs_music for metric in metrics):
        object.__setattr__(extended, "music", MusicRule())
    return extended


def protocol_named(protocol: str | Protocol) -> Protocol:
    """Return a protocol by its name; UsageError with the closest one for an unknown name."""
    named: Protocol = PROTOCOLS.get(protocol)() if isinstance(protocol, str) else protocol
    return named
