"""Measurement of clips in the joints, axes and rate of a protocol, one unit of work each.

Numbers are cached by metric, for all protocols that share them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from dancedata.core.bodies import BODY_JOINTS, CROSSING, SMPLX55, has_body, transfer
from dancedata.core.clip import Reject
from dancedata.core.dance import Dance, MusicBeats, Undefined
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import Metric
from dancedata.core.rejects import reject_of
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed
from dancedata.evaluation.clips import ClipSet
from dancedata.evaluation.music import ClipMusic, Resources
from dancedata.evaluation.protocol import Measure, MotionRule, Protocol, Role
from dancedata.files.documents import document_of
from dancedata.kernel import Cache, run_units
from dancedata.metrics.root import STEADY_FPS, steady
from dancedata.scene.inputs.clip import ClipInput
from dancedata.scene.poses import Pose, interpolated

#: Raised by hand when a stage here gives other numbers for the same input.
EVALUATE_STAGE = 1
STAGE = "evaluate"

#: Before the note that says why the scaling of columns is doubtful.
_DOUBT = "scaling: "
#: Relative difference of the numbers of a dance and of a copy of it.
_SAME = 1e-3

#: Numbers of one piece, or the name of the outcome that a metric has instead.
Outcome = tuple[float, ...] | str


class Measurement(NamedTuple):
    """One measure of a clip, as the cache holds it: a JSON array."""

    fps: str
    cuts: list[list[int]]
    notes: list[str]
    outcomes: list[list[float] | str]


@dataclass(frozen=True)
class MeasuredClip:
    """The numbers of a clip."""

    id: str
    clip: str  # recording that resampling draws; several clips may share one
    fps: str  # rate that was measured; "" if only metrics of music are computed, and the clip has none
    cuts: tuple[tuple[int, int], ...]  # first frame and length of each piece
    # by the number of a protocol's measure, the outcome of each piece; None if the measure needs music and the clip
    # has none
    rows: Mapping[int, tuple[Outcome, ...] | None]
    notes: tuple[str, ...] = ()  # what was changed before measuring

    @property
    def doubt(self) -> str:
        """Why the scaling of its columns is doubtful; "" where it is not."""
        return next((note.removeprefix(_DOUBT) for note in self.notes if note.startswith(_DOUBT)), "")

    def same_numbers(self, other: MeasuredClip) -> bool:
        """Whether all numbers are those of another clip, to a thousandth."""
        pairs = [pair for k in self.rows for pair in zip(self.rows[k] or (), other.rows.get(k) or (), strict=False)]
        texts, numbers = ([p for p in pairs if isinstance(p[0], str) is is_text] for is_text in (True, False))
        return bool(numbers) and all(
            not isinstance(two, str) and np.allclose(one, two, rtol=_SAME, atol=1e-9) for one, two in numbers
        ) and all(one == two for one, two in texts)  # fmt: skip

    @property
    def seconds(self) -> list[float]:
        """Length of each piece."""
        return [float(FrameGrid.of(self.fps).seconds(length)) for _, length in self.cuts]

    @property
    def end_s(self) -> float:
        """End of the last piece, seconds from the first frame of the clip; 0 without pieces."""
        ends = [start + length for start, length in self.cuts]
        return float(FrameGrid.of(self.fps).seconds(max(ends))) if ends else 0.0

    @classmethod
    def of(cls, clip: ClipInput, results: Mapping[int, Measurement | None]) -> MeasuredClip:
        """Join the measurements of a clip, by measure."""
        rows: dict[int, tuple[Outcome, ...] | None] = {}
        last = Measurement("", [], [], [])
        for number, result in results.items():
            if result is None:
                rows[number] = None
                continue
            last = Measurement(*result)  # of the cache it is a list
            rows[number] = tuple(piece if isinstance(piece, str) else tuple(piece) for piece in last.outcomes)
        cuts = tuple((start, length) for start, length in last.cuts)
        return cls(clip.id, clip.recording or clip.clip, str(last.fps), cuts, rows, tuple(last.notes))


def measure_pose(
    protocol: Protocol,
    role: Role,
    numbers: Sequence[int],
    pose: Pose | tuple[Pose, ...],
    music: ClipMusic | None,
) -> dict[int, Measurement | None]:
    """Measure a pose, or those of a group's dancers; return the result by the number of the measure."""
    if isinstance(pose, tuple):
        placed, joints, notes = _group(pose, protocol.motion)
    else:
        placed, notes = conformed(pose, protocol.motion)
        joints = in_axes(placed.joints, protocol.motion)
        notes = (*notes, f"{_DOUBT}{pose.doubt}") if pose.doubt else notes
    cuts = protocol.pieces(role).of(joints.shape[-3], placed.grid)
    computable = [n for n in numbers if music is not None or not protocol.measures[n].metric.needs_music]
    outcomes: dict[int, list[list[float] | str]] = {number: [] for number in computable}
    for start, length in cuts:
        piece = _Piece(joints[..., start : start + length, :, :], placed.grid)
        beats = None if music is None else music.after(start, placed.grid)
        for number in computable:
            outcomes[number].append(_outcome(protocol.measures[number], role, piece, beats))
    measured = Measurement(str(placed.grid), [list(cut) for cut in cuts], list(notes), [])
    return {n: measured._replace(outcomes=outcomes[n]) if n in outcomes else None for n in numbers}


