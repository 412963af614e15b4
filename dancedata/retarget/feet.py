"""Feet that stay where they stand: contacts of the source, and two-bone inverse kinematics of the legs."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from dancedata.core.motion import Motion, joint_positions, world_matrices
from dancedata.core.rotations import Float64Array, matrix_from_rotvec, rotvec_from_matrix, shortest_rotation
from dancedata.core.skeleton import Skeleton
from dancedata.core.tracks import lengths, runs

#: A foot stands where its toe moves slower than this, metres per second, and is this near to its floor, metres.
_MAX_SPEED_M_S = 0.25
_MAX_HEIGHT_M = 0.06
#: The floor of a foot is this quantile of its heights: a dancer's toes go below it by noise only.
_FLOOR = 0.02
#: Contacts that last less than this, seconds, are swings of the leg.
_LEAST_S = 0.1
#: Corrections fade out over this before and after a contact, seconds.
_FADE_S = 0.2
#: Above this, radians, the axis of a knee is that about which it is bent.
_BENT = float(np.radians(20))
#: A leg is straightened up to this fraction of its length, so that the knee keeps its direction.
_REACH = 0.9995

_LEGS = ((1, 4, 7, 10), (2, 5, 8, 11))
Bools = npt.NDArray[np.bool_]


def contact_spans(feet: Float64Array, rate: float) -> list[tuple[int, int]]:
    """Return first and last + 1 frame of each contact of a foot, from its toe (T, 3), metres, +Y up."""
    if len(feet) < 2:
        return []
    steps = np.linalg.norm(np.diff(feet, axis=0), axis=1) * rate
    slow = np.maximum(np.append(steps, steps[-1]), np.insert(steps, 0, steps[0])) < _MAX_SPEED_M_S
    standing = slow & (feet[:, 1] < np.quantile(feet[:, 1], _FLOOR) + _MAX_HEIGHT_M)
    return runs(standing, _LEAST_S * rate)


def sliding(feet: Float64Array, spans: list[tuple[int, int]]) -> tuple[float, int]:
    """Return the horizontal path of a foot (T, 3) in its contacts, metres, and the number of steps between frames."""
    paths = [np.linalg.norm(np.diff(feet[first:stop, ::2], axis=0), axis=1) for first, stop in spans]
    return float(sum(path.sum() for path in paths)), sum(len(path) for path in paths)


def with_planted_feet(motion: Motion, wanted: Float64Array, spans: list[list[tuple[int, int]]]) -> Motion:
    """Bend the legs so that each foot moves in its contacts as in the source."""
    skeleton, rate = motion.skeleton, float(motion.grid.rate)
    world = world_matrices(skeleton, motion.matrices).copy()
    joints = joint_positions(skeleton, world, motion.translation)
    for side, leg in enumerate(_LEGS):
        moves = _corrections(joints[:, leg[3]], wanted[:, side], spans[side], round(_FADE_S * rate))
        frames = np.flatnonzero(np.abs(moves).max(axis=1) > 1e-9)
        if len(frames):
            _bend(world, joints, frames, leg, moves[frames])
    local = motion.rotations.copy()
    for leg in _LEGS:
        for joint in leg[:3]:
            above = np.swapaxes(world[:, skeleton.parents[joint]], -1, -2)
            local[:, joint] = rotvec_from_matrix(above @ world[:, joint])
    return replace(motion, rotations=local)


def _corrections(toes: Float64Array, wanted: Float64Array, spans: list[tuple[int, int]], fade: int) -> Float64Array:
    """Return how far to move a foot in each frame, (T, 3) metres: exactly in contacts, fading out around them."""
    moves, weights = np.zeros_like(toes), np.zeros(len(toes))
    exact = np.zeros(len(toes), dtype=bool)
    for first, stop in spans:
        part = slice(first, stop)
        apart = wanted[part] - toes[part]
        apart[:, ::2] -= apart[:, ::2].mean(axis=0)
        moves[part], weights[part], exact[part] = apart, 1.0, True
    between, total = np.zeros_like(toes), np.zeros(len(toes))
    for first, stop in spans:
        for edge, way in ((first, -1), (stop - 1, 1)):
            frames = edge + way * np.arange(1, fade + 1)
            inside = (frames >= 0) & (frames < len(toes))
            share = np.arange(1, fade + 1)[inside] / (fade + 1)
            weight = 1 - share * share * (3 - 2 * share)
            odds = weight / (1 - weight)
            between[frames[inside]] += odds[:, None] * moves[edge]
            total[frames[inside]] += odds
    faded = between / (1 + total)[:, None]
    return np.asarray(np.where(exact[:, None], moves, faded))


def _bend(
    world: Float64Array, joints: Float64Array, frames: npt.NDArray[np.intp], leg: tuple[int, ...], moves: Float64Array
) -> None:
    """Change the rotations of a thigh and a shin in the world, in place."""
    hip, knee, ankle = (joints[frames, joint] for joint in leg[:3])
    target = ankle + moves
    thigh, shin, line = knee - hip, ankle - knee, target - hip
    a, b = lengths(thigh), lengths(shin)
    straight = np.maximum(_REACH * (a + b), lengths(ankle - hip))
    reach = np.clip(lengths(line), np.abs(a - b) + 1e-6, straight)
    bend = np.arccos(np.clip((reach**2 - a**2 - b**2) / (2 * a * b), -1, 1))
    along = thigh / a[:, None]
    folded = matrix_from_rotvec(_knee(along, shin, world[frames, leg[0], :, 0], bend))
    bent = np.einsum("tij,tj->ti", folded, along) * b[:, None]
    swing = shortest_rotation(thigh + bent, line)
    world[frames, leg[0]] = swing @ world[frames, leg[0]]
    world[frames, leg[1]] = swing @ shortest_rotation(shin, bent) @ world[frames, leg[1]]


def _knee(thigh: Float64Array, shin: Float64Array, left: Float64Array, bend: Float64Array) -> Float64Array:
    """Return the rotation vectors (T, 3) from the direction of a thigh to that of a shin, the knee bent by `bend`.

    A bent knee keeps its axis. That of a straight one is noise, and reversed in a knee that is bent the wrong way by
    a degree: from 20 degrees down to 0 it goes over to the left of the thigh, about which SMPL's knees bend. The
    result is continuous: it passes through the straight leg where the axis is reversed, less than `bend` there.
    """
    axis = np.cross(thigh, shin)
    sine = lengths(axis)
    now = np.arctan2(sine, (thigh * shin).sum(axis=1))
    axis /= np.maximum(sine, 1e-12)[:, None]
    left = left - (left * thigh).sum(axis=1, keepdims=True) * thigh
    left /= np.maximum(lengths(left), 1e-12)[:, None]
    known = np.minimum(now / _BENT, 1.0)[:, None]
    more = (known * axis + (1 - known) * left) * np.maximum(bend - now, 0)[:, None]
    vector = axis * np.minimum(now, bend)[:, None] + more
    size = lengths(vector)
    return np.asarray(vector * (np.minimum(bend, 2 * size) / np.maximum(size, 1e-12))[:, None])


def toes_of(places: Float64Array, joints: tuple[int, ...], skeleton: Skeleton, body: Float64Array) -> Float64Array:
    """Return (T, 2, 3): left and right toe of the source, or of its body on SMPL's joints where it has none."""
    toes = [places[:, joints.index(j)] if j in joints else body[:, j] for j in skeleton.feet[2:]]
    return np.stack(toes, axis=1)
