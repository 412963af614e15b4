"""The synthetic dancer: key poses of arms and spine on the beats, planted feet by inverse kinematics."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.synthetic.plan import MOTION_RATE, beat_times, generator, music_of
from dancedata.synthetic.steps import LEFT, RIGHT, Footwork, Timeline, bump, make_footwork, make_timeline

Floats = NDArray[np.float64]

# A writable copy: scipy 1.17 does not accept read-only arrays in `apply`.
OFFSETS: Floats = np.array(SMPL24.offsets)

#: A foot joint that moves farther than this in 1/30 s counts as moving: twice EDGE's contact threshold.
_MOVING_M = 0.02

#: Largest used fraction of a leg's full length, so that knees never lock.
_REACH = 0.985

# Left arm: swing forward (about y), raise (about z), twist (about x), elbow bend (about y), degrees.
_ARMS = np.array([
    [0, -75, 0, 15], [0, -5, 0, 10], [-10, 65, 0, 25], [0, -5, -85, 85], [-65, -20, 0, 75],
    [-80, 0, 0, 15], [-50, -35, 20, 110], [10, -50, 30, 90], [-30, 35, -30, 40], [15, -40, 0, 30],
], dtype=np.float64)  # fmt: skip


@dataclass(frozen=True)
class MotionTruth:
    """Ground truth of one synthetic clip; foot joints are left ankle, right ankle, left toe, right toe.

    `beat_times_s`: (B,) seconds of the beats within the clip.
    `beat_frames`: (B,) the nearest frames at 60 per second.
    `key_frames`: (K,) frames of the key poses, where everything is at rest; a subset of the beat frames.
    `planted`: (N, 4) bool, the joint stands still on the floor in this frame.
    `moving`: (N, 4) bool, the joint moves more than 0.02 m in the 1/30 s from this frame. A joint that is neither
        planted nor moving is just leaving the floor, just landing, or turning in the air.
    `foot_positions`: (N, 4, 3) float32 metres, true pelvis, the intended positions of the joints.
    `floor_height_m`: Height of the toe joints on the floor.
    """

    beat_times_s: Floats
    beat_frames: NDArray[np.int64]
    key_frames: NDArray[np.int64]
    planted: NDArray[np.bool_]
    moving: NDArray[np.bool_]
    foot_positions: NDArray[np.float32]
    floor_height_m: float


def make_motion(name: str, n_frames: int, seed: int) -> tuple[Motion, MotionTruth]:
    """Return the motion of clip `name`, n_frames at 60 per second, and its ground truth."""
    music = music_of(name)
    rng = generator(seed, "motion", name)
    beats_s = beat_times(music, seed, n_frames / MOTION_RATE)
    # One beat determines all others; a very short clip may end before its first.
    first = float(beat_times(music, seed, 60.0)[0])
    time = make_timeline(music, first, n_frames, rng)
    feet = make_footwork(time, "sFM" in name, rng)
    floor = float(rng.uniform(0.54, 0.64))
    rotations = _upper_body(time, rng)
    root = _root_rotation(time, feet, rng)
    foot_turn = Rotation.from_euler("YX", np.stack([feet.yaw_frames, feet.pitch], axis=2).reshape(-1, 2))
    ankles, toes = _foot_joints(feet, foot_turn, floor)
    pelvis = _pelvis(time, feet, root, ankles, rng)
    rotations[:, 0] = root.as_rotvec()
    for side in (0, 1):
        _solve_leg(side, rotations, root, pelvis, ankles[:, side], foot_turn[side::2], feet)
    _wrap_some(rotations, rng)
    positions = np.concatenate([ankles, toes], axis=1)
    motion = Motion(
        translation=pelvis - OFFSETS[0],
        rotations=rotations,
        grid=FrameGrid.of(MOTION_RATE),
        skeleton=SMPL24,
    )
    return motion, _truth(time, feet, positions, beats_s, floor)


def _truth(time: Timeline, feet: Footwork, positions: Floats, beats_s: Floats, floor: float) -> MotionTruth:
    still = np.concatenate([~(feet.stepping & (feet.rise > 0)), ~feet.stepping], axis=1)
    # On a heel raise the toe stays and the ankle goes up; on a tap it is the other way round.
    still[:, :2] &= ~feet.on_toe
    step = MOTION_RATE // 30
    moved = np.zeros(still.shape)
    moved[:-step] = np.linalg.norm(positions[step:] - positions[:-step], axis=2)
    inside = (time.keys >= 0) & (time.keys < time.n_frames)
    frames = np.minimum(np.floor(beats_s * MOTION_RATE + 0.5), time.n_frames - 1).astype(np.int64)
    return MotionTruth(
        beat_times_s=beats_s,
        beat_frames=frames,
        key_frames=time.keys[inside],
        planted=still,
        moving=moved > _MOVING_M,
        foot_positions=positions.astype(np.float32),
        floor_height_m=floor,
    )


def _foot_joints(feet: Footwork, turn: Rotation, floor: float) -> tuple[Floats, Floats]:
    """Return ankles and toes (N, 2, 3), metres."""
    n = len(feet.rise)
    offsets = OFFSETS[[SMPL24.index("left_foot"), SMPL24.index("right_foot")]]
    height = floor - offsets[:, 1] + feet.rise + feet.jump[:, None]
    ankles = np.stack([feet.ankle_xz[:, :, 0], height, feet.ankle_xz[:, :, 1]], axis=2)
    turned = turn.apply(np.tile(offsets, (n, 1))).reshape(n, 2, 3)
    flat_yaw = Rotation.from_euler("Y", feet.yaw_frames.reshape(-1, 1))
    flat = flat_yaw.apply(np.tile(offsets, (n, 1))).reshape(n, 2, 3)
    # Pivoting on the toe: the toe stays where it is with a flat foot, the ankle moves.
    ankles = ankles + np.where(feet.on_toe[:, :, None], flat - turned, 0.0)
    return ankles, ankles + turned


def _root_rotation(time: Timeline, feet: Footwork, rng: np.random.Generator) -> Rotation:
    """Return the orientation of the pelvis: the body's heading, with a different small lean on every key."""
    lean = time.ease(rng.uniform(-0.12, 0.12, (len(time.keys), 3)))
    lean[:, 0] += time.ease(feet.heading)
    return Rotation.from_euler("YXZ", lean)


