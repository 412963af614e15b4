"""Faults in time of any skeleton: spikes, frozen spans, jitter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array
from dancedata.core.tracks import lengths, runs
from dancedata.curation.spans import Span

#: Longest spike, seconds; at any rate up to two frames.
_SPIKE_S = 0.05
#: A spike is this many times as large as the median of such departures in a stretch of half a second.
_TIMES = 6.0
#: Part of the distance between the frames before and after that a spike exceeds, where movement does not explain it.
_RETURNS = 0.75
#: And this part of the steps beside it.
_BESIDE = 0.5
#: Part of the largest spike of a group that a joint has to be off to give it its name.
_MOST = 0.8
#: A pose is frozen if no joint moves by more than this, metres, for this long, and one moves by the third, metres per
#: second, in the step before or after.
_STILL_M, _LEAST_FROZEN_S, _FROM_M_S = 1e-5, 0.08, 0.3
#: Above this frequency, hertz, movement is jitter; and the stretches that are compared, seconds.
JITTER_HZ, _STRETCH_S = 10.0, 0.5
_MAD = 1.4826  # of the standard deviation of a normal distribution


class Spike(NamedTuple):
    """Frames [start, end) in which a joint leaves its path by `size_m` or more, and returns."""

    start: int
    end: int
    joint: int
    size_m: float


def _lagrange(at: int, width: int) -> Float64Array:
    """Return the weights of frames -2, -1, width and width + 1 in the cubic through them at frame `at`."""
    nodes = (-2, -1, width, width + 1)
    weights = [np.prod([(at - other) / (node - other) for other in nodes if other != node]) for node in nodes]
    return np.asarray(weights, dtype=np.float64)


def _departures(tracks: Float64Array, width: int) -> Float64Array:
    """Return how far frames t .. t + width - 1 are from the cubic through their neighbours, least of them."""
    n = len(tracks) - width - 3
    least = np.zeros(tracks.shape[:2])
    nodes = [tracks[k : k + n] for k in (0, 1, width + 2, width + 3)]
    off = []
    for at in range(width):
        expected = sum(weight * node for weight, node in zip(_lagrange(at, width), nodes, strict=True))
        off.append(lengths(tracks[2 + at : 2 + at + n] - expected))
    least[2 : 2 + n] = np.min(off, axis=0)
    return least


def _excuses(tracks: Float64Array, width: int) -> Float64Array:
    """Return the least departure that the neighbours of frames [t, t + width) do not explain, (T, K), metres."""
    n = len(tracks) - width - 3
    least = np.zeros(tracks.shape[:2])
    before, start, end, after = (tracks[k : k + n] for k in (0, 1, width + 2, width + 3))
    moves = np.maximum(lengths(start - before), lengths(after - end))
    apart = lengths(end - start) - (width + 1) * moves
    least[2 : 2 + n] = np.maximum(_RETURNS * apart, _BESIDE * moves)
    return least


def spikes(motion: Motion, least_m: float) -> list[Spike]:
    """Return the spikes of at least `least_m`, in order of their frames.

    A spike is one frame or a few whose joint lies off the cubic through the two frames before and the two after,
    while these agree with each other. Its frames are all off by at least `least_m`, and by six times the median of
    that in a stretch of half a second: fast movement has large departures everywhere.
    """
    tracks = motion.joints()
    rate = float(motion.grid.rate)
    # Four frames of the cubic, and those of the spike.
    widest = min(max(2, round(_SPIKE_S * rate)), len(tracks) - 4)
    candidates: list[tuple[float, int, int, int]] = []
    for width in range(1, widest + 1):
        off = _departures(tracks, width)
        where = (off >= least_m) & (off > _TIMES * _usual(off, rate)) & (off > _excuses(tracks, width))
        for start, track in np.argwhere(where).tolist():
            candidates.append((-round(float(off[start, track]), 6), width, start, track))
    taken: dict[int, list[tuple[int, int]]] = {}
    kept = []
    for size, width, start, track in sorted(candidates):
        # Frames beside a spike are off as well, by up to two thirds.
        if all(start >= b + 2 or start + width <= a - 2 for a, b in taken.setdefault(track, [])):
            taken[track].append((start, start + width))
            kept.append(Spike(start, start + width, track, -size))
    return sorted(kept)


def _usual(off: Float64Array, rate: float) -> Float64Array:
    """Return the median of departures (T, K) in stretches of half a second, (T, K)."""
    size = max(5, round(_STRETCH_S * rate))
    starts = range(0, max(len(off) - size // 2, 1), size)
    usual = np.empty_like(off)
    for start in starts:
        stop = start + size if start != starts[-1] else len(off)
        usual[start:stop] = np.median(off[start:stop], axis=0)
    return usual


def frozen(motion: Motion) -> list[tuple[int, int]]:
    """Return the frames [start, stop) that repeat the frame before, while the dancer moves before or after."""
    steps = lengths(np.diff(motion.joints(), axis=0)).max(axis=1)
    rate = float(motion.grid.rate)
    limit = _FROM_M_S / rate
    spans = []
    for start, stop in runs(steps <= _STILL_M, max(2, _LEAST_FROZEN_S * rate)):
        into = steps[start - 1] if start else 0.0
        out = steps[stop] if stop < len(steps) else 0.0
        if max(into, out) > limit:
            spans.append((start + 1, stop + 1))
    return spans


def jitter(motion: Motion) -> Float64Array | None:
    """Return the size of movement above 10 Hz of the median joint, (T,), metres, in half a second around a frame."""
    from scipy.ndimage import median_filter

    joints, rate = motion.joints(), float(motion.grid.rate)
    low = low_pass(joints, rate, JITTER_HZ)
    if low is None:
        return None
    size = 2 * round(_STRETCH_S * rate / 2) + 1
    around = median_filter(lengths(joints - low), size=(size, 1), mode="nearest")
    return np.asarray(_MAD * np.median(around, axis=1))


def low_pass(values: Float64Array, rate: float, hertz: float) -> Float64Array | None:
    """Return values (T, ...) below a frequency, without delay; None where there is nothing above it."""
    from scipy.signal import butter, sosfiltfilt

    if rate < 2.5 * hertz or len(values) < 16:
        return None
    sections = butter(4, hertz, fs=rate, output="sos")
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=min(15, len(values) - 1)))


def spike_groups(found: Sequence[Spike]) -> list[list[Spike]]:
    """Return spikes in groups that share frames, or lie side by side."""
    groups: list[list[Spike]] = []
    for spike in found:
        if groups and spike.start <= max(other.end for other in groups[-1]):
            groups[-1].append(spike)
        else:
            groups.append([spike])
    return groups


def spike_spans(motion: Motion, least_m: float) -> tuple[Span, ...]:
    """Return a span for each group of `spikes`, with the first joint from the root that is off by most of it."""
    spans = []
    for group in spike_groups(spikes(motion, least_m)):
        largest = max(spike.size_m for spike in group)
        joint = min(spike.joint for spike in group if spike.size_m >= _MOST * largest)
        start, end = min(spike.start for spike in group), max(spike.end for spike in group)
        spans.append(Span(start, end, largest, motion.skeleton.joints[joint]))
    return tuple(spans)
