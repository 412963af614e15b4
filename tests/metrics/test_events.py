"""Computed events: planted turns, jumps, travel, floor work and contacts, and how many are found."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from dancedata.core.bodies import MOTORICA21
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.metrics.events import KINDS, Event, events

LIMITS = {"turn_degrees": 150.0, "flight_s": 0.15, "travel_m": 1.0}
G = 9.81
Planted = tuple[str, float, float]


class Dance:
    """A dancer who stands, with events planted one after another; joints swing by a little noise."""

    def __init__(self, fps: int, seed: int, skeleton: Skeleton = SMPL24) -> None:
        self.fps, self.skeleton, self.rng = fps, skeleton, np.random.default_rng(seed)
        rest = np.zeros((1, skeleton.n_joints, 3))
        body = Motion(np.zeros((1, 3)), rest, FrameGrid.of(fps), skeleton).joints()[0]
        self.height = float(body[0, 1] - body[:, 1].min() - skeleton.offsets[0, 1])
        self.root: list[np.ndarray] = [np.array([0.0, self.height, 0.0])]
        self.yaw: list[float] = [0.3]
        self.planted: list[Planted] = []

    def _add(self, label: str, seconds: float, roots: np.ndarray, yaws: np.ndarray) -> None:
        start = len(self.root) / self.fps
        self.root += list(roots)
        self.yaw += list(yaws)
        if label:
            self.planted.append((label, start, start + seconds))

    def _ramp(self, seconds: float) -> np.ndarray:
        t = np.linspace(0, 1, max(round(seconds * self.fps), 2))
        return t * t * (3 - 2 * t)

    def wait(self, seconds: float = 1.2) -> "Dance":
        n = round(seconds * self.fps)
        self._add("", seconds, np.tile(self.root[-1], (n, 1)), np.full(n, self.yaw[-1]))
        return self

    def turn(self, degrees: float, seconds: float, label: str | None = None) -> "Dance":
        ramp = self._ramp(seconds)
        name = ("turn left" if degrees > 0 else "turn right") if label is None else label
        self._add(name, seconds, np.tile(self.root[-1], (len(ramp), 1)), self.yaw[-1] + np.radians(degrees) * ramp)
        return self.wait()

    def jump(self, seconds: float, label: str = "jump") -> "Dance":
        t = np.arange(round(seconds * self.fps)) / self.fps
        up = np.zeros((len(t), 3))
        up[:, 1] = G / 2 * t * (seconds - t)
        place = self.root[-1]
        self._add(label, seconds, place + up, np.full(len(t), self.yaw[-1]))
        self.root[-1] = place
        return self.wait()

    def walk(self, forward: float, left: float, seconds: float, label: str) -> "Dance":
        ramp, yaw = self._ramp(seconds), self.yaw[-1]
        # Front of a body that is turned by yaw about +Y: (sin, cos); its left: (cos, -sin).
        step = forward * np.array([np.sin(yaw), 0, np.cos(yaw)]) + left * np.array([np.cos(yaw), 0, -np.sin(yaw)])
        self._add(label, seconds, self.root[-1] + ramp[:, None] * step, np.full(len(ramp), yaw))
        return self.wait()

    def sink(self, seconds: float) -> "Dance":
        ramp = np.concatenate([self._ramp(0.4), np.ones(round(seconds * self.fps)), 1 - self._ramp(0.4)])
        down = np.zeros((len(ramp), 3))
        down[:, 1] = -0.7 * self.height * ramp
        self._add("floor work", seconds, self.root[-1] + down, np.full(len(ramp), self.yaw[-1]))
        return self.wait()

    def joints(self) -> np.ndarray:
        """Positions (T, J, 3); legs are folded where the root is low."""
        n, k = len(self.root), self.skeleton.n_joints
        rotations = 0.004 * gaussian_filter1d(self.rng.normal(size=(n, k, 3)), 0.1 * self.fps, axis=0)
        rotations[:, 0] = 0
        rotations[:, 0, 1] = self.yaw
        joints = Motion(np.array(self.root), rotations, FrameGrid.of(self.fps), self.skeleton).joints()
        low = np.array(self.root)[:, 1] < self.height - 0.05
        joints[low, 1:, 1] = np.maximum(joints[low, 1:, 1], 0)
        return joints


def dance(fps: int, seed: int) -> Dance:
    rng, made = np.random.default_rng(seed), Dance(fps, seed).wait()
    for _ in range(3):
        sign = rng.choice([-1, 1])
        made.turn(sign * rng.uniform(180, 720), rng.uniform(0.9, 1.6))
        made.turn(-sign * rng.uniform(20, 120), 0.8, "")  # too small to be one
        made.jump(rng.uniform(0.25, 0.55))
        made.jump(0.12, "")  # a hop below the limit
        made.walk(rng.choice([-1, 1]) * rng.uniform(1.3, 3), 0.1, 2, "travel")
        made.walk(0.1, rng.choice([-1, 1]) * rng.uniform(1.3, 3), 2, "travel")
        made.walk(0.5, 0.0, 1.0, "")  # a step
        made.sink(rng.uniform(0.8, 1.5))
    return made


def matched(planted: Sequence[Planted], found: Sequence[Event], fps: float, label: str) -> tuple[int, int, int]:
    """Numbers of planted and found events of a label, and of those that overlap by half of the planted one."""
    wanted = [(a, b) for name, a, b in planted if name.startswith(label)]
    events_ = [(e.start / fps, e.end / fps) for e in found if e.label.startswith(label)]
    hits = sum(any(min(b, d) - max(a, c) > 0.5 * (b - a) for c, d in events_) for a, b in wanted)
    return len(wanted), len(events_), hits


@pytest.mark.parametrize(("fps", "jitter_m"), [(30, 0), (60, 0), (120, 0), (30, 0.006), (120, 0.003)])
def test_precision_and_recall_on_planted_events(fps: int, jitter_m: float) -> None:
    counts = {label: np.zeros(3, dtype=int) for label in ("turn", "jump", "travel", "floor work")}
    for seed in range(3):
        made = dance(fps, seed)
        (found,) = events([made.joints()], fps, SMPL24, KINDS, LIMITS)
        for label, total in counts.items():
            total += matched(made.planted, found, fps, label)
        sides = {(e.label, round(e.start / fps)) for e in found if e.label.startswith("turn")}
        assert {(name, round(a)) for name, a, _ in made.planted if name.startswith("turn")} == sides or len(
            sides
        ) == 3
    for label, (planted, found_, hits) in counts.items():
        recall, precision = hits / planted, hits / max(found_, 1)
        print(f"{label} at {fps} fps: {planted} planted, recall {recall:.2f}, precision {precision:.2f}")
        assert recall >= 0.95, label
        assert precision >= 0.95, label


def found(made: Dance, **more: Any) -> list[Event]:
    (of_one,) = events([made.joints()], made.fps, made.skeleton, more.pop("kinds", KINDS), {**LIMITS, **more})
    return of_one


@pytest.mark.parametrize("skeleton", [SMPL24, MOTORICA21], ids=lambda s: s.name)
def test_numbers_and_sentences(skeleton: Skeleton) -> None:
    made = Dance(60, 1, skeleton).wait().turn(360, 1.2).jump(0.4).walk(2, 0, 2, "").walk(0, -1.5, 2, "")
    turn, jump, forward, right = (e for e in found(made) if e.label != "still")
    assert (turn.label, forward.label, right.label) == ("turn left", "travel forward", "travel right")
    assert turn.value == pytest.approx(360, abs=8)
    assert jump.value == pytest.approx(0.4, abs=0.05)
    assert jump.data["rise_m"] == pytest.approx(G * 0.4**2 / 8, abs=0.03)
    assert forward.value == pytest.approx(2, abs=0.1)
    assert turn.text.startswith("turns to the left by 3")
    assert jump.text.startswith("jumps, 0.")
    assert right.text.startswith("travels 1.")
    assert "to the right" in right.text


def test_limits_and_kinds() -> None:
    made = Dance(30, 2).wait().turn(120, 0.8, "").jump(0.3)
    assert {e.label for e in found(made)} == {"jump", "still"}
    assert {e.label for e in found(made, turn_degrees=90.0, kinds=("turns",))} == {"turn left"}
    assert found(made, flight_s=0.5, kinds=("jumps",)) == []


def test_a_lifted_partner_does_not_jump_and_hands_meet() -> None:
    a, b = Dance(30, 3).wait(3), Dance(30, 4).wait(3)
    first, second = a.joints(), b.joints()
    second[..., 0] += 1.5
    n = len(second)
    lift = np.clip(np.minimum(np.arange(n) - 30, 75 - np.arange(n)) / 10, 0, 1) * 0.5
    second[..., 1] += lift[:, None]
    second[20:50, 20] = first[20:50, 21] + [0.03, 0, 0]
    one, two = events([first, second], 30, SMPL24, KINDS, LIMITS)
    assert [e.label for e in two if e.label in ("jump", "lifted")] == ["lifted"]
    (touch,) = (e for e in one if e.label == "contact")
    (back,) = (e for e in two if e.label == "contact")
    assert (touch.start, touch.end, touch.other, touch.joint, back.other, back.joint) == (20, 50, 1, 21, 0, 20)
    assert touch.text == "right hand meets the partner's left hand for 1.0 s"
    swapped = events([second, first], 30, SMPL24, KINDS, LIMITS)
    assert [[e.label for e in of] for of in swapped] == [[e.label for e in two], [e.label for e in one]]


def test_mirrored_motion_has_mirrored_events() -> None:
    made = Dance(30, 5).wait().turn(270, 1.0).walk(0, 2, 2, "")
    joints = made.joints()
    order = [SMPL24.other_side.get(j, j) for j in range(24)]
    mirrored = joints[:, order] * [-1, 1, 1]
    (plain,), (other,) = (events([j], 30, SMPL24, KINDS, LIMITS) for j in (joints, mirrored))
    swap = {"turn left": "turn right", "travel left": "travel right"}
    assert [swap.get(e.label, e.label) for e in plain] == [e.label for e in other]
    assert [e.value for e in plain] == pytest.approx([e.value for e in other])
