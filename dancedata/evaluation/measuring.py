"""Measures clips: one unit of work a clip, whose numbers are kept in the cache for all protocols that ask for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dancedata.core.clip import Reject
from dancedata.core.dance import Dance, MusicBeats, Undefined
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array
from dancedata.evaluation.inputs.clip import ClipInput
from dancedata.evaluation.music import ClipMusic, beats_after
from dancedata.evaluation.pose import Pose, in_axes, interpolated
from dancedata.evaluation.protocol import Measure, Pieces, Protocol, Role
from dancedata.execution.cache import Cache, package_version
from dancedata.execution.progress import Progress
from dancedata.execution.reference_process import expected
from dancedata.execution.units import Jobs, run_units
from dancedata.pipeline.rejects import reject_of
from dancedata.recipes.documents import document_of

__all__ = ["MeasuredClip", "Outcome", "measure_clips", "measure_pose"]

#: Raised by hand when a stage here gives other numbers for the same input.
EVALUATE_STAGE = 1
_STAGE = "evaluate"

#: Numbers of one piece, or the name of the outcome that a metric has instead.
Outcome = tuple[float, ...] | str


@dataclass(frozen=True)
class MeasuredClip:
    """The numbers of a clip.

    Attributes
    ----------
    clip
        Id that resampling draws by; several windows may share one.
    fps
        Rate that was measured.
    n_frames
        Frames of each piece.
    rows
        For each measure of the protocol the outcome of each piece; None where there is no music for it.
    notes
        What was changed before measuring.
    """

    id: str
    clip: str
    fps: str
    n_frames: tuple[int, ...]
    rows: tuple[tuple[Outcome, ...] | None, ...]
    notes: tuple[str, ...] = ()

    @property
    def grid(self) -> FrameGrid:
        """The rate as a grid."""
        return FrameGrid.of(self.fps)

    @property
    def seconds(self) -> list[float]:
        """Length of each piece."""
        return [float(self.grid.seconds(n)) for n in self.n_frames]


def measure_pose(protocol: Protocol, role: Role, pose: Pose, music: ClipMusic | None) -> list[Any]:
    """Measure a pose: return [rate, frames of pieces, outcomes by measure, notes], as the cache keeps it.

    Raises
    ------
    DataError
        If the protocol cannot measure this motion: other joints, another rate.
    """
    placed, notes = pose.conformed(protocol.motion)
    joints = in_axes(placed.joints, protocol.motion.up)
    cuts = protocol.pieces(role).of(len(joints), placed.grid)
    rows: list[list[Any] | None] = []
    for measure in protocol.measures:
        if measure.metric.needs_music and music is None:
            rows.append(None)
            continue
        rows.append([_outcome(measure, role, joints, placed.grid, cut, music) for cut in cuts])
    return [str(placed.grid), [length for _, length in cuts], rows, list(notes)]


def _outcome(
    measure: Measure, role: Role, joints: Float64Array, grid: FrameGrid, cut: tuple[int, int], music: ClipMusic | None
) -> list[float] | str:
    start, length = cut
    beats = None if music is None else beats_after(music.beats, start, grid)
    try:
        dance = _dance(measure, role, joints[start : start + length], grid, beats)
        numbers = measure.metric.measure(dance)
    except Undefined as error:
        return error.reason
    if not np.isfinite(numbers).all():
        return "not_finite"
    return [float(number) for number in numbers]


def _dance(
    measure: Measure, role: Role, joints: Float64Array, grid: FrameGrid, beats: MusicBeats | None
) -> Dance:
    if measure.fps is not None:
        target = FrameGrid.of(measure.fps)
        joints, grid = interpolated(joints, grid, target), target
    return Dance(joints[: measure.frames(role)], grid, beats)


def measure_clips(
    cache: Cache,
    protocol: Protocol,
    role: Role,
    clips: Sequence[ClipInput],
    music: Mapping[str, ClipMusic],
    *,
    jobs: Jobs,
    progress: Progress,
    label: str = "measuring",
) -> tuple[list[MeasuredClip], list[Reject]]:
    """Measure clips; those that cannot be measured are rejects.

    Parameters
    ----------
    music
        Beats by the id of a clip.
    """
    common = _common_key(protocol, role)
    ready, rejects, keys = [], [], []
    for clip in clips:
        try:
            keys.append(_key(cache, common, clip, music.get(clip.id)))
            ready.append(clip)
        except OSError as error:
            rejects.append(Reject("broken_file", clip=clip.id, detail=str(error)))
    known = [cache.json(_STAGE, key) for key in keys]
    calls = [(cache, key, clip, protocol, role, music.get(clip.id)) for key, clip in zip(keys, ready, strict=True)]
    found = run_units(measure_clip, calls, known=known, jobs=jobs, label=label, progress=progress)
    measured = []
    for clip, result in zip(ready, found, strict=True):
        if isinstance(result, Reject):
            rejects.append(result)
        else:
            measured.append(_measured(clip, result))
    return measured, rejects


def measure_clip(
    cache: Cache, key: str, clip: ClipInput, protocol: Protocol, role: Role, music: ClipMusic | None
) -> list[Any] | Reject:
    """Load and measure one clip, and publish the numbers: a unit of work."""
    try:
        found = measure_pose(protocol, role, clip.load(), music)
    except DataError as error:
        return reject_of(error, clip=clip.id)
    cache.put_json(_STAGE, key, found)
    return found


def _measured(clip: ClipInput, found: list[Any]) -> MeasuredClip:
    fps, lengths, rows, notes = found
    outcomes = tuple(
        None if row is None else tuple(piece if isinstance(piece, str) else tuple(piece) for piece in row)
        for row in rows
    )
    return MeasuredClip(clip.id, clip.clip, str(fps), tuple(lengths), outcomes, tuple(notes))


def _common_key(protocol: Protocol, role: Role) -> str:
    """Return the hash of what the numbers of all clips depend on."""
    pieces: Pieces = protocol.pieces(role)
    return Cache.key(
        _STAGE,
        version=EVALUATE_STAGE,
        motion=repr(protocol.motion),
        pieces=repr(pieces),
        measures=[
            [m.metric.name, m.metric.version, document_of(m.metric), m.fps, m.frames(role)] for m in protocol.measures
        ],
        packages={name: package_version(name) for name in ("numpy", "scipy")},
        arithmetic=expected(),
    )


def _key(cache: Cache, common: str, clip: ClipInput, music: ClipMusic | None) -> str:
    beats = None if music is None else [str(music.beats.grid), music.beats.frames.tolist()]
    return Cache.key(_STAGE, common=common, clip=clip.identity(cache), beats=beats)
