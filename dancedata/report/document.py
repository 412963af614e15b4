"""The document of a report, which has every number of its page, and its findings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import Any

from dancedata.core.text import counted, listed
from dancedata.pipeline.rejects import BY_CHOICE
from dancedata.report.groups import Groups, group_findings
from dancedata.report.markup import number, rounded
from dancedata.report.measure import ClipNumbers
from dancedata.report.outliers import Outlier
from dancedata.report.scaling import EXPLODES, ScaledGroup
from dancedata.report.space import DUPLICATE_M, Poses
from dancedata.report.stage import StageNumbers
from dancedata.report.tally import ClipHistogram, FiveNumbers, FrameHistogram, Quantiles
from dancedata.store.free_columns import FreeColumn
from dancedata.store.segment_numbers import LayerNumbers

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
    scope: str
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
class Still:
    """Share of frames of a clip with a speed below the limit, over clips; see `FiveNumbers`."""

    below_m_s: float
    min: float | None
    p25: float | None
    p50: float | None
    p75: float | None
    max: float | None


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
    """Key motions against the beats of one song.

    Attributes
    ----------
    shift_ms
        Mean offset on the circle of a beat; positive if the dance is late.
    strength
        Share of the phases that agree, 0 to 1.
    counts
        Key motions in the bins of `Music.offset_ms`.
    """

    song: str
    clips: int
    key_motions: int
    shift_ms: float
    strength: float
    counts: tuple[int, ...]

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
    """Every number of a report of one dataset; docs/report.md has the keys."""

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
    curation: Mapping[str, Any] = field(default_factory=dict)

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


#: Limits above which a difference between the contact of left and right is named, and a share of sliding frames.
_SIDES, _SLIDING = 0.1, 0.1
#: Height above which a floor is named, metres.
_FLOOR_M = 0.1
#: Ratio from which on the windows of the largest and the smallest genre are named.
_UNEVEN = 5


@dataclass(frozen=True)
class Finding:
    """A sentence.

    Attributes
    ----------
    kind
        "bad": an error of the dataset. "look": worth a look. "note": good to know.
    text
        The sentence.
    figure
        Key of the figure that shows it.
    """

    kind: str
    text: str
    figure: str


def findings(d: Document) -> list[Finding]:
    """Return the findings, errors first."""
    parts = (_splits, _quality, _movement, _outliers, _poses, _groups, _music, _contents, _fields)
    sentences = [finding for part in parts for finding in part(d)]
    return sorted(sentences, key=lambda f: ("bad", "look", "note").index(f.kind))


def _splits(d: Document) -> list[Finding]:
    sentences = []
    for kind, shared in (("song", d.splits.songs), ("clip", d.splits.clips)):
        for pair, names in shared.names.items():
            bad = "train" in pair.split(" and ")
            text = f"{pair} share {counted(len(names), kind)}: {listed(names, 4)}"
            sentences.append(Finding("bad" if bad else "note", text, f"shared_{kind}s"))
    return sentences


def _quality(d: Document) -> list[Finding]:
    sentences = []
    totals = d.totals
    if totals.flags:
        kinds = ", ".join(f"{kind} {n}" for kind, n in d.flags.by_kind.items())
        text = f"{counted(totals.flagged_clips, 'clip')} of {totals.clips:,} have quality flags: {kinds}"
        sentences.append(Finding("look", text, "flags"))
    if totals.left_out:
        for kind, by_choice in (("look", False), ("note", True)):
            entries = {name: entry for name, entry in d.left_out.items() if (name in BY_CHOICE) is by_choice}
            reasons = listed([f"{reason} {entry.n:,}" for reason, entry in entries.items()], 5)
            if entries:
                cause = "; files that were not downloaded are no error" if "missing_motion" in entries else ""
                sentences.append(Finding(kind, f"left out: {reasons}{cause}", "left_out"))
    return sentences


def _movement(d: Document) -> list[Finding]:
    moves = d.movement
    if moves.field is None:
        return [Finding("look", "movement was not measured: no field holds joints that can be read here", "about")]
    sentences = []
    contact = {name: share for name, share in moves.contact.items() if share is not None}
    for name, share in contact.items():
        right = contact.get(name.replace("left", "right", 1))
        if name.startswith("left") and right is not None and abs(share - right) > _SIDES:
            joint = name.removeprefix("left_")
            sides = f"{100 * share:.0f} % of the frames, the right in {100 * right:.0f} %"
            text = f"the left {joint} touches the ground in {sides}"
            sentences.append(Finding("look", text, "contact"))
    above = moves.sliding_m_s.share_above
    if above is not None and above > _SLIDING:
        limit = moves.sliding_m_s.above_m_s
        text = f"feet that are labelled as standing move faster than {limit} m/s in {100 * above:.0f} % of the frames"
        sentences.append(Finding("look", text, "sliding_m_s"))
    floor = moves.floor_m
    if max(abs(floor.min or 0), abs(floor.max or 0)) > _FLOOR_M:
        low, high = rounded(floor.min), rounded(floor.max)
        feet = f"the feet stand at {low} m" + (f" to {high} m" if high != low else "")
        text = f"the floor of {moves.field} is not at 0: {feet}"
        sentences.append(Finding("note", text, "floor_m"))
    return sentences


def _poses(d: Document) -> list[Finding]:
    n, pairs = d.poses.n_duplicates, d.poses.duplicates
    if not n:
        return []
    text = f"{counted(n, 'pair')} of windows in two splits nearer than {100 * DUPLICATE_M:g} cm"
    with_train = any("train" in pair.splits for pair in pairs)
    return [Finding("look" if with_train else "note", f"{text}: {' and '.join(pairs[0].clips)}", "duplicates")]


def _outliers(d: Document) -> list[Finding]:
    if not d.outliers:
        return []
    names = listed([outlier.clip for outlier in d.outliers], 3)
    return [Finding("look", f"{counted(len(d.outliers), 'clip')} unlike the others in movement: {names}", "outliers")]


def _groups(d: Document) -> list[Finding]:
    return [Finding(kind, text, "groups_list") for kind, text in group_findings(d.groups)]


def _music(d: Document) -> list[Finding]:
    sentences = []
    bas, chance = d.music.bas, d.music.bas_chance
    if bas is not None and chance is not None and bas <= chance * 1.1:
        text = f"the dance does not follow the beats: alignment {number(bas)}, by chance {number(chance)}"
        sentences.append(Finding("look", text, "bas"))
    shifted = [song for song in d.music.songs if song.is_shifted]
    if shifted:
        named = listed([f"{song.song} {song.shift_ms:+.0f} ms" for song in shifted], 4)
        text = f"{counted(len(shifted), 'song')} with dance late or early by more than {SHIFTED_MS:g} ms: {named}"
        sentences.append(Finding("look", text, "song_offsets"))
    tempos = d.music.tempo_bpm
    off = [t for t in tempos if abs(t.found / t.stated - 1) > 0.05]
    if off:
        text = f"{counted(len(off), 'clip')} of {len(tempos):,}: the tempo of the beats differs from the stated one"
        sentences.append(Finding("look", text, "tempo_pairs"))
    short = d.contents.music_minus_motion_s.shorter
    if short:
        text = f"{counted(len(short), 'clip')} with less music than motion: {listed(short, 3)}"
        sentences.append(Finding("look", text, "music_minus_motion_s"))
    return sentences


def _contents(d: Document) -> list[Finding]:
    sentences = [
        Finding("look", f"genres that are probably the same: {' and '.join(names)}", "windows_by_genre")
        for names in d.contents.alike
    ]
    sums = {name: sum(counts.values()) for name, counts in d.contents.windows_by_genre.items()}
    filled = {name: n for name, n in sums.items() if n}
    if len(filled) > 1 and max(filled.values()) >= _UNEVEN * min(filled.values()):
        most, least = max(filled, key=filled.__getitem__), min(filled, key=filled.__getitem__)
        text = f"genres are uneven: {most} has {filled[most]:,} windows, {least} {filled[least]:,}"
        sentences.append(Finding("note", text, "windows_by_genre"))
    return sentences


def _fields(d: Document) -> list[Finding]:
    sentences = []
    for name, of_field in d.fields.items():
        if of_field.constant:
            count = f"{len(of_field.constant)} of {of_field.width} columns of {name}"
            text = f"{count} never change: {listed(of_field.constant, 4)}"
            sentences.append(Finding("note", text, f"columns_{name}"))
        elif not of_field.columns and not of_field.rows:
            sentences.append(Finding("note", f"no statistics of {name}: there are no train windows", f"heat_{name}"))
        exploding = [label for group in of_field.scaling for label, _ in group.exploding]
        if exploding:
            count = f"{counted(len(exploding), 'column')} of {name}"
            text = f"{count} beyond ±{EXPLODES:g} when normalised: {listed(exploding, 4)}"
            sentences.append(Finding("look", text, f"scaling_{name}"))
    return sentences