def _pelvis(time: Timeline, feet: Footwork, root: Rotation, ankles: Floats, rng: np.random.Generator) -> Floats:
    """Return the pelvis joint (N, 3): over the standing foot, as high as both legs reach, bobbing on the beats."""
    # On a key the weight is already on the foot that stays down in the next interval.
    weight = np.select([feet.actions == LEFT, feet.actions == RIGHT], [0.3, 0.7], 0.5)
    weight = weight + rng.uniform(-0.1, 0.1, len(weight))
    pelvis = np.zeros((time.n_frames, 3))
    mix = weight[:, None] * feet.place[:, 0] + (1.0 - weight[:, None]) * feet.place[:, 1]
    pelvis[:, [0, 2]] = time.ease(mix)
    highest = np.full(time.n_frames, np.inf)
    for side, hip, knee, ankle in ((0, 1, 4, 7), (1, 2, 5, 8)):
        offset = root.apply(OFFSETS[hip])
        leg = _REACH * sum(np.linalg.norm(OFFSETS[[knee, ankle]], axis=1))
        apart = ankles[:, side, [0, 2]] - pelvis[:, [0, 2]] - offset[:, [0, 2]]
        drop = np.sqrt(leg**2 - (apart**2).sum(axis=1))
        highest = np.minimum(highest, ankles[:, side, 1] - feet.jump + drop - offset[:, 1])
    lowest = np.full(len(time.keys), np.inf)
    np.minimum.at(lowest, time.interval, highest)
    np.minimum.at(lowest, time.interval + 1, highest)
    # Keys beyond the last frame bound no frame.
    lowest = np.where(np.isinf(lowest), lowest[np.isfinite(lowest)].min(), lowest)
    depth = rng.uniform(0.03, 0.06)
    pelvis[:, 1] = time.ease(lowest) + feet.jump - depth * (1.0 - bump(time.beat_phase))
    return pelvis


def _solve_leg(
    side: int,
    rotations: Floats,
    root: Rotation,
    pelvis: Floats,
    ankle: Floats,
    foot_turn: Rotation,
    feet: Footwork,
) -> None:
    """Solve two-bone inverse kinematics: rotate hip and knee so that the ankle is exactly at `ankle` (N, 3)."""
    hip_j, knee_j, ankle_j, toe_j = np.array([1, 4, 7, 10]) + side
    thigh, shin = OFFSETS[knee_j], OFFSETS[ankle_j]
    a, b = np.linalg.norm(thigh), np.linalg.norm(shin)
    hip = pelvis + root.apply(OFFSETS[hip_j])
    line = ankle - hip
    reach = np.linalg.norm(line, axis=1, keepdims=True)
    line = line / reach
    # The knee points half way between where the body and the foot point.
    body = root.apply([0.0, 0.0, 1.0])
    yaw = feet.yaw_frames[:, side]
    ahead = body + np.stack([np.sin(yaw), np.zeros_like(yaw), np.cos(yaw)], axis=1)
    ahead = _unit(ahead - (ahead * line).sum(axis=1, keepdims=True) * line)
    cos = (a * a + reach**2 - b * b) / (2.0 * a * reach)
    knee = hip + a * (cos * line + np.sqrt(1.0 - cos**2) * ahead)
    lateral = np.cross(ahead, -line)
    upper = Rotation.from_matrix(_frame(-(knee - hip), -lateral) @ _frame(-thigh, [1.0, 0, 0]).T)
    lower = Rotation.from_matrix(_frame(-(ankle - knee), -lateral) @ _frame(-shin, [1.0, 0, 0]).T)
    rotations[:, hip_j] = (root.inv() * upper).as_rotvec()
    rotations[:, knee_j] = (upper.inv() * lower).as_rotvec()
    rotations[:, ankle_j] = (lower.inv() * foot_turn).as_rotvec()
    # While the heel is up the toes bend back to the floor.
    rotations[:, toe_j, 0] = np.where(feet.on_toe[:, side], -feet.pitch[:, side], 0.0)


