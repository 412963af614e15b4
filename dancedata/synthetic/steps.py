"""Footwork of the synthetic dance: the movement of feet and pelvis between key poses.

All curves are min-jerk, so everything is at rest on the key frames and a foot on the floor does not move.
Positions in metres, +Y up, angles in radians, times in frames at 60 per second.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dancedata.synthetic.plan import MOTION_RATE, tempo_bpm

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

#: Actions of the feet in the interval before a key frame.
HOLD, LEFT, RIGHT, JUMP, HEELS, TAP_LEFT, TAP_RIGHT = range(7)

#: Distance of each foot from the middle of the stance, metres.
_STANCE_WIDTH = 0.13

#: Least length of a step, metres, where the feet allow it.
_SHORTEST_STEP = 0.15

#: Most frames of a step in the air (0.4 s); in a slow song the feet wait on the floor.
_LONGEST_SWING = 24


@dataclass(frozen=True)
class Timeline:
    """Key frames of a clip and the position of each frame between them.

    `beats`, `keys`: Frames of all beats (B,), and (K,) of the key poses among them, from before frame 0 to after N.
    `interval`, `phase`: (N,) last key at or before each frame, and how far it is to the next, 0 <= phase < 1.
    """

    n_frames: int
    beats: Ints
    keys: Ints
    interval: Ints
    phase: Floats
    beat_phase: Floats

    def ease(self, values: Floats) -> Floats:
        """Interpolate key values (K, ...) to frames (N, ...) with min-jerk curves."""
        shape = (-1,) + (1,) * (values.ndim - 1)
        start, stop = values[self.interval], values[self.interval + 1]
        moved: Floats = start + _min_jerk(self.phase).reshape(shape) * (stop - start)
        return moved


@dataclass(frozen=True)
class Footwork:
    """Movement of the feet, with values per key (K,) and per frame (N,).

    `place`, `yaw`: (K, 2, 2) x and z of the ankles and (K, 2) heading of the feet; left, right.
    `heading`: (K,) heading of the body, continuous beyond pi.
    `actions`: (K,) action of the interval that begins on the key.
    `ankle_xz`, `yaw_frames`, `pitch`, `rise`: (N, 2, 2), (N, 2), (N, 2), (N, 2) for every frame; pitch > 0 is toe
        down, rise is the height above standing.
    `on_toe`: (N, 2) True while the foot pivots on its toe joint instead of its ankle.
    `stepping`: (N, 2) True while the foot is in the air.
    `jump`: (N,) height of both feet and the pelvis in a jump.
    """

    place: Floats
    yaw: Floats
    heading: Floats
    actions: Ints
    ankle_xz: Floats
    yaw_frames: Floats
    pitch: Floats
    rise: Floats
    on_toe: Bools
    stepping: Bools
    jump: Floats


def _min_jerk(s: Floats) -> Floats:
    """Return the min-jerk curve of s in [0, 1]: 10 s^3 - 15 s^4 + 6 s^5 (Flash and Hogan 1985)."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def bump(s: Floats) -> Floats:
    """Return a curve from 0 to 1 and back over s in [0, 1], with speed 0 at the ends and the top."""
    return 64.0 * s**3 * (1.0 - s) ** 3


def make_timeline(music: str, first_beat_s: float, n_frames: int, rng: np.random.Generator) -> Timeline:
    """Return beats and key frames of a clip: a key pose on every beat, sometimes on every second one."""
    period = MOTION_RATE * 60.0 / tempo_bpm(music)
    count = int(np.ceil(n_frames / period)) + 8
    # Rounded half up: the beat's nearest frame.
    beats = np.floor((np.arange(count) - 2) * period + first_beat_s * MOTION_RATE + 0.5).astype(np.int64)
    gaps = np.where(rng.random(count) < (0.35 if period < 31 else 0.15), 2, 1)
    chosen = np.cumsum(np.concatenate(([0], gaps)))
    keys = beats[chosen[chosen < count]]
    keys = keys[: int(np.searchsorted(keys, n_frames)) + 1]
    frames = np.arange(n_frames)
    interval, phase = _phase(frames, keys)
    return Timeline(n_frames, beats, keys, interval, phase, _phase(frames, beats)[1])


