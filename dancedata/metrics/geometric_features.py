"""Geometric features of a dance: the share of frames in which each of 32 rules about the pose holds.

From fairmotion (Gopinath and Won 2020, BSD) and the AIST++ API (features/manual.py), after Müller et al. 2005.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.core.dance import Dance, checked_joints
from dancedata.core.plugins import Better
from dancedata.core.registry import METRICS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.typing import override
from dancedata.metrics.arguments import BoolArray, Up, at_least, axis_of, first_joints
from dancedata.metrics.root import Root, rooted
from dancedata.metrics.set_statistics import SetMetric

#: Lengths of the body that thresholds are multiples of, for every dancer, metres: humerus, shoulders, hips.
HUMERUS_M = float(np.linalg.norm(np.subtract((0.199113488, 0.236807942, -0.0180702247),
                                             (0.454445392, 0.221158922, -0.0410167128))))  # fmt: skip
SHOULDERS_M = float(np.linalg.norm(np.subtract((0.199113488, 0.236807942, -0.0180702247),
                                               (-0.191692337, 0.236928746, -0.0123055102))))  # fmt: skip
HIPS_M = float(np.linalg.norm(np.subtract((0.0564076714, -0.323069185, 0.0109197125),
                                          (-0.0624834076, -0.331302464, 0.0150412619))))  # fmt: skip
#: Frames per second that speeds are computed with, at any rate of the clip.
_RATE = 120.0
#: Joints that rules name; the hands, 22 and 23, count for the lowest point only.
N_JOINTS = 22

_JOINT = {
    "root": SMPL24.index("pelvis"), "belly": SMPL24.index("spine1"), "chest": SMPL24.index("spine3"),
    "neck": SMPL24.index("neck"),
    **{
        side[0] + name: SMPL24.index(f"{side}_{name}")
        for side in ("left", "right")
        for name in ("hip", "knee", "ankle", "foot", "shoulder", "elbow", "wrist")
    },
}  # fmt: skip


class _Pose:
    """Positions of the frames 1 ... T - 1, their steps, and the rules' building blocks; all return (T - 1,)."""

    def __init__(self, joints: Float64Array, axis: int) -> None:
        self._now, self._step = joints[1:], np.diff(joints, axis=0)
        self._lowest = joints[1:, :, axis].min(axis=1)
        self._axis = axis

    def at(self, joint: str) -> Float64Array:
        return np.asarray(self._now[:, _JOINT[joint]])

    def line(self, start: str, end: str) -> Float64Array:
        """Return the vector from one joint to another."""
        return self.at(end) - self.at(start)

    def height(self, joint: str) -> Float64Array:
        """Return the height above the lowest joint of the frame."""
        return np.asarray(self.at(joint)[:, self._axis] - self._lowest)

    def normal(self, a: str, b: str, c: str) -> Float64Array:
        """Return the normal of the plane through three joints."""
        return np.cross(self.line(a, c), self.line(a, b))

    def up(self) -> Float64Array:
        return np.eye(3)[[self._axis]]

    def beyond(self, normal: Float64Array, origin: str, joint: str) -> Float64Array:
        """Return the distance of a joint from the plane through another joint."""
        return _along(normal, self.line(origin, joint))

    def moves(self, normal: Float64Array, origin: str, joint: str) -> Float64Array:
        """Return the speed of a joint along a direction, relative to another joint."""
        step = self._step[:, _JOINT[joint]] - self._step[:, _JOINT[origin]]
        return _along(normal, np.asarray(step)) * _RATE

    def speed(self, joint: str) -> Float64Array:
        return np.asarray(np.linalg.norm(self._step[:, _JOINT[joint]], axis=1)) * _RATE

    def angle(self, one: Float64Array, two: Float64Array, low: float, high: float) -> BoolArray:
        """Return whether the angle between two vectors is within limits, degrees."""
        lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
        # As in the original: a cosine that rounding puts above 1 has no angle, so that the rule does not hold.
        degrees = np.degrees(np.arccos((one * two).sum(axis=1) / lengths))
        return np.asarray((degrees > low) & (degrees < high))


def _along(direction: Float64Array, vector: Float64Array) -> Float64Array:
    return np.asarray((direction / np.linalg.norm(direction, axis=1, keepdims=True) * vector).sum(axis=1))


