"""One pass over a dataset, clip by clip: the numbers of each clip, and counts over all frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import BODY_JOINTS
from dancedata.core.dance import Dance, Undefined
from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton
from dancedata.kernel import Clip, Progress, Store
from dancedata.metrics.beats import BeatAlignment, nearest_offsets
from dancedata.metrics.body import bone_spread, floor_drift
from dancedata.pages.bin_counts import BinCounts
from dancedata.pages.groups import MeasuredGroups, trimmed
from dancedata.pages.stage import Stage
from dancedata.scene.figure import Figure
from dancedata.scene.pieces import ClipReader, Piece, measured_units
from dancedata.scene.pose_space import Space

#: A body whose joints move less than this on average, metres per second, stands still.
STILL_M_S = 0.05
#: A foot joint with a contact label that moves sideways faster than this slides.
SLIDE_M_S = 0.15
#: Points of a clip's path that are kept.
_PATH_POINTS = 96
#: Key motions are minima at least this deep, as a share of the clip's highest speed.
PROMINENT = 0.03


@dataclass(frozen=True)
class ClipNumbers:
    """Numbers of one clip; None where it has no value."""

    seconds: float = 0.0  # length of what was measured
    # `speed`, `speed_p95`: mean and 95 % quantile, over frames, of the mean speed of the joints;
    # metres per second
    speed: float | None = None
    speed_p95: float | None = None
    still: float | None = None  # share of frames below STILL_M_S
    # `root_extent_m`, `root_path_m`: larger of the two horizontal extents of the root's path, and the length of the
    # path
    root_extent_m: float | None = None
    root_path_m: float | None = None
    # `floor_m`, `feet_m`, `low_m`, `high_m`: Floor, from the toes in contact (see `floor_height`); 2 % quantile of
    # the heights of the feet; lowest and highest joint
    floor_m: float | None = None
    feet_m: float | None = None
    low_m: float | None = None
    high_m: float | None = None
    turns: float | None = None  # largest difference between two directions that the hips face, in full turns
    sliding: float | None = None  # share of the frames of feet in contact in which they slide
    # `key_motions`, `key_beat_ms`, `key_shifted_ms`: number of key motions; their mean distance to the nearest beat,
    # and to the nearest of the beats moved by half a period, milliseconds
    key_motions: int = 0
    key_beat_ms: float | None = None
    key_shifted_ms: float | None = None
    # `bas`, `bas_chance`: beat alignment score and its chance level; see `BeatAlignment`
    bas: float | None = None
    bas_chance: float | None = None
    tempo_found: float | None = None  # 60 / median distance of beats, beats per minute
    music_s: float | None = None  # length of the music from the first frame on
    floor_drift_m: float | None = None  # largest difference of the lowest foot joints of two stretches of 2 s
    below_floor_m: float | None = None  # depth of the lowest joint below the floor
    jerk: float | None = None  # mean over joints and frames of the third derivative, metres per cubic second
    bone_spread_m: float | None = None  # largest range of the length of a bone, 1 to 99 %
    path: tuple[tuple[float, float], ...] = ()  # (P, 2) root on the floor, metres, relative to its first position


@dataclass
class SongOffsets:
    """Offsets of key motions from the beats of one song."""

    clips: int = 0
    # milliseconds after the nearest beat
    tally: BinCounts = field(default_factory=lambda: BinCounts.of(-400, 400, 0.5))
    phase: complex = 0j  # sum of the offsets as phases of the beat: ``exp(2 pi i offset / period)``
    period_s: float = 0.0  # sum of the beat periods of the offsets

    def add(self, offsets: Float64Array, piece: Piece) -> None:
        """Count the offsets of a piece's key motions, in seconds."""
        times = piece.beat_times
        if times is None or len(times) < 2 or not len(offsets):
            return
        period = float(np.median(np.diff(times)))
        self.clips += 1
        self.tally.add(offsets * 1000)
        self.phase += complex(np.exp(2j * np.pi * offsets / period).sum())
        self.period_s += period * len(offsets)

    @property
    def shift_ms(self) -> float | None:
        """Mean offset on the circle of a beat, milliseconds; positive if the dance is late."""
        n = self.tally.n
        return float(np.angle(self.phase) / (2 * np.pi) * self.period_s / n * 1000) if n else None

    @property
    def strength(self) -> float:
        """Share of the phases that agree: 1 if all offsets are equal, about 0 if dance and beats are unrelated."""
        return abs(self.phase) / self.tally.n if self.tally.n else 0.0


