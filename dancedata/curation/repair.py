"""Repairs of motion: spikes, gaps, the floor, jitter. What was repaired is listed frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dancedata.core.motion import Motion
from dancedata.core.quality import Flag
from dancedata.core.rotations import Float64Array, rotation, slerp
from dancedata.core.skeleton import Skeleton
from dancedata.curation.anatomy import floor_trend
from dancedata.curation.glitches import JITTER_HZ, frozen, jitter, low_pass, spike_groups, spikes
from dancedata.curation.scores import MEASURES

#: Raised by hand when a repair gives other numbers for the same motion.
VERSION = 1
#: Departures of a joint's rotation, degrees, and of the root, metres, that a spike below it is not due to.
_TURNED_DEG, _MOVED_M = 2.0, 0.01
#: Smaller spikes that a repair leaves do not count, metres.
_TRIFLE_M = 0.03


@dataclass(frozen=True)
class Repaired:
    """A motion, and a flag for each frame and joint that a repair changed; one without a frame is of all frames."""

    motion: Motion
    flags: tuple[Flag, ...]


def repaired(motion: Motion, limits: Mapping[str, float]) -> Repaired:
    """Make the repairs that have a limit, in the order of `STAGES`; motion without faults is returned as it is."""
    flags: list[Flag] = []
    for name, stage in STAGES.items():
        if name in limits:
            motion, stage_flags = stage(motion, limits[name])
            flags += stage_flags
    return Repaired(motion, tuple(flags))


def repair_spikes(motion: Motion, least_m: float) -> tuple[Motion, list[Flag]]:
    """Interpolate the frames of spikes, from the frame before to the one after.

    First of the joints above the spike alone, those that are turned there. Where that leaves a spike at least as
    large, as with joints that compensate each other, of the whole pose. Where that does not help either, frames stay
    as they are. Rotations are interpolated by slerp, places by a cubic.
    """
    flags: list[Flag] = []
    for group in spike_groups(spikes(motion, least_m)):
        start, stop = min(s.start for s in group), max(s.end for s in group)
        above = {joint for spike in group for joint in _above(motion.skeleton, spike.joint)}
        largest = max(spike.size_m for spike in group)
        for joints in (above, set(range(motion.skeleton.n_joints))):
            changed, touched = _interpolated(motion, start, stop, joints)
            if _largest(changed, start, stop) < largest:
                names, rate = motion.skeleton.joints, str(motion.grid)
                flags += [Flag("repaired_spike", names[j], f, round(largest, 4), "m", rate) for f, j in touched]
                motion = changed
                break
    return motion, sorted(flags, key=lambda flag: (flag.frame or 0, flag.joint))


def _interpolated(
    motion: Motion, start: int, stop: int, joints: Collection[int]
) -> tuple[Motion, list[tuple[int, int]]]:
    """Return the motion with frames [start, stop) interpolated, and the frames and joints that changed."""
    translation, rotations = np.array(motion.translation), np.array(motion.rotations)
    frames, before = np.arange(start, stop), start - 1
    between = slerp(motion.rotations[[before, stop]], (frames - before) / (stop - before))
    turned = np.degrees((rotation(motion.rotations[frames]).inv() * rotation(between)).magnitude()).max(axis=0)
    changed = {joint for joint in joints if turned[joint] > _TURNED_DEG}
    for joint in changed:
        rotations[frames, joint] = between[:, joint]
    places = _cubic(motion.translation, before, stop)
    if float(np.abs(places - motion.translation[frames]).max()) > _MOVED_M:
        translation[frames] = places
        changed.add(0)
    touched = [(frame, joint) for frame in frames.tolist() for joint in sorted(changed)]
    return replace(motion, translation=translation, rotations=rotations), touched


def _largest(motion: Motion, start: int, stop: int) -> float:
    """Return the size of the largest spike about frames [start, stop), metres; 0 without."""
    around = round(float(motion.grid.rate))
    first, last = max(start - around, 0), min(stop + around, motion.n_frames)
    left = spikes(motion.part(first, last), _TRIFLE_M)
    return max((s.size_m for s in left if s.start + first <= stop + 2 and s.end + first >= start - 2), default=0.0)


def fill_gaps(motion: Motion, longest_s: float) -> tuple[Motion, list[Flag]]:
    """Interpolate frozen spans of at most `longest_s` from the last frame before them to the first one after."""
    rate = float(motion.grid.rate)
    spans = [(a, b) for a, b in frozen(motion) if a > 0 and b < motion.n_frames and b - a <= longest_s * rate]
    if not spans:
        return motion, []
    translation, rotations = np.array(motion.translation), np.array(motion.rotations)
    flags = []
    for start, stop in spans:
        frames = np.arange(start, stop)
        rotations[frames] = slerp(motion.rotations[[start - 1, stop]], (frames - start + 1) / (stop - start + 1))
        translation[frames] = _cubic(motion.translation, start - 1, stop)
        seconds = round((stop - start) / rate, 4)
        flags += [Flag("repaired_gap", "", frame, seconds, "s", str(motion.grid)) for frame in frames.tolist()]
    return replace(motion, translation=translation, rotations=rotations), flags


def level_floor(motion: Motion, least_m: float) -> tuple[Motion, list[Flag]]:
    """Take the slope of the floor off all frames, where it rises or sinks by more than `least_m`; frame 0 stays."""
    slope, moved = floor_trend(motion) or (0.0, 0.0)
    if abs(moved) <= least_m:
        return motion, []
    translation = np.array(motion.translation)
    translation[:, 1] -= slope * np.arange(motion.n_frames)
    flag = Flag("repaired_floor", "", None, round(moved, 4), "m", str(motion.grid))
    return replace(motion, translation=translation), [flag]


def smooth(motion: Motion, least_m: float) -> tuple[Motion, list[Flag]]:
    """Take everything above 10 Hz off all frames of a motion with jitter above `least_m` in half of them."""
    from scipy.spatial.transform import Rotation

    sizes = jitter(motion)
    size = 0.0 if sizes is None else float(np.median(sizes))
    if size <= least_m:
        return motion, []
    rate = float(motion.grid.rate)
    translation = low_pass(np.array(motion.translation), rate, JITTER_HZ)
    rotations = low_pass(_quaternions(motion.rotations), rate, JITTER_HZ)
    if translation is None or rotations is None:
        return motion, []
    flag = Flag("repaired_jitter", "", None, round(size, 4), "m", str(motion.grid))
    turns = Rotation.from_quat(rotations).as_rotvec()
    return replace(motion, translation=translation, rotations=turns), [flag]


#: By name, in their order: later ones would smear the faults that earlier ones remove.
STAGES: dict[str, Callable[[Motion, float], tuple[Motion, list[Flag]]]] = {
    "spikes": repair_spikes,
    "gaps": fill_gaps,
    "floor": level_floor,
    "smoothing": smooth,
}


#: Limits of the repairs that name none, and their units.
LIMITS = {
    "spikes": MEASURES["spikes"].limit,
    "gaps": 0.5,
    "floor": MEASURES["floor_drift"].limit,
    "smoothing": MEASURES["jitter"].limit,
}
UNITS = {"spikes": "m", "gaps": "s", "floor": "m", "smoothing": "m"}


def _above(skeleton: Skeleton, joint: int) -> list[int]:
    """Return the joints whose rotations place a joint: those from the root to its parent."""
    chain = []
    while (joint := skeleton.parents[joint]) >= 0:
        chain.append(joint)
    return chain[::-1]


def _cubic(places: Float64Array, before: int, after: int) -> Float64Array:
    """Return places between two frames on the cubic through them and their outer neighbours, at the ends a line."""
    if before == 0 or after == len(places) - 1:
        share = (np.arange(before + 1, after) - before)[:, None] / (after - before)
        return np.asarray(places[before] * (1 - share) + places[after] * share)
    from scipy.interpolate import CubicHermiteSpline

    slopes = [places[before] - places[before - 1], places[after + 1] - places[after]]
    spline = CubicHermiteSpline([before, after], places[[before, after]], slopes)
    return np.asarray(spline(np.arange(before + 1, after)))


def _quaternions(rotations: Float64Array) -> Float64Array:
    """Return unit quaternions (T, J, 4), each within 90 degrees of the one of the frame before."""
    quaternions = np.asarray(rotation(rotations).as_quat())
    products = (quaternions[1:] * quaternions[:-1]).sum(axis=-1)
    signs = np.cumprod(np.where(products < 0, -1.0, 1.0), axis=0)
    quaternions[1:] *= signs[..., None]
    return quaternions