def _frame(up: Floats, lateral: Floats | list[float]) -> Floats:
    """Return rotation matrices (..., 3, 3) with y column along `up` and x column nearest to `lateral`."""
    y = _unit(np.asarray(up))
    x = np.broadcast_to(np.asarray(lateral, dtype=np.float64), y.shape)
    x = _unit(x - (x * y).sum(axis=-1, keepdims=True) * y)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _unit(vectors: Floats) -> Floats:
    unit: Floats = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


def _upper_body(time: Timeline, rng: np.random.Generator) -> Floats:
    """Return rotations (N, 24, 3) of spine, head and arms; the others are zero."""
    count = len(time.keys)
    keys = np.zeros((count, 24, 3))
    for joint, size in (("spine1", 0.1), ("spine2", 0.12), ("spine3", 0.12), ("neck", 0.15), ("head", 0.2)):
        keys[:, SMPL24.index(joint)] = rng.uniform(-size, size, (count, 3))
    left = _arm_poses(count, rng)
    right = np.where(rng.random(count)[:, None] < 0.5, left, _arm_poses(count, rng))
    for side, poses in (("left", left), ("right", right)):
        arm = _arm(poses + rng.normal(0.0, 8.0, poses.shape), rng)
        # Mirroring an axis-angle vector across x = 0: (a, b, c) -> (a, -b, -c).
        sign = np.array([1.0, 1.0, 1.0] if side == "left" else [1.0, -1.0, -1.0])
        for part, turn in zip(("collar", "shoulder", "elbow", "wrist", "hand"), arm, strict=True):
            keys[:, SMPL24.index(f"{side}_{part}")] = turn * sign
    rotations = time.ease(keys)
    nod = 1.0 - bump(time.beat_phase)
    for joint, size in (("spine1", 0.06), ("spine2", 0.05), ("neck", 0.08), ("head", 0.05)):
        rotations[:, SMPL24.index(joint), 0] += size * nod
    return rotations


def _arm_poses(count: int, rng: np.random.Generator) -> Floats:
    """Return mixtures of rows of _ARMS (K, 4), a different one on every key."""
    hops = rng.integers(1, len(_ARMS), count)
    poses: Floats = _ARMS[np.cumsum(hops) % len(_ARMS)]
    # Mixed with the previous pose, so that no hand moves faster than a dancer's.
    previous = np.concatenate([poses[:1], poses[:-1]])
    return 0.7 * poses + 0.3 * previous


def _arm(degrees: Floats, rng: np.random.Generator) -> tuple[Floats, ...]:
    """Return collar, shoulder, elbow, wrist, hand axis-angle (K, 3) of the left arm, radians."""
    count = len(degrees)
    shoulder = Rotation.from_euler("YZX", degrees[:, :3], degrees=True).as_rotvec()
    elbow = np.zeros((count, 3))
    elbow[:, 1] = -np.deg2rad(np.clip(degrees[:, 3], 2.0, 125.0))
    collar = rng.uniform(-0.08, 0.08, (count, 3))
    collar[:, 2] += 0.0025 * degrees[:, 1]  # the collar rises with the arm
    return collar, shoulder, elbow, rng.uniform(-0.4, 0.4, (count, 3)), rng.uniform(-0.2, 0.2, (count, 3))


def _wrap_some(rotations: Floats, rng: np.random.Generator) -> None:
    """Replace some rotations by the complement (2 pi - angle) about the opposite axis, as in published files."""
    joint = int(rng.choice([0, SMPL24.index("left_shoulder"), SMPL24.index("right_shoulder")]))
    start = int(rng.integers(0, max(1, len(rotations) - 45)))
    part = rotations[start : start + 45, joint]
    angle = np.linalg.norm(part, axis=1, keepdims=True)
    chosen = angle[:, 0] > 0.9
    part[chosen] *= 1.0 - 2.0 * np.pi / angle[chosen]