def _group(poses: tuple[Pose, ...], rule: MotionRule) -> tuple[Pose, Float64Array, tuple[str, ...]]:
    """Return the first dancer, the joints (P, T, J, 3) of all in a protocol's axes, and notes on what was changed."""
    dancers, notes = zip(*(conformed(pose, rule) for pose in poses), strict=True)
    rates = sorted({str(dancer.grid) for dancer in dancers})
    if len(rates) > 1:
        raise DataError("the dancers of a group have different rates", reason="other_rate", found=listed(rates))
    sizes = [len(dancer.joints) for dancer in dancers]
    changed = dict.fromkeys(note for of_dancer in notes for note in of_dancer)
    if min(sizes) < max(sizes):
        changed["groups are cut to the shortest of their dancers"] = None
    joints = np.stack([in_axes(dancer.joints[: min(sizes)], rule) for dancer in dancers])
    return dancers[0], joints, tuple(changed)


@dataclass(frozen=True, eq=False)
class _Piece:
    """Joints (T, J, 3), or (P, T, J, 3), of a piece at a rate, and its steady positions, which measures share."""

    joints: Float64Array
    grid: FrameGrid

    @cached_property
    def steady(self) -> Float64Array:
        return _each(lambda joints: steady(joints, float(self.grid.rate)), self.joints)


def _outcome(measure: Measure, role: Role, piece: _Piece, beats: MusicBeats | None) -> list[float] | str:
    joints, grid = piece.joints, piece.grid
    if measure.steady:
        joints, grid = piece.steady, FrameGrid.of(STEADY_FPS)
    elif measure.fps is not None:
        target = FrameGrid.of(measure.fps)
        joints, grid = _each(lambda each: _at_rate(each, piece.grid, target), joints), target
    music = beats if measure.metric.needs_music else None
    joints = joints[..., : measure.frames(role), :, :]
    dances = [joints] if joints.ndim == 3 or measure.metric.of_groups else list(joints)
    rows, outcome = [], ""
    for dance in dances:
        try:
            rows.append(measure.metric.measure(Dance(dance, grid, music)))
        except Undefined as error:
            outcome = outcome or error.reason
    if not rows:
        return outcome
    numbers = np.mean(rows, axis=0)  # of one, or of the dancers that have a value
    return [float(number) for number in numbers] if np.isfinite(numbers).all() else "not_finite"


def _each(of: Callable[[Float64Array], Float64Array], joints: Float64Array) -> Float64Array:
    """Apply a function of positions (T, J, 3) to them, or to those of each dancer of a group."""
    return of(joints) if joints.ndim == 3 else np.stack([of(dancer) for dancer in joints])


@dataclass(frozen=True, eq=False)
class MeasuredSet:
    """The numbers of a set, and its clips without numbers."""

    clips: list[MeasuredClip]
    rejects: list[Reject]