@dataclass
class Measured:
    """A dataset's numbers: those of clips, and counts over the frames of all."""

    reader: ClipReader
    windows: Mapping[str, int]  # number of windows of each clip
    # numbers of each clip that is not a copy of another one; slices that overlap have none
    clips: dict[str, ClipNumbers] = field(default_factory=dict)
    # `joints`, `feet`: names of the joints whose speed is counted, and of foot joints with stored contacts
    joints: tuple[str, ...] = ()
    feet: tuple[str, ...] = ()
    speed: BinCounts = field(default_factory=lambda: BinCounts.of(0, 12, 0.01))
    song_offsets: dict[str, SongOffsets] = field(default_factory=dict)
    split_speed: dict[str, BinCounts] = field(default_factory=dict)
    joint_speed: dict[str, BinCounts] = field(default_factory=dict)
    sliding: BinCounts = field(default_factory=lambda: BinCounts.of(0, 6, 0.01))
    offset_ms: BinCounts = field(default_factory=lambda: BinCounts.of(-400, 400, 0.5))
    shifted_ms: BinCounts = field(default_factory=lambda: BinCounts.of(-400, 400, 0.5))
    # frames in contact and all frames, by foot joint, (F, 2)
    contact: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    groups: MeasuredGroups = field(default_factory=MeasuredGroups)
    space: Space | None = None
    stage: Stage = field(default_factory=Stage)

    @property
    def store(self) -> Store:
        """The dataset."""
        return self.reader.store


def measure(store: Store, progress: Progress | None = None) -> Measured:
    """Measure the clips of a dataset; copies that augmentations made, and overlapping slices, are only counted."""
    windows = {clip.id: store[clip.id].windows() for clip in store}
    measured = Measured(ClipReader.of(store), {clip: len(of_clip) for clip, of_clip in windows.items() if of_clip})
    measured.space = space = Space.of(store, windows)
    measured.clips = {clip.id: ClipNumbers() for clip in store if not clip.source}
    units = measured_units(store)
    with (progress or Progress(quiet=True)).stage("measuring clips", len(units)) as advance:
        for dancers in units:
            pieces = {clip.id: piece for clip in dancers if (piece := measured.reader.piece(clip)) is not None}
            for clip in dancers:
                if clip.id in pieces:
                    measured.clips[clip.id] = _clip(measured, clip, pieces[clip.id])
                    space.add(clip, pieces[clip.id], windows[clip.id])
            if dancers[0].group:
                # Without the field of one dancer, nothing is measured between them.
                together = list(pieces.values()) if len(pieces) == len(dancers) else []
                measured.groups.add(store, dancers, together, len(windows[dancers[0].id]))
            advance(1)
    return measured


def clip_numbers(piece: Piece) -> ClipNumbers:
    """Measure a whole clip that belongs to no dataset."""
    part = _Part.of(piece, piece.figure.grid, 0)
    return _numbers(part) if len(part.speed) else ClipNumbers()


def _clip(measured: Measured, clip: Clip, piece: Piece) -> ClipNumbers:
    part = _Part.of(piece, measured.store.grid, clip.trim_start)
    if not len(part.speed):
        return ClipNumbers()
    _count(measured, part, clip)
    return _numbers(part)


