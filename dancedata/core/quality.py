"""Quality flags for suspicious motion. It is flagged; only the stage `repair` of a recipe changes it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dancedata.core.bodies import has_body
from dancedata.core.motion import Motion
from dancedata.core.rates import rate_factor, repeats
from dancedata.core.rotations import Float64Array, angles_between
from dancedata.core.sides import MIN_ELBOWS, MIN_STANCE, body_direction, lies, sides_of, wrong_up
from dancedata.core.skeleton import Skeleton

#: Bound of the speed of a dancer's joints: 45 degrees per frame at 60 FPS.
_MAX_TURN_DEG_S = 2700.0
#: Bound of the speed of a dancer's pelvis.
_MAX_ROOT_SPEED_M_S = 12.0
#: Range of the size of a body at rest, metres, from children to the tallest adults.
PLAUSIBLE_BODY_M = (1.0, 2.5)
#: Flags of a whole clip, whose unit, names of sides or up axis are probably wrong.
IMPLAUSIBLE = tuple(f"implausible_{what}" for what in ("body", "root", "sides", "legs", "arms", "elbows", "up"))
#: Flags of a whole clip that may be as it should be.
_DOUBTFUL = ("lying", "crossed_legs", "stretched_bone", "fitted", "repeated_frames", "doubtful_rate")
#: Flags of a clip's music: it has no sound, or its file is not quite what it says.
OF_MUSIC = ("silent_music", "steady_music", "decoded_by_ffmpeg", "late_music", "early_music", "cut_music")
OF_CLIPS = (*IMPLAUSIBLE, *_DOUBTFUL, *OF_MUSIC)
#: Music below this level is silent, dBFS; the last bit of 16 has -98.
SILENT_DBFS = -80.0
#: Flags of what a recipe's `repair` changed: of a frame, and of all frames of a clip.
REPAIRED = ("repaired_spike", "repaired_gap", "repaired_floor", "repaired_jitter")
#: Bones of a capture that keep their length within this are rigid, metres.
_RIGID_M = 0.001
#: Range of the vertical movement of the root, as a multiple of the movement implied by the pose. Jumps increase it:
#: 0.9 to 9.6 in real and synthetic dances. A wrong usual unit changes it at least 17-fold.
PLAUSIBLE_ROOT = (0.1, 10.0)
#: Poses that imply a smaller movement, metres (standard deviation), are not evidence about the root.
_LEAST_DROP_M = 0.005
#: A root within this range of heights, metres, is never too large: dancers climb stairs.
_ROOM_M = 3.0
#: A root that does not move at all was removed on purpose.
_STILL_M = 1e-6


@dataclass(frozen=True)
class Flag:
    """A suspicious value of a clip, or between `frame` and the next one, at the source's frame rate.

    `kind`: Says what `value` is, in `unit`. "fast_turn": an angle. "root_jump": a distance. "repaired_spike", "_gap",
        "_floor", "_jitter": size of a spike, length of a gap, drift or jitter of all frames. "retarget_residual": the
        largest of a run of frames, see `dancedata.retarget`. `core.implausible` says what those in `OF_CLIPS` are.
    """

    kind: str
    joint: str  # "" for the whole clip
    frame: int | None  # None for the whole clip
    value: float
    unit: str
    rate: str  # frames per second, as text

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data; a flag of the whole clip has no joint and no frame."""
        return {name: value for name, value in self.__dict__.items() if value not in ("", None)}


def music_flags(measured: Iterable[tuple[str, float]]) -> list[Flag]:
    """Return the flags of a clip's music, of (kind, value)."""
    units = {"silent_music": "dBFS", "steady_music": "dB"}
    return [Flag(kind, "", None, value, units.get(kind, "s"), "") for kind, value in measured]


