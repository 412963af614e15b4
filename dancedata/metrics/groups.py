"""Scores of a group of dancers in one world: realism, correlation, distances, contacts, collisions.

Group features and correlation follow aioz-ai/GCD b9524d8 (MIT; its kinetic features are fairmotion's, BSD); those of
a duet are Duolando's (Siyao et al., ICLR 2024); the intersection frequency is that of Le et al., CVPR 2023.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import Undefined, checked_group, checked_joints
from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.tracks import runs
from dancedata.metrics.arguments import IntArray, Up, axis_of, first_joints
from dancedata.metrics.beats import beat_alignment, motion_beats
from dancedata.metrics.kinetic_features import frame_features

#: Scale of kinetic features before the logarithm, of GCD's code.
_SCALE = 1.5
#: Joints of `duet_distances`: pelvis, ankles, feet, head, shoulders, wrists.
DUET_JOINTS = (0, 7, 8, 10, 11, 15, 16, 17, 20, 21)
#: Of `beat_echo`, frames.
_ECHO_SIGMA = 3.0
#: Joints of a body that `collisions` gives a thickness: SMPL's without hands.
_BODY = 22
#: Radius of the capsule round each bone of SMPL's first 22 joints, from its parent to the joint, metres.
LIMB_RADIUS_M = (
    0.0, 0.10, 0.10, 0.12, 0.07, 0.07, 0.12, 0.05, 0.05, 0.12, 0.04, 0.04, 0.06, 0.08, 0.08, 0.08, 0.06, 0.06,
    0.045, 0.045, 0.035, 0.035,
)  # fmt: skip
_WRISTS = (20, 21)


def group_kinetic(joints: Float64Array, fps: float, *, up: Up = "y") -> Float64Array:
    """Return the kinetic features of a group; GMR is the Frechet distance of two sets of them.

    For each joint the means over frames and dancers of the squared horizontal speed, the squared vertical speed and
    the acceleration, as `kinetic` has them with one frame on each side, each as log(1 + 1.5 x).

    Parameters
    ----------
    joints
        (P, T, J, 3) positions of P dancers, metres. Their order does not matter.
    fps
        Frames per second. GCD's code takes 30.
    up
        Vertical axis.

    Returns
    -------
    (3 J,) float64
        Joint 0 horizontal, vertical, energy, joint 1 horizontal, ...

    Raises
    ------
    Undefined
        "short": below 3 frames.
    """
    group = checked_group(joints)
    features = np.stack([frame_features(dancer, fps, up=up, half=1) for dancer in group]).mean(axis=(0, 1))
    return np.asarray(np.log(1 + _SCALE * features).ravel(), dtype=np.float64)


def group_correlation(joints: Float64Array, fps: float, *, up: Up = "y") -> float:
    """Return GMC, the group motion correlation: how alike the dancers move, whatever their timing.

    The mean over pairs of dancers of the mean, along the path of dynamic time warping of their positions, of the dot
    product of log(1 + 1.5 x), x the kinetic features of a frame (3 J). It has no upper bound and grows with
    the speed of the dance: compare it for the same music only.

    Parameters
    ----------
    joints
        (P, T, J, 3) positions of P >= 2 dancers, metres. Their order does not matter.
    fps
        Frames per second. GCD's code takes 30.
    up
        Vertical axis.

    Raises
    ------
    Undefined
        "few_dancers": fewer than 2. "short": below 3 frames.
    """
    group = checked_group(joints, least=2)
    features = [np.log(1 + _SCALE * frame_features(d, fps, up=up)).reshape(len(d) - 1, -1) for d in group]
    scores = []
    for a, b in combinations(range(len(group)), 2):
        path = warping_path(group[a].reshape(len(group[a]), -1), group[b].reshape(len(group[b]), -1))
        rows = path[(path < len(features[a])).all(axis=1)]
        scores.append(np.einsum("ij,ij->i", features[a][rows[:, 0]], features[b][rows[:, 1]]).mean())
    return float(np.mean(scores))


def warping_path(first: Float64Array, second: Float64Array) -> IntArray:
    """Return the path of dynamic time warping between rows (T, D) and (S, D), (L, 2) from (0, 0) to (T-1, S-1).

    The cost of a pair of rows is their squared Euclidean distance; steps are one row of either or of both. Of equal
    costs the step of both is preferred, then that of the first.
    """
    squares = (first**2).sum(axis=1)[:, None] + (second**2).sum(axis=1) - 2 * first @ second.T
    n, m = squares.shape
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0
    for diagonal in range(n + m - 1):
        i = np.arange(max(0, diagonal - m + 1), min(n, diagonal + 1))
        j = diagonal - i
        total[i + 1, j + 1] = squares[i, j] + np.minimum(total[i, j], np.minimum(total[i, j + 1], total[i + 1, j]))
    i, j = n, m
    path = [(n - 1, m - 1)]
    while (i, j) != (1, 1):
        step = int(np.argmin((total[i - 1, j - 1], total[i - 1, j], total[i, j - 1])))
        i, j = i - (step != 2), j - (step != 1)
        path.append((i - 1, j - 1))
    return np.asarray(path[::-1], dtype=np.int64)


def duet_distances(follower: Float64Array, leader: Float64Array) -> Float64Array:
    """Return the distances of ten joints of the follower to ten of the leader, (100,) metres, means over frames.

    FID_cd is the Frechet distance of two sets of them. The joints are `DUET_JOINTS`; entry 10 i + j is the follower's
    i-th to the leader's j-th.

    Parameters
    ----------
    follower, leader
        (T, J, 3) positions in one world, metres; the frames that both have are compared. At least 22 joints.

    Returns
    -------
    (100,) float64

    Raises
    ------
    DataError
        "missing_joints".
    """
    a, b = (first_joints(checked_joints(j), DUET_JOINTS[-1] + 1)[:, DUET_JOINTS] for j in (follower, leader))
    n = min(len(a), len(b))
    return np.asarray(np.linalg.norm(a[:n, :, None] - b[:n, None], axis=3).mean(axis=0).ravel(), dtype=np.float64)


def beat_echo(leader: Float64Array, follower: Float64Array, fps: float, *, detector: str = "bailando") -> float:
    """Return BED, the beat echo degree: how near a beat of the follower is to each beat of the leader, 0 to 1.

    Parameters
    ----------
    leader, follower
        (T, J, 3) positions, metres.
    fps
        Frames per second; only the detector "seconds" depends on it.
    detector
        A key of `DETECTORS`; Duolando's code takes "bailando".

    Raises
    ------
    Undefined
        "no_beats": one of the two has no beat.
    """
    beats = [motion_beats(joints, fps, detector=detector) for joints in (leader, follower)]
    if not all(map(len, beats)):
        found = f"{len(beats[0])} beats of the leader, {len(beats[1])} of the follower"
        raise Undefined("no_motion_beats", found=found)
    return beat_alignment(*beats, sigma=_ECHO_SIGMA)


def root_distances(joints: Float64Array) -> Float64Array:
    """Return the distances of the pelves of all dancers, (P, P, T) metres, of joints (P, T, J, 3)."""
    roots = checked_group(joints)[:, :, 0]
    return np.asarray(np.linalg.norm(roots[:, None] - roots, axis=3), dtype=np.float64)


def facing_angles(joints: Float64Array, *, up: Up = "y") -> Float64Array:
    """Return the angles by which dancers turn away from each other, (P, P, T) degrees: 0 faces the other, 180 not.

    Entry (a, b) is the horizontal angle between where the hips of a face and the direction from the pelvis of a to
    that of b. NaN on the diagonal, and where hips or dancers are above each other.

    Parameters
    ----------
    joints
        (P, T, J, 3) positions in one world, metres; the first three are pelvis, left hip and right hip.
    up
        Vertical axis.
    """
    group, axis = checked_group(joints), axis_of(up)
    ahead = np.cross(group[:, :, 1] - group[:, :, 2], np.eye(3)[axis])
    towards = group[None, :, :, 0] - group[:, None, :, 0]
    towards[..., axis] = 0
    cosine = (ahead[:, None] * towards).sum(axis=-1)
    length = np.linalg.norm(ahead, axis=-1)[:, None] * np.linalg.norm(towards, axis=-1)
    angles = np.full(length.shape, np.nan)
    np.divide(cosine, length, out=angles, where=length > 1e-9)
    return np.asarray(np.degrees(np.arccos(np.clip(angles, -1, 1))), dtype=np.float64)


class Contact(NamedTuple):
    """A stretch of frames in which a hand of a dancer is near a joint of another."""

    # `start`, `end`: frames, half-open
    start: int
    end: int
    # `joint`, `other_joint`: joint of the first dancer and of the second; one of them is a wrist
    joint: int
    other_joint: int
    distance_m: float  # the least distance


def contact_spans(
    first: Float64Array, second: Float64Array, *, within_m: float = 0.1, least_frames: int = 5
) -> list[Contact]:
    """Return the stretches in which a wrist of a dancer is near a joint of the other, by start.

    Parameters
    ----------
    first, second
        (T, J, 3) positions in one world, metres, at least 22 joints of SMPL or SMPL-X; the frames that both have.
    within_m
        Largest distance of the two joints. A palm is about 8 cm from its wrist.
    least_frames
        Shorter stretches are left out.
    """
    a, b = (first_joints(checked_joints(j), _BODY) for j in (first, second))
    n = min(len(a), len(b))
    spans = []
    for joint, other in ((i, j) for i in range(_BODY) for j in range(_BODY) if i in _WRISTS or j in _WRISTS):
        distance = np.linalg.norm(a[:n, joint] - b[:n, other], axis=1)
        spans += [
            Contact(start, end, joint, other, float(distance[start:end].min()))
            for start, end in runs(distance <= within_m, least_frames)
        ]
    return sorted(spans)


def collisions(joints: Float64Array, *, radius_m: Sequence[float] = LIMB_RADIUS_M) -> npt.NDArray[np.bool_]:
    """Return the frames in which bodies intersect, (P, P, T), symmetric, False on the diagonal.

    A body is the union of capsules round the bones of SMPL's first 22 joints.

    Parameters
    ----------
    joints
        (P, T, J, 3) positions, metres, at least 22 joints.
    radius_m
        Radius of the capsule between each joint and its parent; the first, the root's, is not used.
    """
    group = checked_group(joints)
    radius = np.asarray(radius_m, dtype=np.float64)
    if radius.shape != (_BODY,):
        raise UsageError("invalid radii of limbs", found=f"shape {radius.shape}", allowed=f"{_BODY} numbers")
    bodies = [first_joints(dancer, _BODY) for dancer in group]
    hits = np.zeros((len(bodies), len(bodies), group.shape[1]), dtype=np.bool_)
    for a, b in combinations(range(len(bodies)), 2):
        hits[a, b] = hits[b, a] = _bodies_meet(bodies[a], bodies[b], radius)
    return hits


def intersection_frequency(joints: Float64Array, *, radius_m: Sequence[float] = LIMB_RADIUS_M) -> float:
    """Return TIF, the trajectory intersection frequency: intersecting pairs (i, j), i != j, per frame.

    Le et al. 2023, Music-Driven Group Choreography. Both orders of a pair count, as in their sum. They test
    the meshes of SMPL, and their code is not public; here bodies are those of `collisions`, so published numbers do
    not compare.
    Arguments and errors as `collisions`.
    """
    return float(collisions(joints, radius_m=radius_m).sum(axis=(0, 1)).mean())


def _bodies_meet(first: Float64Array, second: Float64Array, radius: Float64Array) -> npt.NDArray[np.bool_]:
    """Return the frames (T,) in which a capsule of a body intersects one of the other."""
    meet = np.zeros(len(first), dtype=np.bool_)
    limbs = [(SMPL24.parents[joint], joint) for joint in range(1, _BODY)]
    low, high = second.min(axis=1), second.max(axis=1)
    for a in limbs:
        # Most frames of most limbs: the box round the limb is apart from that round the other body.
        limb = first[:, a]
        apart = np.maximum(low - limb.max(axis=1), limb.min(axis=1) - high).max(axis=1)
        near = np.flatnonzero((apart < radius[a[1]] + radius.max()) & ~meet)
        one, other = limb[near], second[near]
        for b in limbs if len(near) else ():
            distance = segment_distances(one[:, 0], one[:, 1], other[:, b[0]], other[:, b[1]])
            meet[near] |= distance < radius[a[1]] + radius[b[1]]
    return meet


def segment_distances(p: Float64Array, q: Float64Array, r: Float64Array, s: Float64Array) -> Float64Array:
    """Return the distances (T,) of the segments p q and r s, each point (T, 3).

    Ericson 2005, Real-Time Collision Detection, 5.1.9.
    """
    along, across, between = q - p, s - r, p - r
    a, e = (np.maximum((v * v).sum(axis=1), 1e-18) for v in (along, across))
    b, c, f = (along * across).sum(axis=1), (along * between).sum(axis=1), (across * between).sum(axis=1)
    area = a * e - b * b
    on_first = np.clip(np.divide(b * f - c * e, area, out=np.zeros_like(a), where=area > 1e-12 * a * e), 0, 1)
    on_second = np.clip((b * on_first + f) / e, 0, 1)
    on_first = np.clip((b * on_second - c) / a, 0, 1)
    gap = between + along * on_first[:, None] - across * on_second[:, None]
    return np.asarray(np.linalg.norm(gap, axis=1), dtype=np.float64)