def measure_clips(
    resources: Resources,
    protocol: Protocol,
    clip_set: ClipSet,
    numbers: Sequence[int],
    music: Mapping[str, ClipMusic],
) -> MeasuredSet:
    """Measure clips with their music, by the ids of clips."""
    cache, role = resources.cache, clip_set.role
    if clip_set.store is not None:
        read = {clip_id for clip in clip_set.clips for clip_id in clip.clips}
        clip_set.store.require_intact(read, sha256=cache.file_sha256)
    common = {number: _common_key(protocol, role, protocol.measures[number]) for number in numbers}
    readable, rejects, calls, cached = [], [], [], []
    for clip in clip_set.clips:
        beats = music.get(clip.id)
        try:
            keys = _keys(cache, protocol, common, clip, beats)
        except (OSError, DataError) as error:
            rejects.append(Reject("broken_file", clip=clip.id, detail=str(error)))
            continue
        readable.append(clip)
        calls.append((cache, keys, clip, protocol, role, beats))
        entries = {number: cache.json(STAGE, key) for number, key in keys.items()}
        cached.append(entries if None not in entries.values() else None)
    results = run_units(
        measure_clip, calls, cached=cached, jobs=resources.jobs, label="measuring", progress=resources.progress
    )
    measured = []
    for clip, result in zip(readable, results, strict=True):
        if isinstance(result, Reject):
            rejects.append(result)
        else:
            measured.append(MeasuredClip.of(clip, {number: result.get(number) for number in numbers}))
    if not measured and rejects:
        raise DataError(
            "no clip can be measured", reason="nothing_left", where=clip_set.source, found=rejects[0].detail
        )
    return MeasuredSet(measured, rejects)


def measure_clip(
    cache: Cache, keys: Mapping[int, str], clip: ClipInput, protocol: Protocol, role: Role, music: ClipMusic | None
) -> dict[int, Measurement | None] | Reject:
    """Load and measure one clip, and publish the numbers: a unit of work."""
    try:
        results = measure_pose(protocol, role, list(keys), clip.load(), music)
    except DataError as error:
        return reject_of(error, clip=clip.id)
    for number, result in results.items():
        cache.put_json(STAGE, keys[number], result)
    return results


def _common_key(protocol: Protocol, role: Role, measure: Measure) -> str:
    """Return the hash of what a measure's numbers of all clips depend on."""
    return metric_key(
        measure.metric,
        motion=repr(protocol.motion),
        pieces=protocol.pieces(role).identity,
        measured=[measure.fps, measure.frames(role), *(["steady"] if measure.steady else [])],
    )


def metric_key(metric: Metric, **what: Any) -> str:
    """Return the key of numbers of a metric that depend on `what`, and on the packages and the machine."""
    return Cache.numeric_key(
        STAGE,
        version=EVALUATE_STAGE,
        metric=[metric.name, metric.version, document_of(metric)],
        **what,
    )


def _keys(
    cache: Cache, protocol: Protocol, common: Mapping[int, str], clip: ClipInput, music: ClipMusic | None
) -> dict[int, str]:
    """Return the cache keys of a clip by measure; a measure that needs music has none without it."""
    identity = clip.identity(cache)
    target = {"smpl24": SMPL24, "smplx24": SMPLX55, "smplx55": SMPLX55}.get(protocol.motion.body)
    crossing = {"crossing": CROSSING} if target is not None and clip.changes_body(target) else {}
    keys = {}
    for number, shared in common.items():
        metric = protocol.measures[number].metric
        if metric.needs_music and music is None:
            continue
        beats = music.identity(instants=metric.needs_instants) if metric.needs_music and music is not None else None
        keys[number] = Cache.key(STAGE, common=shared, clip=identity, beats=beats, **crossing)
    return keys


_JOINTS = {
    "smpl24": SMPL24.joints,
    "smplx24": SMPLX55.joints[:24],
    "smplx55": SMPLX55.joints,
    "body22": BODY_JOINTS,
}


