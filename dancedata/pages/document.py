"""The document of a report, which has every number of its page."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Any

from dancedata.core.clip import FreeColumn
from dancedata.core.segments import LayerNumbers
from dancedata.pages.bin_counts import ClipHistogram, FiveNumbers, FrameHistogram, Quantiles
from dancedata.pages.groups import Groups
from dancedata.pages.measure import ClipNumbers
from dancedata.pages.outliers import Outlier
from dancedata.pages.scaling import ScaledGroup
from dancedata.pages.stage import StageNumbers
from dancedata.scene.pose_space import Poses

#: Raised whenever a key of the document is removed or means something else.
SCHEMA = 1

#: Milliseconds from which on a song is named as shifted, least agreement of phases, and least key motions.
SHIFTED_MS, ALIGNED, _MIN_KEYS = 60.0, 0.4, 8
#: Windows by a name of their clip, then by split.
Counts = Mapping[str, Mapping[str, int]]


@dataclass(frozen=True)
class About:
    """The dataset and its origin, as dataset.json has them; None where it has not."""

    name: str
    dataset: str | None
    fps: str
    windows: Mapping[str, Any]
    licence: str | None
    citation: str | None
    dancedata: str | None
    recipe_sha256: str | None
    description: str
    notes: tuple[str, ...]
    skeleton: Mapping[str, Any]
    weights: Mapping[str, str]
    licences: tuple[str, ...] = ()


@dataclass(frozen=True)
class Totals:
    """Numbers of the whole dataset; clips without copies, windows with those of copies."""

    clips: int
    groups: int
    copies: int
    windows: int
    minutes: float
    songs: int
    dancers: int
    genres: int
    left_out: int
    flags: int
    flagged_clips: int


@dataclass(frozen=True)
class MusicGaps(ClipHistogram):
    """Seconds by which music is longer than motion, and the clips where it is shorter."""

    shorter: tuple[str, ...]


@dataclass(frozen=True)
class Contents:
    """Windows by split and name, and attributes of clips. `alike` has genres that differ only in spelling."""

    splits: tuple[str, ...]
    by_split: Mapping[str, Mapping[str, Any]]
    windows_by_split: Counts
    windows_by_genre: Counts
    windows_by_dancer: Counts
    windows_by_song: Counts
    alike: tuple[tuple[str, ...], ...]
    length_s: ClipHistogram
    tempo_bpm: ClipHistogram
    source_rates: Mapping[str, int]
    music_minus_motion_s: MusicGaps


@dataclass(frozen=True)
class Still(FiveNumbers):
    """Share of frames of a clip with a speed below the limit, over clips."""

    below_m_s: float


@dataclass(frozen=True)
class Sliding(FrameHistogram):
    """Horizontal speed of feet in contact, and the share of it above the limit."""

    above_m_s: float
    share_above: float | None


@dataclass(frozen=True)
class Movement:
    """Movement of the dancers, measured on the joints of `field`; None if no field has joints."""

    field: str | None
    joints: int
    speed_m_s: FrameHistogram
    joint_speed_m_s: Mapping[str, Quantiles]
    still: Still
    root_extent_m: ClipHistogram
    floor_m: ClipHistogram
    feet_m: FiveNumbers
    lowest_m: FiveNumbers
    highest_m: FiveNumbers
    turns: ClipHistogram
    contact: Mapping[str, float | None]
    sliding_m_s: Sliding
    paths_m: Mapping[str, tuple[tuple[float, float], ...]]
    stage: StageNumbers


@dataclass(frozen=True)
class Tempo:
    """Tempo of a clip: that of the dataset, and that of its beats."""

    clip: str
    stated: float
    found: float


@dataclass(frozen=True)
class SongShift:
    """Key motions against the beats of one song."""

    song: str
    clips: int
    key_motions: int
    shift_ms: float  # mean offset on the circle of a beat; positive if the dance is late
    strength: float  # share of the phases that agree, 0 to 1
    counts: tuple[int, ...]  # key motions in the bins of `Music.offset_ms`

    @property
    def is_shifted(self) -> bool:
        """Whether the music is probably at another time than the dance."""
        return abs(self.shift_ms) > SHIFTED_MS and self.strength > ALIGNED and self.key_motions >= _MIN_KEYS


@dataclass(frozen=True)
class Music:
    """Distances of key motions from beats, and from beats moved by half a period."""

    beats_from: str | None
    key_motions_from: str | None
    prominence_share: float
    key_motions: int
    offset_ms: FrameHistogram
    shifted_ms: FrameHistogram
    mean_distance_ms: float | None
    mean_distance_shifted_ms: float | None
    bas: float | None
    bas_chance: float | None
    tempo_bpm: tuple[Tempo, ...]
    songs: tuple[SongShift, ...]


@dataclass(frozen=True)
class Shared:
    """Names that each two splits have in common: their numbers, and the names of those that share any."""

    counts: Counts
    names: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Splits:
    """Songs, dancers and clips that splits share."""

    compared_by_sound: bool
    songs: Shared
    dancers: Shared
    clips: Shared


@dataclass(frozen=True)
class ColumnRange:
    """Range, quantiles and mean of a column over the rows of train windows; without a median for several columns."""

    label: str
    min: float
    p5: float
    p25: float
    p50: float | None
    p75: float
    p95: float
    max: float
    mean: float | None = None


@dataclass(frozen=True)
class FieldNumbers:
    """A field and the ranges of its columns; `constant` has the labels of columns that do not change."""

    kind: str
    width: int
    rate: str
    dtype: str
    axes: str | None
    groups: tuple[Mapping[str, Any], ...]
    rows: int
    constant: tuple[str, ...]
    columns: tuple[ColumnRange, ...]
    scaling: tuple[ScaledGroup, ...]


@dataclass(frozen=True)
class LeftOut:
    """Clips and files that were left out for one reason: number, names, and the first detail."""

    n: int
    names: tuple[str, ...]
    detail: str


@dataclass(frozen=True)
class Flags:
    """Numbers of quality flags."""

    by_kind: Mapping[str, int]
    by_joint: Mapping[str, int]


@dataclass(frozen=True)
class Suspect:
    """A clip to look at, and the value that is the reason."""

    clip: str
    why: str
    value: float


@dataclass(frozen=True)
class ClipRow:
    """A clip that is not a copy: its attributes, and what was measured."""

    clip: str
    split: str
    genre: str
    song: str
    dancer: str
    group: str
    member: int
    role: str
    slice_of: str
    frames: int
    windows: int
    flags: int
    tempo_stated: float | None
    source_rate: str
    trim_start: int
    numbers: ClipNumbers

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data; the path is in the section on movement."""
        row = {**asdict(self), **asdict(self.numbers)}
        return {key: value for key, value in row.items() if key not in ("numbers", "path")}


@dataclass(frozen=True)
class Document:
    """Every number of a report of one dataset; docs/reference/commands.md has the keys."""

    about: About
    totals: Totals
    contents: Contents
    movement: Movement
    groups: Groups
    music: Music
    splits: Splits
    poses: Poses
    outliers: tuple[Outlier, ...]
    fields: Mapping[str, FieldNumbers]
    left_out: Mapping[str, LeftOut]
    flags: Flags
    segments: tuple[LayerNumbers, ...]
    ranking: tuple[Suspect, ...]
    clips: tuple[ClipRow, ...]
    columns: tuple[FreeColumn, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {**_plain(self), "clips": [row.to_json() for row in self.clips]}


def _plain(value: Any) -> Any:
    """Return dataclasses and mappings as dicts, and tuples as lists."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, list | tuple) else value
