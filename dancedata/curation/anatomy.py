"""Faults of a body and of its place on the floor: sliding, penetration, drift, bones, joint limits, self-contact."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.tracks import lengths, runs
from dancedata.curation.spans import Span, bridged, worst_spans
from dancedata.metrics.body import lowest_of_stretches
from dancedata.metrics.groups import LIMB_RADIUS_M, segment_distances

#: Heights of an ankle and a toe of a flat foot above their own lowest tenth, metres: half of Lodge's limits, which
#: also take in feet that swing. How long a foot stays there, seconds.
_ANKLE_M, _TOE_M, _LEAST_CONTACT_S = 0.04, 0.025, 0.1
#: A foot slides above this speed, metres per second (Lodge); shorter pauses do not divide a slide, seconds.
_SLIDES_M_S, _PAUSE_S = 0.3, 0.05
#: Angles beyond which joints are not bent, degrees. Knees and elbows, forwards and backwards: active range of motion
#: (American Academy of Orthopaedic Surgeons 1965; Soucie et al. 2011, tables of ages 9 to 44) with the 30 degrees
#: that fitted bodies of real dancers go beyond it.
_HINGES = {"knee": (-35.0, 175.0), "elbow": (-40.0, 180.0)}
#: Other joints, from their pose at rest, in any direction.
_SWINGS = {"ankle": 90.0, "wrist": 120.0, "neck": 90.0, "head": 90.0, "spine1": 75.0, "spine2": 75.0, "spine3": 75.0}
#: Limbs that may not lie in each other: those of the arms against the torso, the head and the legs, and left against
#: right below the knees and elbows. Each is the bone that ends in the joint.
_ARMS, _TRUNK = ("elbow", "wrist"), ("spine2", "spine3", "neck", "head")
#: Part of the radii of limbs (`metrics.groups.LIMB_RADIUS_M`) that is their core: skin and clothes touch.
_CORE = 0.6


def floor_trend(motion: Motion) -> tuple[float, float] | None:
    """Return the slope of the floor, metres per frame, and how far it moves over the motion, metres.

    The Theil-Sen slope (the median of the slopes of all pairs) of the lowest foot joints of stretches of 2 s: jumps
    and floor work move some of them. The second is 0 where the middle half of the stretches is scattered about the
    line by more than half of what it rises. None for less than three stretches.
    """
    frames, heights = lowest_of_stretches(motion.joints(), float(motion.grid.rate), motion.skeleton)
    if len(frames) < 3:
        return None
    first, second = np.triu_indices(len(frames), 1)
    slope = float(np.median((heights[second] - heights[first]) / (frames[second] - frames[first])))
    rest = heights - slope * frames
    moved = slope * (motion.n_frames - 1)
    low, high = np.quantile(rest, (0.25, 0.75))
    return slope, moved if high - low <= abs(moved) / 2 else 0.0


def floor_of(joints: Float64Array, rate: float, skeleton: Skeleton) -> float:
    """Return the height of the floor: the median of the lowest foot joints of stretches of 2 s, metres."""
    heights = lowest_of_stretches(joints, rate, skeleton)[1]
    return float(np.median(heights)) if len(heights) else float(joints[:, list(skeleton.feet), 1].min())


def penetration(joints: Float64Array, rate: float, skeleton: Skeleton, least: float) -> tuple[Span, ...]:
    """Return the spans in which joints (T, J, 3) are deeper than `least` below the floor, metres."""
    depth = floor_of(joints, rate, skeleton) - joints[..., 1]
    return worst_spans(depth, least, skeleton.joints)


def sliding(joints: Float64Array, rate: float, skeleton: Skeleton, least: float) -> tuple[Span, ...]:
    """Return the spans in which a foot on the floor slides by at least `least`, metres."""
    spans = []
    for ankle, toe in ((0, 2), (1, 3)):
        pair = [skeleton.feet[ankle], skeleton.feet[toe]]
        heights = joints[:, pair, 1]
        above = heights - np.quantile(heights, 0.1, axis=0)
        low = np.asarray((above <= (_ANKLE_M, _TOE_M)).all(axis=1))
        on_floor = np.zeros(len(low), dtype=np.bool_)
        for start, stop in runs(low, _LEAST_CONTACT_S * rate):
            on_floor[start:stop] = True
        step = lengths(np.diff(joints[:, pair][..., (0, 2)], axis=0)).min(axis=1)
        slides = bridged((step * rate > _SLIDES_M_S) & on_floor[:-1] & on_floor[1:], _PAUSE_S * rate)
        for start, stop in runs(slides & on_floor[:-1]):
            path = float(step[start:stop].sum())
            if path >= least:
                spans.append(Span(start, stop + 1, path, skeleton.joints[skeleton.feet[toe]]))
    return tuple(sorted(spans))


def joint_limits(motion: Motion, least: float) -> tuple[Span, ...]:
    """Return the spans in which a joint is bent beyond its range by more than `least`, degrees."""
    beyond, names = [], []
    matrices, joints = motion.matrices, motion.skeleton.joints
    for side in ("left", "right"):
        for hinge, (low, high) in _HINGES.items():
            joint = motion.skeleton.index(f"{side}_{hinge}")
            bend = _bend(
                matrices[:, joint], motion.skeleton.offsets[motion.skeleton.parents.index(joint)], hinge, side
            )
            beyond.append(np.maximum(bend - high, low - bend))
            names.append(f"{side}_{hinge}")
    for joint, name in enumerate(joints):
        limit = _SWINGS.get(name.removeprefix("left_").removeprefix("right_"))
        if limit is not None and joint in motion.skeleton.parents:
            bone = motion.skeleton.offsets[motion.skeleton.parents.index(joint)]
            turned = (matrices[:, joint] * bone).sum(axis=-1)
            cosine = (turned * bone).sum(axis=-1) / max(float(bone @ bone), 1e-12)
            beyond.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))) - limit)
            names.append(name)
    return worst_spans(np.stack(beyond, axis=1), least, tuple(names))


def _bend(matrices: Float64Array, bone: npt.NDArray[np.float64], hinge: str, side: str) -> Float64Array:
    """Return the bend of a knee or an elbow, (T,), degrees: 0 straight, positive the way it bends."""
    turned = (matrices * bone).sum(axis=-1)
    if hinge == "knee":
        bend = np.degrees(np.arctan2(-turned[:, 2], -turned[:, 1]))
    else:
        bend = np.degrees(np.arctan2(turned[:, 2], turned[:, 0] if side == "left" else -turned[:, 0]))
    # A heel beyond the thigh is not a knee the wrong way round.
    return np.asarray(np.where(bend < -90, bend + 360, bend))


def self_contact(joints: Float64Array, least: float) -> tuple[Span, ...]:
    """Return the spans in which limbs, capsules of 0.6 of their radii, overlap by more than `least`, metres."""
    depths, names = [], []
    for one, other in _PAIRS:
        reach = _CORE * (LIMB_RADIUS_M[one] + LIMB_RADIUS_M[other])
        a, b = (joints[:, SMPL24.parents[joint]] for joint in (one, other))
        depths.append(reach - segment_distances(a, joints[:, one], b, joints[:, other]))
        names.append(SMPL24.joints[one])
    return worst_spans(np.stack(depths, axis=1), least, tuple(names))


def _pairs() -> tuple[tuple[int, int], ...]:
    index = SMPL24.index
    pairs = []
    for side in ("left", "right"):
        for limb in _ARMS:
            # An upper arm hangs at the chest.
            others = [*(_TRUNK if limb == "wrist" else ("neck", "head")), "left_knee", "right_knee"]
            pairs += [(index(f"{side}_{limb}"), index(other)) for other in others]
    for limb in ("wrist", "ankle"):
        pairs.append((index(f"left_{limb}"), index(f"right_{limb}")))
    return tuple(pairs)


_PAIRS = _pairs()
