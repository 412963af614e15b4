"""Events of a dance that need no model: turns, jumps, travel, energy, floor work, contacts of partners.

The limits are this package's own, in units of the body and the world; tests plant events and count what is found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.tracks import runs
from dancedata.metrics.groups import contact_spans

#: A body turns faster than the first, degrees per second, in all frames of a turn, and than the second in some.
_TURNING = (15.0, 90.0)
#: Hips nearer to upright than this share of their width have no heading.
_LEVEL = 0.5
#: Least clearance of the lowest joint in all and in some frames of a flight, metres.
_CLEAR_M = (0.02, 0.05)
#: Downward acceleration of the body's middle in all and in some frames of a jump; time that its ends may miss.
_FALLING_M_S2, _EDGE_S = (4.0, 6.0), 0.07
#: Speed of the root in all and in some frames of travel, metres per second.
_TRAVELLING = (0.3, 0.6)
#: Mean speed of joints relative to the root below which a body is still, above which its energy is high; seconds.
_STILL_M_S, _HIGH_M_S, _LEAST_ENERGY_S = 0.1, 1.2, 1.0
#: Height of the root above the floor in floor work, in lengths of a leg; seconds.
_DOWN, _LEAST_DOWN_S = 0.55, 0.5
#: Least time that a partner is off the floor in a lift, and that hands touch, seconds.
_LEAST_LIFT_S, _LEAST_CONTACT_S = 0.5, 0.2
#: Largest distance of a wrist from a joint that it touches, metres.
_TOUCH_M = 0.1


@dataclass(frozen=True)
class Event:
    """Frames [start, end) of a dancer, a number, and a sentence."""

    label: str
    start: int
    end: int
    value: float
    text: str
    # `other`, `joint`: the partner's number in the group, and the dancer's own joint in a contact; -1 without
    other: int = -1
    joint: int = -1
    data: Mapping[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class MovingBody:
    """Joint positions (T, J, 3) of a dancer, metres, +Y up, at `fps`; `floor_m` is the height of the floor."""

    joints: Float64Array
    fps: float
    skeleton: Skeleton
    floor_m: float

    @classmethod
    def of(cls, joints: Float64Array, fps: float, skeleton: Skeleton, floor_m: float | None = None) -> MovingBody:
        """Make a body on a given floor, by default on its own: the height that the lowest joint has most often."""
        return cls(joints, fps, skeleton, _lowest_often(joints) if floor_m is None else floor_m)

    def smooth(self, values: Float64Array, seconds: float) -> Float64Array:
        """Return values smoothed along time by a Gaussian."""
        from scipy.ndimage import gaussian_filter1d

        return np.asarray(gaussian_filter1d(values, seconds * self.fps, axis=0, mode="nearest"))

    def rate(self, values: Float64Array) -> Float64Array:
        """Return the change of values per second."""
        return np.gradient(values, axis=0) * self.fps if len(values) > 1 else np.zeros_like(values)

    @cached_property
    def hips(self) -> tuple[int, int] | None:
        """Left and right joint that hang from the root; None where a skeleton has none."""
        parents = self.skeleton.parents
        return next((pair for pair in self.skeleton.pairs if parents[pair[0]] == parents[pair[1]] == 0), None)

    @cached_property
    def across(self) -> Float64Array:
        """Vector from the right hip to the left one, (T, 3)."""
        left, right = self.hips or (0, 0)
        return self.joints[:, left] - self.joints[:, right]

    @cached_property
    def has_heading(self) -> npt.NDArray[np.bool_]:
        """Whether the hips are level enough for a heading, (T,)."""
        width = max(float(np.median(np.linalg.norm(self.across, axis=1))), 1e-9)
        return np.asarray(np.linalg.norm(self.across[:, [0, 2]], axis=1) > _LEVEL * width, dtype=np.bool_)

    @cached_property
    def heading(self) -> Float64Array:
        """Angle of the body about +Y in degrees, (T,), without jumps; it grows in a turn to the left."""
        return np.degrees(np.unwrap(np.arctan2(-self.across[:, 2], self.across[:, 0])))

    @cached_property
    def clearance(self) -> Float64Array:
        """Height of the lowest joint above the floor, (T,), metres."""
        return np.asarray(self.joints[..., 1].min(axis=1) - self.floor_m)

    @cached_property
    def leg_m(self) -> float:
        """Length of a leg: the bones from the root to the ankle."""
        joint, length = self.skeleton.feet[0], 0.0
        while joint > 0:
            length += float(np.linalg.norm(self.skeleton.offsets[joint]))
            joint = self.skeleton.parents[joint]
        return length


def _lowest_often(joints: Float64Array) -> float:
    """Return the height of the floor under joints (T, J, 3), a tenth quantile of that of the lowest joint."""
    return float(np.quantile(joints[..., 1].min(axis=1), 0.1))


def spans_of(
    body: MovingBody, values: Float64Array, least: float, peak: float, seconds: float
) -> list[tuple[int, int]]:
    """Return the spans with values above `least`, somewhere above `peak`, that last at least `seconds`."""
    return [(a, b) for a, b in runs(values > least, seconds * body.fps) if values[a:b].max() > peak]


def turns(body: MovingBody, least_degrees: float) -> list[Event]:
    """Return turns of the hips about the vertical by at least a number of degrees."""
    if body.hips is None:
        return []
    heading = body.smooth(body.heading, 0.05)
    rate, events = body.rate(heading), []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for start, end in spans_of(body, np.where(body.has_heading, sign * rate, 0.0), *_TURNING, 0.1):
            degrees = sign * float(heading[end - 1] - heading[start])
            if degrees >= least_degrees:
                text = f"turns to the {side} by {degrees:.0f} degrees in {(end - start) / body.fps:.1f} s"
                events.append(Event(f"turn {side}", start, end, round(degrees, 1), text))
    return events


def flights(body: MovingBody, least_s: float, *, partners: bool = False) -> list[Event]:
    """Return jumps, in which the middle of the body falls freely; with partners also lifts, in which it does not."""
    middle = body.joints[..., 1].mean(axis=1)
    falling = -body.rate(body.rate(body.smooth(middle, 0.02)))
    in_air = np.where(body.clearance > _CLEAR_M[0], falling, 0.0)
    reach, events = round(_EDGE_S * body.fps), []
    aloft = np.zeros(len(middle), dtype=np.bool_)
    for first, last in spans_of(body, in_air, *_FALLING_M_S2, 0.0):
        # Smoothing takes from both ends, and the floor is not known to a centimetre.
        before, after = range(first, max(first - reach, 0), -1), range(last, min(last + reach, len(middle)))
        start = next((k for k in before if body.clearance[k - 1] <= _CLEAR_M[0]), first)
        end = next((k for k in after if body.clearance[k] <= _CLEAR_M[0]), last)
        aloft[start:end] = True
        seconds, rise = (end - start) / body.fps, float(middle[start:end].max() - middle[max(start - 1, 0)])
        if seconds >= least_s and body.clearance[start:end].max() > _CLEAR_M[1]:
            text = f"jumps, {seconds:.2f} s in the air, {100 * max(rise, 0):.0f} cm up"
            events.append(Event("jump", start, end, round(seconds, 3), text, data={"rise_m": round(rise, 3)}))
    for start, end in spans_of(body, body.clearance, *_CLEAR_M, _LEAST_LIFT_S) if partners else ():
        if aloft[start:end].mean() < 0.5:
            seconds, up = (end - start) / body.fps, float(body.clearance[start:end].max())
            text = f"is lifted for {seconds:.1f} s, {100 * up:.0f} cm off the floor"
            events.append(Event("lifted", start, end, round(seconds, 3), text, data={"height_m": round(up, 3)}))
    return events


def travel(body: MovingBody, least_m: float) -> list[Event]:
    """Return paths of the root that end at least so far from where they begin, by direction from the heading."""
    place = body.smooth(body.joints[:, 0][:, [0, 2]], 0.1)
    speed, events = np.linalg.norm(body.rate(place), axis=1), []
    for start, end in spans_of(body, speed, *_TRAVELLING, 0.3):
        step = place[end - 1] - place[start]
        metres = float(np.linalg.norm(step))
        if metres < least_m:
            continue
        where = _direction(body, start, step)
        seconds, path = (end - start) / body.fps, float(speed[start:end].sum() / body.fps)
        to = {"left": "to the left", "right": "to the right"}.get(where, where)
        text = " ".join(f"travels {metres:.1f} m {to} in {seconds:.1f} s".split())
        label = f"travel {where}".strip()
        events.append(Event(label, start, end, round(metres, 2), text, data={"path_m": round(path, 2)}))
    return events


def _direction(body: MovingBody, frame: int, step: Float64Array) -> str:
    if body.hips is None or not body.has_heading[frame]:
        return ""
    left = body.across[frame, [0, 2]] / np.linalg.norm(body.across[frame, [0, 2]])
    front = np.array([-left[1], left[0]])  # across x up
    ahead, aside = float(step @ front), float(step @ left)
    if abs(ahead) >= abs(aside):
        return "forward" if ahead > 0 else "backward"
    return "left" if aside > 0 else "right"


def energy(body: MovingBody) -> list[Event]:
    """Return the spans in which a body is still, or moves fast, by the mean speed of joints relative to the root."""
    relative = body.joints - body.joints[:, :1]
    speed = body.smooth(np.linalg.norm(body.rate(relative), axis=2).mean(axis=1), 0.2)
    root = body.smooth(np.linalg.norm(body.rate(body.joints[:, 0]), axis=1), 0.2)
    events = []
    for start, end in spans_of(body, -np.maximum(speed, root), -_STILL_M_S, -_STILL_M_S, _LEAST_ENERGY_S):
        text = f"keeps still for {(end - start) / body.fps:.1f} s"
        events.append(Event("still", start, end, round(float(speed[start:end].mean()), 3), text))
    for start, end in spans_of(body, speed, _HIGH_M_S, _HIGH_M_S, _LEAST_ENERGY_S):
        mean = float(speed[start:end].mean())
        text = f"moves fast for {(end - start) / body.fps:.1f} s, {mean:.1f} m/s on average"
        events.append(Event("high energy", start, end, round(mean, 3), text))
    return events


def floor_work(body: MovingBody) -> list[Event]:
    """Return the spans in which the root is near the floor: sitting, kneeling, lying."""
    height = body.joints[:, 0, 1] - body.floor_m
    events = []
    for start, end in spans_of(body, -height, -_DOWN * body.leg_m, -_DOWN * body.leg_m, _LEAST_DOWN_S):
        seconds, low = (end - start) / body.fps, float(height[start:end].min())
        text = f"is down on the floor for {seconds:.1f} s"
        events.append(Event("floor work", start, end, round(seconds, 3), text, data={"lowest_m": round(low, 3)}))
    return events


def contacts(bodies: Sequence[MovingBody]) -> list[list[Event]]:
    """Return for each dancer the spans in which a hand of one is at the body of another; on SMPL's joints alone."""
    events: list[list[Event]] = [[] for _ in bodies]
    named = SMPL24.joints[:22]
    if any(body.skeleton.joints[:22] != named for body in bodies):
        return events
    for a, first in enumerate(bodies):
        for b, second in enumerate(bodies):
            if b <= a:
                continue
            least = max(round(_LEAST_CONTACT_S * first.fps), 1)
            spans = contact_spans(first.joints, second.joints, within_m=_TOUCH_M, least_frames=least)
            for start, end in _union([(s.start, s.end) for s in spans]):
                near = min((s for s in spans if s.start < end and s.end > start), key=lambda s: s.distance_m)
                seconds, data = (end - start) / first.fps, {"distance_m": round(near.distance_m, 3)}
                for me, other, mine, theirs in (
                    (a, b, near.joint, near.other_joint), (b, a, near.other_joint, near.joint),
                ):  # fmt: skip
                    text = f"{_part(mine)} meets the partner's {_part(theirs)} for {seconds:.1f} s"
                    events[me].append(Event("contact", start, end, round(seconds, 3), text, other, mine, data))
    return events