def _phase(frames: Ints, marks: Ints) -> tuple[Ints, Floats]:
    interval = np.searchsorted(marks, frames, side="right").astype(np.int64) - 1
    start = marks[interval]
    return interval, (frames - start) / (marks[interval + 1] - start)


def make_footwork(time: Timeline, advanced: bool, rng: np.random.Generator) -> Footwork:
    """Choose an action per interval, place the feet on the keys, and move them in between."""
    actions = _choose_actions(len(time.keys), advanced, rng)
    turns = _choose_turns(actions, advanced, rng)
    heading = rng.uniform(-0.5, 0.5) + np.concatenate(([0.0], np.cumsum(turns[:-1])))
    place, yaw = _place_feet(actions, heading, rng)
    swing = (actions == LEFT) | (actions == RIGHT) | (actions == JUMP)
    # A foot leaves the floor shortly after the previous key and lands exactly on the next one.
    gap = np.diff(time.keys, append=time.keys[-1] + 1)
    start = np.where(swing, rng.uniform(0.08, 0.3, len(actions)), 0.1)
    start = np.where(actions == JUMP, start, np.maximum(start, 1.0 - _LONGEST_SWING / gap))[time.interval]
    u = np.clip((time.phase - start) / (1.0 - start), 0.0, 1.0)
    action = actions[time.interval]
    steps = np.stack([action == LEFT, action == RIGHT], axis=1) | (action == JUMP)[:, None]
    taps = np.stack([action == TAP_LEFT, action == TAP_RIGHT], axis=1)
    heels = (action == HEELS)[:, None] & np.array([True, True])
    hill, ease = bump(u)[:, None], np.where(steps, _min_jerk(u)[:, None], 0.0)
    yaws = yaw[time.interval], yaw[time.interval + 1]
    lift = rng.uniform(0.07, 0.14, len(actions))[time.interval][:, None]
    tilt = 0.6 * (1.0 - 2.0 * u)[:, None]
    amount = rng.uniform(0.8, 1.2, len(actions))[time.interval][:, None]
    pitch = hill * amount * np.select([steps, taps, heels], [tilt, -0.45, 0.55], 0.0)
    return Footwork(
        place=place,
        yaw=yaw,
        heading=heading,
        actions=actions,
        ankle_xz=_paths(time, place, heading, ease, action == JUMP),
        yaw_frames=yaws[0] + ease * (yaws[1] - yaws[0]),
        pitch=pitch,
        rise=np.where(steps, hill * lift, 0.0),
        on_toe=heels & (u > 0)[:, None],
        stepping=(steps | taps) & (u > 0)[:, None],
        jump=np.where(action == JUMP, 0.12 * bump(u), 0.0),
    )


def _paths(time: Timeline, place: Floats, heading: Floats, ease: Floats, jump: Bools) -> Floats:
    """Return the ankles (N, 2, 2). A stepping foot moves around the standing one, in a turning jump both feet rotate.

    With points of the floor as complex numbers, both are a rotating and growing vector: v0 * (v1 / v0)^s.
    """
    before, after = time.interval, time.interval + 1
    spot = place[..., 0] + 1j * place[..., 1]
    apart = spot - spot[:, ::-1]  # each foot relative to the other
    growth = np.log(apart[after] / apart[before])
    # In a jump the feet follow the body, by more than 180 degrees if necessary.
    turn = -(heading[after] - heading[before])[:, None]
    rest = growth.imag - turn
    rest = turn + rest - 2.0 * np.pi * np.round(rest / (2.0 * np.pi))
    growth = growth.real + 1j * np.where(jump[:, None], rest, growth.imag)
    seen = apart[before] * np.exp(ease * growth)
    middle = spot.mean(axis=1, keepdims=True)
    centre = middle[before] + ease * (middle[after] - middle[before])
    path = np.where(jump[:, None], centre + seen / 2.0, spot[before][:, ::-1] + seen)
    # A standing foot must not move, not even by rounding errors.
    path = np.where(ease > 0.0, path, spot[before])
    return np.stack([path.real, path.imag], axis=2)