def _arm_rules(p: _Pose) -> list[BoolArray]:
    h = HUMERUS_M
    # Rules 4, 5, 10 and 11 are those of the code: its "move" takes the third joint instead of the fourth.
    torso = p.line("belly", "chest")
    return [
        p.moves(p.normal("neck", "rhip", "lhip"), "neck", "rwrist") > 1.8 * h,
        p.moves(p.normal("neck", "lhip", "rhip"), "neck", "lwrist") > 1.8 * h,
        p.beyond(p.line("chest", "neck"), "neck", "rwrist") > 0.2 * h,
        p.beyond(p.line("chest", "neck"), "neck", "lwrist") > 0.2 * h,
        p.moves(torso, "belly", "chest") > 1.8 * h,
        p.moves(torso, "belly", "chest") > 1.8 * h,
        p.angle(p.line("relbow", "rshoulder"), p.line("relbow", "rwrist"), 0, 110),
        p.angle(p.line("lelbow", "lshoulder"), p.line("lelbow", "lwrist"), 0, 110),
        p.beyond(p.line("lshoulder", "rshoulder"), "lwrist", "rwrist") > 2.5 * SHOULDERS_M,
        p.moves(p.line("lwrist", "rwrist"), "lwrist", "rwrist") > 1.4 * h,
        p.moves(p.line("rwrist", "root"), "rwrist", "lwrist") > 1.4 * h,
        p.moves(p.line("lwrist", "root"), "lwrist", "rwrist") > 1.4 * h,
        p.speed("rwrist") > 2.5 * h,
        p.speed("lwrist") > 2.5 * h,
    ]


def _leg_rules(p: _Pose) -> list[BoolArray]:
    h = HUMERUS_M
    return [
        p.beyond(p.normal("root", "lhip", "lfoot"), "root", "rankle") > 0.38 * h,
        p.beyond(p.normal("root", "rhip", "rfoot"), "root", "lankle") > 0.38 * h,
        p.height("rankle") > 1.2 * h,
        p.height("lankle") > 1.2 * h,
        p.beyond(p.line("lhip", "rhip"), "lankle", "rankle") > 2.1 * HIPS_M,
        p.angle(p.line("rknee", "rhip"), p.line("rknee", "rankle"), 0, 110),
        p.angle(p.line("lknee", "lhip"), p.line("lknee", "lankle"), 0, 110),
        p.speed("rankle") > 2.5 * h,
        p.speed("lankle") > 2.5 * h,
    ]


def _body_rules(p: _Pose) -> list[BoolArray]:
    h = HUMERUS_M
    spine = p.line("neck", "root")
    return [
        p.angle(spine, p.line("rshoulder", "relbow"), 25, 180),
        p.angle(spine, p.line("lshoulder", "lelbow"), 25, 180),
        p.angle(spine, p.line("rhip", "rknee"), 50, 180),
        p.angle(spine, p.line("lhip", "lknee"), 50, 180),
        p.beyond(p.normal("rankle", "neck", "lankle"), "rankle", "root") > 0.5 * h,
        p.angle(spine, p.up(), 70, 110),
        -p.height("rwrist") > -1.2 * h,
        -p.height("lwrist") > -1.2 * h,
        p.speed("root") > 2.3 * h,
    ]


_RULES: tuple[Callable[[_Pose], list[BoolArray]], ...] = (_arm_rules, _leg_rules, _body_rules)


def geometric(joints: Float64Array, *, up: Up = "y") -> Float64Array:
    """Return the geometric ("manual") features of a dance: shares of the frames 1 ... T - 1, 0 to 1.

    Speeds are computed with 120 frames per second, at any rate of the clip, so clips of different rates do not
    compare.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres: SMPL's joints, at least 22. Further ones count for the lowest point of a frame.
    up
        Vertical axis.

    Returns
    -------
    (32,) float64

    Raises
    ------
    Undefined
        "short": below 2 frames.
    DataError
        "missing_joints".
    """
    positions = checked_joints(joints)
    first_joints(positions, N_JOINTS)
    at_least(2, positions)
    pose = _Pose(positions, axis_of(up))
    # Joints at the same place make directions of 0 / 0; comparing with NaN is false, as in the original.
    with np.errstate(invalid="ignore", divide="ignore"):
        rules_true = [rule for rules in _RULES for rule in rules(pose)]
    return np.asarray([rule.mean() for rule in rules_true], dtype=np.float64)


@METRICS.register("geometric")
@dataclass(frozen=True)
class Geometric(SetMetric):
    """Frechet distance and diversity of geometric features, FID_g (FID_m) and Div_g (Div_m) of the papers.

    Attributes
    ----------
    root
        Origin of positions, see `rooted`: "root_relative" changes ten rules, others none.
    up
        The axis that is taken as vertical.
    joints
        The first joints of the clip that are measured.
    statistics
        Normalisation of features, a key of `STATISTICS`.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = "google/aistplusplus_api 2dd7b3e, features/manual.py; the same in all published programs"
    better: ClassVar[dict[str, Better]] = {"fid_g": "lower", "div_g": "closer"}
    score: ClassVar[str] = "g"

    root: Root = "zero_start"
    up: Up = "y"
    joints: int = 24
    statistics: str = "numpy"

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        return tuple(f"rule{number}" for number in range(32))

    @override
    def measure(self, dance: Dance) -> Float64Array:
        """Return the shares of one clip, (32,), rounded to float32 as they are stored everywhere."""
        positions = rooted(first_joints(dance.joints, self.joints), self.root)
        return geometric(positions, up=self.up).astype(np.float32).astype(np.float64)