def _union(spans: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    union: list[tuple[int, int]] = []
    for start, end in sorted(spans):
        if union and start <= union[-1][1]:
            union[-1] = union[-1][0], max(end, union[-1][1])
        else:
            union.append((start, end))
    return union


def _part(joint: int) -> str:
    return SMPL24.joints[joint].replace("wrist", "hand").replace("_", " ").rstrip("123")


#: Kinds of events of one dancer, with what finds them: the body, the limits, and whether there are partners.
_OF_ONE: Mapping[str, Callable[[MovingBody, Mapping[str, Any], bool], list[Event]]] = {
    "turns": lambda body, limits, partners: turns(body, limits["turn_degrees"]),
    "jumps": lambda body, limits, partners: flights(body, limits["flight_s"], partners=partners),
    "travel": lambda body, limits, partners: travel(body, limits["travel_m"]),
    "energy": lambda body, limits, partners: energy(body),
    "floor_work": lambda body, limits, partners: floor_work(body),
}
KINDS = (*_OF_ONE, "contacts")
#: Unit of the number of each label, and labels that are exchanged in a mirrored clip.
UNITS = {
    "turn left": "degrees", "turn right": "degrees", "jump": "s", "lifted": "s", "still": "m/s", "high energy": "m/s",
    "floor work": "s", "contact": "s",
    **{f"travel {where}".strip(): "m" for where in ("", "forward", "backward", "left", "right")},
}  # fmt: skip
MIRROR = (("turn left", "turn right"), ("travel left", "travel right"))


def events(
    dancers: Sequence[Float64Array], fps: float, skeleton: Skeleton, kinds: Sequence[str], limits: Mapping[str, float]
) -> list[list[Event]]:
    """Return the events of each dancer, in one world, by the first frame.

    `dancers`: Joint positions (T, J, 3) of each, metres, +Y up.
    `kinds`: Some of `KINDS`.
    `limits`: ``turn_degrees``, ``flight_s`` and ``travel_m``: least turn, time in the air, and distance.
    """
    floor = min(_lowest_often(joints) for joints in dancers)
    bodies = [MovingBody.of(joints, fps, skeleton, floor) for joints in dancers]
    of_dancers = [
        [event for kind in kinds if kind in _OF_ONE for event in _OF_ONE[kind](body, limits, len(bodies) > 1)]
        for body in bodies
    ]
    if "contacts" in kinds and len(bodies) > 1:
        of_dancers = [[*alone, *both] for alone, both in zip(of_dancers, contacts(bodies), strict=True)]
    return [sorted(rows, key=lambda event: (event.start, event.end, event.label, event.other)) for rows in of_dancers]