def _turn(points: Floats, angle: Floats) -> Floats:
    """Rotate points (..., 2), x and z, about the vertical by an angle (...), radians."""
    x, z = points[..., 0], points[..., 1]
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([x * cos + z * sin, z * cos - x * sin], axis=-1)


def _choose_actions(count: int, advanced: bool, rng: np.random.Generator) -> Ints:
    """Return the actions (K,) of the intervals; consecutive steps use different feet."""
    weights = [0.06, 0.62, 0.0, 0.1 if advanced else 0.04, 0.1, 0.08, 0.08]
    actions = rng.choice(7, size=count, p=np.array(weights) / sum(weights)).astype(np.int64)
    # Every clip contains a hold, a heel raise and a tap of each foot, so that its ground truth has every kind.
    planned = np.array([HEELS, HOLD, TAP_LEFT, TAP_RIGHT])
    spots = np.arange(2, count - 1, 3)[: len(planned)]
    actions[spots] = planned[: len(spots)]
    step = actions == LEFT
    actions[step] = np.where((np.cumsum(step)[step] + int(rng.integers(2))) % 2 == 0, LEFT, RIGHT)
    return actions


def _choose_turns(actions: Ints, advanced: bool, rng: np.random.Generator) -> Floats:
    """Return the change of heading (K,) in each interval, radians."""
    count = len(actions)
    turns = rng.uniform(-0.15, 0.15, count)
    stepping = (actions == LEFT) | (actions == RIGHT)
    if advanced:  # 360 degrees in steps of 45, in either direction
        first = int(rng.integers(1, max(2, count - 12)))
        run = np.flatnonzero(stepping & (np.arange(count) >= first))[:8]
        turns[run] = rng.choice([-1.0, 1.0]) * np.pi / 4
        jumps = actions == JUMP
        turns[jumps] = rng.choice([-np.pi, -np.pi / 2, np.pi / 2, np.pi], size=int(jumps.sum()))
    return np.where(stepping | (actions == JUMP), turns, 0.0)


def _place_feet(actions: Ints, heading: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return ankles (K, 2, 2) and headings (K, 2) on each key, a step beside the standing foot, near the start."""
    count = len(actions)
    sides = np.array([1.0, -1.0])
    noise = rng.uniform(-0.2, 0.2, (count, 12, 2))
    facing = heading[:, None] + 0.2 * sides + rng.uniform(-0.1, 0.1, (count, 2))
    place = np.empty((count, 2, 2))
    yaw = np.empty((count, 2))
    place[0], yaw[0] = _turn(_STANCE_WIDTH * sides[:, None] * [1.0, 0.0], heading[0]), facing[0]
    for k in range(1, count):
        place[k], yaw[k] = place[k - 1], yaw[k - 1]
        action = actions[k - 1]
        middle = place[k - 1].mean(axis=0)
        if action == JUMP:
            apart = _turn(_STANCE_WIDTH * sides[:, None] * [1.0, 0.0], heading[k])
            place[k], yaw[k] = 0.7 * middle + 0.3 * noise[k, 0] + apart, facing[k]
        elif action in (LEFT, RIGHT):
            side = 0 if action == LEFT else 1
            spots = place[k, 1 - side] + _turn(_steps(side, noise[k], middle, heading[k]), heading[k])
            length = np.linalg.norm(spots - place[k, side], axis=1)
            # The first that is long enough for a step, or the longest.
            place[k, side] = spots[np.argmax(np.minimum(length, _SHORTEST_STEP))]
            yaw[k, side] = facing[k, side]
    return place, yaw


def _steps(side: int, noise: Floats, middle: Floats, heading: float) -> Floats:
    """Return places (C, 2) for a foot, sideways and ahead of the standing one, for each row of noise (C, 2)."""
    sign = 1.0 if side == 0 else -1.0
    aim = noise + _turn(-0.5 * middle, np.asarray(-heading))
    wide = np.clip(2.0 * _STANCE_WIDTH + sign * aim[:, 0], 0.18, 0.38) * sign
    return np.stack([wide, np.clip(aim[:, 1], -0.25, 0.25)], axis=1)