def implausible_flags(motion: Motion) -> list[Flag]:
    """Find what makes a whole clip implausible: body, root, names of sides, up axis; doubtful ones come last."""
    joints, size, sided = motion.joints(), body_size(motion.skeleton), has_body(motion.skeleton)
    body = None if PLAUSIBLE_BODY_M[0] <= size <= PLAUSIBLE_BODY_M[1] else size
    root = _implausible_root(motion, joints)
    measured = [
        ("implausible_body", body, "m"),
        ("implausible_root", root, "1"),
        *((kind, value, "1") for kind, value in (implausible_sides(joints, motion) if sided else ())),
        ("stretched_bone", motion.stretch_m if motion.stretch_m > _RIGID_M else None, "m"),
        ("fitted", motion.fit_m, "m"),
        ("repeated_frames", repeats(joints), "1"),
    ]
    if sided and body is root is None:  # a wrong unit changes accelerations as a wrong rate does
        measured.append(("doubtful_rate", rate_factor(joints, float(motion.grid.rate)), "1"))
    return [
        Flag(kind, "", None, round(value, 6 if unit == "1" else 4), unit, str(motion.grid))
        for kind, value, unit in measured
        if value is not None
    ]


def implausible_sides(joints: Float64Array, motion: Motion | None = None) -> list[tuple[str, float]]:
    """Return kind and value of the flags about sides and up of joint positions; elbows only with the motion."""
    sides, up = sides_of(joints, motion), wrong_up(joints)
    flags = []
    if sides.swapped:
        flags.append((f"implausible_{sides.swapped}", sides.chest if sides.swapped == "arms" else sides.legs))
    if sides.elbows < MIN_ELBOWS:
        flags.append(("implausible_elbows", sides.elbows))
    if up is not None:
        flags.append(("implausible_up", float(up[0][1])))
    elif lies(joints):
        flags.append(("lying", float(body_direction(joints)[1])))
    if sides.stance < MIN_STANCE:
        flags.append(("crossed_legs", sides.stance))
    return flags


def body_size(skeleton: Skeleton) -> float:
    """Return the largest extent of a skeleton at rest along an axis, metres: the height or the arm span."""
    places = np.zeros((skeleton.n_joints, 3))
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            places[joint] = places[parent] + skeleton.offsets[joint]
    return float(np.ptp(places, axis=0).max())


def _implausible_root(motion: Motion, joints: Float64Array) -> float | None:
    """Return the ratio of the root's vertical movement to that implied by the pose, if it is implausible."""
    height = motion.translation[:, 1]
    drop = joints[..., 1].min(axis=1) - height
    moved, implied = float(height.std()), float(drop.std())
    if implied < _LEAST_DROP_M or moved < _STILL_M:
        return None
    ratio, (low, high) = moved / implied, PLAUSIBLE_ROOT
    return ratio if ratio < low or (ratio > high and np.ptp(height) > _ROOM_M) else None


def quality_flags(motion: Motion) -> list[Flag]:
    """Find implausible bodies, then joints and roots that move faster than a dancer can, by frame and joint."""
    rate, joints, grid = float(motion.grid.rate), motion.skeleton.joints, str(motion.grid)
    flags = [
        Flag("fast_turn", joints[joint], frame, round(angle, 3), "deg", grid)
        for frame, joint, angle in _turns(motion.rotations, rate)
    ]
    steps = np.linalg.norm(np.diff(motion.translation, axis=0), axis=1)
    flags += [
        Flag("root_jump", joints[0], int(t), round(float(steps[t]), 4), "m", grid)
        for t in np.flatnonzero(steps * rate > _MAX_ROOT_SPEED_M_S)
    ]
    return implausible_flags(motion) + sorted(flags, key=lambda f: (f.frame or 0, f.kind, f.joint))


def _turns(rotations: Float64Array, rate: float) -> Iterator[tuple[int, int, float]]:
    """Yield frame, joint and angle, degrees, of every turn to the next frame that is too fast."""
    # No turn is larger than the distance of its two rotation vectors (Hartley et al. 2013, section 4): angles are
    # computed only where that distance, with room for rounding, is too large.
    steps = np.diff(rotations, axis=0)
    np.square(steps, out=steps)
    distances = np.sqrt(steps[..., 0] + steps[..., 1] + steps[..., 2])
    frames, joints = np.nonzero(np.degrees(distances) * rate > _MAX_TURN_DEG_S * (1 - 1e-9))
    if not len(frames):
        return
    pairs = np.stack([rotations[frames, joints], rotations[frames + 1, joints]])
    angles = np.degrees(angles_between(pairs)[0])
    for frame, joint, angle in zip(frames.tolist(), joints.tolist(), angles.tolist(), strict=True):
        if angle * rate > _MAX_TURN_DEG_S:
            yield frame, joint, angle