@dataclass(frozen=True, eq=False)
class _Part:
    """A piece, measured."""

    piece: Piece
    figure: Figure  # its joints and contacts without the trim
    names: tuple[str, ...]
    speed: Float64Array  # (T - 1, J) metres per second
    sliding: Float64Array  # horizontal speeds of feet in contact in this frame and the next, (n,)
    contact: npt.NDArray[np.int64]  # (F, 2) frames in contact and all frames
    facing: Float64Array
    key_motions: int
    # `offsets`, `shifted`: seconds from the nearest beat to each key motion; the same with beats moved by half a
    # period
    offsets: Float64Array
    shifted: Float64Array

    @classmethod
    def of(cls, piece: Piece, grid: FrameGrid, trim_start: int) -> _Part:
        """Measure a clip from frame `trim_start` on, counted on the grid of the store."""
        figure, names = trimmed(piece, grid, trim_start), piece.figure.skeleton.joints
        body = [j for j, name in enumerate(names) if name in BODY_JOINTS] or list(range(len(names)))
        sliding, contact = _sliding(figure)
        times = _key_times(piece, piece.figure.n_frames - figure.n_frames)
        beats = piece.beat_times
        middles = None if beats is None else np.asarray((beats[:-1] + beats[1:]) / 2)  # the chance control
        return cls(
            piece=piece,
            figure=figure,
            names=tuple(names[j] for j in body),
            speed=np.linalg.norm(np.diff(figure.joints[:, body], axis=0), axis=2) * piece.rate,
            sliding=sliding,
            contact=contact,
            facing=_facing(figure.joints, names),
            key_motions=len(times),
            offsets=_offsets(times, beats),
            shifted=_offsets(times, middles),
        )


def physics(joints: Float64Array, rate: float, skeleton: Skeleton) -> tuple[float, float, float]:
    """Return the drift of the floor, the jerk and the spread of bone lengths of joints (T, J, 3)."""
    jerk = float(np.linalg.norm(np.diff(joints, 3, axis=0), axis=2).mean()) * rate**3 if len(joints) > 3 else 0.0
    return floor_drift(joints, rate, skeleton), jerk, bone_spread(joints, skeleton)


def _sliding(figure: Figure) -> tuple[Float64Array, npt.NDArray[np.int64]]:
    """Return horizontal speeds of feet that touch the ground in two frames, and counts of frames (F, 2)."""
    if not figure.contacts_stored:
        return np.zeros(0), np.zeros((0, 2), dtype=np.int64)
    labels, feet = figure.contacts, list(figure.contact_joints)
    steps = np.diff(figure.joints[:, feet][..., (0, 2)], axis=0)
    speed = np.linalg.norm(steps, axis=2) * float(figure.grid.rate)
    counts = np.stack([labels.sum(axis=0), np.full(len(feet), len(labels))], axis=1).astype(np.int64)
    return speed[labels[:-1] & labels[1:]], counts


def _key_times(piece: Piece, first: int) -> Float64Array:
    """Return the instants of a piece's prominent key motions, seconds: a body is slowest between two frames."""
    key = piece.key
    deep = (key.prominence > PROMINENT * key.curve.max(initial=0.0)) & (key.minima >= first)
    return np.asarray((key.minima[deep] + 0.5) / piece.rate, dtype=np.float64)


def _offsets(times: Float64Array, beats: Float64Array | None) -> Float64Array:
    """Return time - nearest beat for each of `times`; nothing without beats."""
    if beats is None or not len(beats) or not len(times):
        return np.zeros(0)
    return nearest_offsets(times, beats)


def _facing(joints: Float64Array, names: Sequence[str]) -> Float64Array:
    """Return the direction that the hips face about +Y, radians, unwrapped; nothing without hips."""
    if "left_hip" not in names or "right_hip" not in names:
        return np.zeros(0)
    across = joints[:, names.index("left_hip")] - joints[:, names.index("right_hip")]
    return np.unwrap(np.arctan2(across[:, 2], across[:, 0]))