def conformed(pose: Pose, rule: MotionRule) -> tuple[Pose, tuple[str, ...]]:
    """Return the joints and the rate that a protocol measures, +Y up, and notes on what was changed."""
    placed, notes = _on(pose, rule)
    if rule.pelvis == "translation" and placed.true_pelvis:
        placed = replace(placed, joints=placed.joints - placed.rest, true_pelvis=False, motion=None)
    if rule.pelvis == "body" and not placed.true_pelvis:
        raise DataError("the protocol needs the true position of the pelvis", reason="other_pelvis",
                        found="joints whose pelvis may lie at the translation, as in EDGE's kinematics",
                        allowed="rotations and translation, or joints with the pelvis of the body",
                        fix="declare the body if the pelvis is right, such as smpl24")  # fmt: skip
    grid = rule.grid
    if grid is None or grid == placed.grid:
        return placed, notes
    step = placed.grid.step_to(grid)
    if step is None:
        raise DataError(
            "the protocol measures another frame rate",
            reason="other_rate",
            found=f"{placed.grid} frames per second",
            allowed=f"{grid}, or a whole multiple of it",
            fix="build the dataset, or generate, at that rate; the protocol dancedata takes any rate",
        )
    return replace(placed, joints=placed.joints[::step], grid=grid, motion=None), (
        *notes,
        f"{placed.grid} frames per second: every {step}. frame is measured",
    )


def _on(pose: Pose, rule: MotionRule) -> tuple[Pose, tuple[str, ...]]:
    joints = _JOINTS[rule.body]
    if rule.body in ("smplx24", "smplx55") and pose.motion is not None:
        return _on_smplx(pose, rule)
    if rule.body == "smpl24" and pose.motion is not None and has_body(pose.motion.skeleton):
        placed = transfer(pose.motion, SMPL24)
        note = () if placed is pose.motion else (f"{pose.motion.skeleton.name}: carried over to SMPL's 24 joints",)
        return Pose.of_motion(placed), note
    if pose.names[: len(joints)] != joints:
        raise _missing(pose, rule)
    return replace(pose, joints=pose.joints[:, : len(joints)], names=joints, motion=None), ()


def _on_smplx(pose: Pose, rule: MotionRule) -> tuple[Pose, tuple[str, ...]]:
    """Return SMPL-X's joints, all or the first 24; a motion without face joints has them at rest, as in Lodge."""
    motion = pose.motion
    if motion is None or motion.skeleton.joints == SMPL24.joints or not has_body(motion.skeleton):
        raise _missing(pose, rule)
    placed, names = transfer(motion, SMPLX55), _JOINTS[rule.body]
    return Pose(placed.joints()[:, : len(names)], names, placed.grid), ()


def _missing(pose: Pose, rule: MotionRule) -> DataError:
    joints = _JOINTS[rule.body]
    lacking = [joint for joint in joints if joint not in pose.names]
    return DataError(
        "the protocol measures joints that this motion does not have",
        reason="missing_joints",
        found=f"{len(pose.names)} joints, {f'without {listed(lacking)}' if lacking else 'in another order'}",
        allowed=f"{rule.body}: {listed(joints, 4)}",
        fix="evaluate motion on that body: SMPL-X for Lodge's protocol, SMPL's 24 joints for those of AIST++",
    )


def in_axes(joints: Float64Array, rule: MotionRule) -> Float64Array:
    """Return +Y-up positions in the axes of a protocol: for z up, (x, y, z) becomes (x, -z, y)."""
    if rule.up == "z":
        joints = np.stack([joints[..., 0], -joints[..., 2], joints[..., 1]], axis=-1)
    if rule.turned:
        joints = np.stack([-joints[..., 1], joints[..., 0], joints[..., 2]], axis=-1)
    return joints


def _at_rate(joints: Float64Array, grid: FrameGrid, target: FrameGrid) -> Float64Array:
    """Return positions (T, J, 3) at another rate, linearly interpolated, from the same first frame."""
    if grid == target:
        return joints
    return interpolated(joints, grid.places(grid.resampled_length(len(joints), target), target))
