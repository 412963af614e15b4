"""Scores of a group of dancers in one world: realism, correlation, distances, contacts, collisions.

The group features and the correlation follow aioz-ai/GCD b9524d8 (MIT; its kinetic features are fairmotion's, BSD);
those of a duet are defined by Duolando (Siyao et al., ICLR 2024).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dancedata.core.dance import Undefined, checked_joints
from dancedata.core.errors import UsageError
from dancedata.core.rotations import Float64Array
from dancedata.metrics.arguments import IntArray, Up, first_joints
from dancedata.metrics.beats import beat_alignment, motion_beats
from dancedata.metrics.kinetic_features import frame_features

#: Scale of kinetic features before the logarithm, of GCD's code.
_SCALE = 1.5
#: Joints of `duet_distances`: pelvis, ankles, feet, head, shoulders, wrists.
DUET_JOINTS = (0, 7, 8, 10, 11, 15, 16, 17, 20, 21)
#: Of `beat_echo`, frames.
_ECHO_SIGMA = 3.0
_MIN_DANCERS = 2


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
        "single": fewer than 2 dancers. "short": below 3 frames.
    """
    group = _at_least_two(checked_group(joints))
    features = [np.log(1 + _SCALE * frame_features(dancer, fps, up=up)).reshape(len(dancer) - 1, -1) for dancer in group]
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
        raise Undefined("no_motion_beats", found=f"{len(beats[0])} beats of the leader, {len(beats[1])} of the follower")
    return beat_alignment(*beats, sigma=_ECHO_SIGMA)