def _alignment(part: _Part) -> tuple[float, float] | tuple[None, None]:
    """Return the beat alignment score and its chance level; None where it is undefined."""
    joints, grid, beats = part.figure.joints, part.figure.grid, part.piece.beats
    if beats is None or joints.shape[1] < len(BODY_JOINTS):
        return None, None
    metric = BeatAlignment(joints=len(BODY_JOINTS))
    try:
        after = beats.after(part.piece.figure.n_frames - len(joints), grid)
        score, chance = metric.measure(Dance(joints, grid, after)).tolist()
    except Undefined:
        return None, None
    return score, chance


def _count(measured: Measured, part: _Part, clip: Clip) -> None:
    if not measured.joint_speed:
        figure = part.piece.figure
        measured.feet = tuple(figure.skeleton.joints[j] for j in figure.contact_joints) if len(part.contact) else ()
        measured.contact = np.zeros((len(measured.feet), 2), dtype=np.int64)
        measured.joints = part.names
        measured.joint_speed = {name: BinCounts.of(0, 16, 0.01) for name in part.names}
    measured.speed.add(part.speed.mean(axis=1))
    measured.split_speed.setdefault(clip.split, BinCounts.of(0, 12, 0.01)).add(part.speed.mean(axis=1))
    for k, name in enumerate(part.names):
        measured.joint_speed[name].add(part.speed[:, k])
    measured.sliding.add(part.sliding)
    measured.offset_ms.add(part.offsets * 1000)
    if clip.music:
        measured.song_offsets.setdefault(clip.music, SongOffsets()).add(part.offsets, part.piece)
    measured.shifted_ms.add(part.shifted * 1000)
    measured.contact += part.contact
    piece, root = part.piece, part.figure.joints[:, 0]
    begin = (piece.figure.n_frames - len(root)) / piece.rate
    seconds = begin - clip.trim_start / float(measured.store.grid.rate) + np.arange(len(root)) / piece.rate
    measured.stage.add(part.names, part.speed, root, part.facing, np.maximum(seconds, 0.0))


def _numbers(part: _Part) -> ClipNumbers:
    piece, figure = part.piece, part.figure
    speed, roots = part.speed.mean(axis=1), figure.joints[:, 0, (0, 2)]
    periods = np.zeros(0) if piece.beats is None else np.diff(piece.beats.frames) / float(piece.beats.grid.rate)
    low, high = float(figure.joints[..., 1].min()), float(figure.joints[..., 1].max())
    drift, jerk, spread = physics(figure.joints, piece.rate, figure.skeleton)
    score, chance = _alignment(part)
    return ClipNumbers(
        seconds=len(roots) / piece.rate,
        speed=float(speed.mean()),
        speed_p95=float(np.quantile(speed, 0.95)),
        still=float((speed < STILL_M_S).mean()),
        root_extent_m=float(np.ptp(roots, axis=0).max()),
        root_path_m=float(np.linalg.norm(np.diff(roots, axis=0), axis=1).sum()),
        floor_m=figure.floor,
        feet_m=figure.lowest,
        low_m=low,
        high_m=high,
        turns=float(np.ptp(part.facing)) / (2 * np.pi) if len(part.facing) else None,
        sliding=float((part.sliding > SLIDE_M_S).mean()) if len(part.sliding) else None,
        key_motions=part.key_motions,
        key_beat_ms=float(np.abs(part.offsets).mean() * 1000) if len(part.offsets) else None,
        key_shifted_ms=float(np.abs(part.shifted).mean() * 1000) if len(part.shifted) else None,
        bas=score,
        bas_chance=chance,
        tempo_found=float(60 / np.median(periods)) if len(periods) else None,
        music_s=piece.music_s,
        floor_drift_m=round(drift, 6),
        below_floor_m=round(figure.floor - low, 6),
        jerk=round(jerk, 6),
        bone_spread_m=round(spread, 6),
        path=_thinned(roots - roots[0]),
    )


def _thinned(path: Float64Array) -> tuple[tuple[float, float], ...]:
    """Return at most _PATH_POINTS points of a path, first and last among them."""
    kept = np.unique(np.linspace(0, len(path) - 1, min(len(path), _PATH_POINTS)).round().astype(int))
    return tuple((round(float(x), 3), round(float(z), 3)) for x, z in path[kept])
