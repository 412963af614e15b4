"""Limbs with girth: the round cones of which the body of a figure is drawn, on pages and in videos."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array, matrix_from_rotvec
from dancedata.core.skeleton import Skeleton
from dancedata.scene.body import TALL, standing_height

#: Radii at the parent and at the joint, metres, of the bone that ends in a joint of this name; of a body of 1.7 m.
_GIRTHS = {
    "hip": (0.1, 0.088), "knee": (0.082, 0.053), "ankle": (0.054, 0.036), "foot": (0.036, 0.03),
    "spine1": (0.112, 0.108), "spine2": (0.108, 0.114), "spine3": (0.114, 0.118), "neck": (0.1, 0.052),
    "head": (0.052, 0.052), "collar": (0.098, 0.072), "shoulder": (0.066, 0.058), "elbow": (0.05, 0.038),
    "wrist": (0.037, 0.026), "hand": (0.028, 0.028), "thumb1": (0.021, 0.013), "index1": (0.022, 0.012),
    "middle1": (0.022, 0.012), "ring1": (0.021, 0.011), "pinky1": (0.02, 0.01), "jaw": (0.0, 0.0),
    "eye": (0.0, 0.0), "eye_smplhf": (0.0, 0.0),
}  # fmt: skip
_FINGER = re.compile(r"(thumb|index|middle|ring|pinky)[23]")
_FINGER_GIRTH = (0.0105, 0.0085)
_SIDE = re.compile(r"^(left|right)_?", re.IGNORECASE)
_HEAD = re.compile(r"(.*[:_ ])?head", re.IGNORECASE)
#: Girth of another bone as a share of its length, and its limits.
_SHARE, _THIN, _THICK = 0.22, 0.01, 0.08
#: Parts beyond the joints: turn upwards from the bone, radians, length, and radii.
_HEEL, _TOES, _FINGERS = (-1.66, 0.05, 0.034, 0.027), (0.44, 0.055, 0.03, 0.02), (0.0, 0.075, 0.028, 0.014)
#: The head, from its joint: up and forward of both ends, sideways, and both radii; the last three are the face.
HEAD = (
    (0.04, 0.03, 0.085, 0.004, 0.0, 0.076, 0.088), (0.03, 0.045, -0.02, 0.066, 0.0, 0.058, 0.036),
    (0.062, 0.094, 0.026, 0.112, 0.0, 0.011, 0.017), (0.066, 0.09, 0.066, 0.092, 0.034, 0.013, 0.013),
    (0.066, 0.09, 0.066, 0.092, -0.034, 0.013, 0.013),
)  # fmt: skip
_FACE = 2


class Tip(NamedTuple):
    """A part that begins at `start` and goes on as the bone from `parent` to `joint`, turned upwards by `turn`."""

    start: int
    parent: int
    joint: int
    turn: float
    length: float
    begin_radius: float
    end_radius: float


@dataclass(frozen=True, eq=False)
class Cones:
    """Round cones in the world, metres: (K, 3) ends, and (K, 2) radii."""

    begin: Float64Array
    end: Float64Array
    radii: Float64Array
    tones: tuple[int, ...]  # (K,) 0 trunk and head, 1 left limbs, 2 right limbs, 3 face


@dataclass(frozen=True)
class Limbs:
    """Girth of the bones of a body."""

    parents: tuple[int, ...]
    # radii at the parent and at the joint of the bone to each joint, metres; 0 where nothing is drawn
    girths: tuple[tuple[float, float], ...]
    # of the bone to each joint, as in `Cones`; bones from the spine to a hip or a collar are of the trunk
    tones: tuple[int, ...]
    tips: tuple[Tip, ...]  # heels, toes and fingers beyond the last joints
    head: int  # joint of the head; -1 without one
    scale: float  # height of the body, of 1.7 m

    @classmethod
    def of(cls, pose: Float64Array, skeleton: Skeleton) -> Limbs:
        """Return the limbs of a body in some pose, (J, 3) metres."""
        scale = standing_height(pose, skeleton) / TALL
        lengths = [float(np.linalg.norm(pose[j] - pose[max(p, 0)])) for j, p in enumerate(skeleton.parents)]
        names = [_SIDE.sub("", name.lower()) for name in skeleton.joints]
        girths = ((0.0, 0.0), *(_girth(*bone, scale) for bone in list(zip(names, lengths, strict=True))[1:]))
        leaves = set(range(skeleton.n_joints)) - set(skeleton.parents)
        tips = []
        for joint in sorted(leaves):
            parent = skeleton.parents[joint]
            if joint in skeleton.feet[2:] and parent in skeleton.feet[:2]:
                tips += [Tip(parent, parent, joint, *_HEEL), Tip(joint, parent, joint, *_TOES)]
            elif names[joint] == "hand":
                tips.append(Tip(joint, parent, joint, *_FINGERS))
        sized = tuple(tip._replace(**{k: getattr(tip, k) * scale for k in Tip._fields[4:]}) for tip in tips)
        sides = sides_of(skeleton)
        tones = tuple(sides[j] if sides[max(parent, 0)] else 0 for j, parent in enumerate(skeleton.parents))
        return cls(skeleton.parents, girths, tones, sized, head_of(skeleton), scale)

    def cones(self, pose: Float64Array, look: Float64Array | None) -> Cones:
        """Return the cones of a pose, (J, 3) metres, that looks towards `look`, (3,)."""
        drawn = [j for j, girth in enumerate(self.girths) if max(girth) > 0]
        begin, end = [pose[self.parents[j]] for j in drawn], [pose[j] for j in drawn]
        radii, tones = [self.girths[j] for j in drawn], [self.tones[j] for j in drawn]
        for tip in self.tips:
            begin.append(pose[tip.start])
            end.append(pose[tip.start] + tip.length * _turned(pose[tip.joint] - pose[tip.parent], tip.turn))
            radii.append((tip.begin_radius, tip.end_radius))
            tones.append(self.tones[tip.joint])
        if look is not None and self.head > 0:
            neck, ahead = pose[self.head] - pose[self.parents[self.head]], look
            up = _unit(neck - ahead * (neck @ ahead))
            across = np.cross(up, ahead)
            for number, (u, f, v, g, side, first, last) in enumerate(HEAD):
                places = (up * u + ahead * f, up * v + ahead * g)
                for ends, place in zip((begin, end), places, strict=True):
                    ends.append(pose[self.head] + self.scale * (place + across * side))
                radii.append((first * self.scale, last * self.scale))
                tones.append(3 if number >= _FACE else 0)
        return Cones(np.array(begin), np.array(end), np.array(radii), tuple(tones))


def sides_of(skeleton: Skeleton) -> tuple[int, ...]:
    """Return the side of each joint: 0 in the middle, 1 left, 2 right."""
    sides = [0] * skeleton.n_joints
    for left, right in skeleton.pairs:
        sides[left], sides[right] = 1, 2
    return tuple(sides)


def head_of(skeleton: Skeleton) -> int:
    """Return the joint of the head; -1 without one."""
    return next((j for j, name in enumerate(skeleton.joints) if j and _HEAD.fullmatch(name)), -1)


def looks(motion: Motion) -> Float64Array | None:
    """Return where the head faces, (T, 3) unit vectors, from the rotations; None without a head or shoulders."""
    joint = head_of(motion.skeleton)
    if _shoulders(motion.skeleton) is None:
        return None
    turned = np.repeat(rest_ahead(motion.skeleton)[None], motion.n_frames, axis=0)
    while joint >= 0:
        turned = np.einsum("tab,tb->ta", matrix_from_rotvec(motion.rotations[:, joint]), turned)
        joint = motion.skeleton.parents[joint]
    return turned


def chest_looks(joints: Float64Array, skeleton: Skeleton) -> Float64Array | None:
    """Return where the chest faces, (T, 3) unit vectors, as the head does at rest; None without head or shoulders."""
    shoulders, head = _shoulders(skeleton), head_of(skeleton)
    if shoulders is None:
        return None
    left, right = shoulders
    neck = _unit(joints[:, head] - joints[:, skeleton.parents[head]])
    square = _unit(np.cross(joints[:, left] - joints[:, right], neck))
    # At rest the neck leans towards where the head looks.
    rest = _unit(skeleton.offsets[head])
    lean = float(np.arctan2(rest @ rest_ahead(skeleton), rest[1]))
    return np.asarray(np.cos(lean) * square + np.sin(lean) * neck)


def _shoulders(skeleton: Skeleton) -> tuple[int, int] | None:
    """Return the pair of joints on the trunk nearest to the head: collars or shoulders, not hips."""
    head, parents = head_of(skeleton), skeleton.parents
    pairs = [pair for pair in skeleton.pairs if pair[0] < head and parents[pair[0]] == parents[pair[1]]]
    return max(pairs, key=lambda pair: _depth(skeleton, pair[0]), default=None)


def rest_ahead(skeleton: Skeleton) -> Float64Array:
    """Return where the body faces at rest, (3,): level, square to its shoulders; +Z without shoulders."""
    shoulders = _shoulders(skeleton)
    if shoulders is None:
        return np.array([0.0, 0.0, 1.0])
    left, right = (skeleton.offsets[joint] for joint in shoulders)
    return _unit(np.cross(left - right, (0.0, 1.0, 0.0)))


def _depth(skeleton: Skeleton, joint: int) -> int:
    depth = 0
    while skeleton.parents[joint] >= 0:
        joint, depth = skeleton.parents[joint], depth + 1
    return depth


def _girth(name: str, length: float, scale: float) -> tuple[float, float]:
    if name in _GIRTHS or _FINGER.fullmatch(name):
        first, last = _GIRTHS.get(name, _FINGER_GIRTH)
        return first * scale, last * scale
    if length < 1e-6:
        return 0.0, 0.0
    girth = min(max(_SHARE * length, _THIN * scale), _THICK * scale)
    return girth, girth


def _turned(bone: Float64Array, turn: float) -> Float64Array:
    """Return the direction of a bone, turned upwards in its vertical plane."""
    flat = float(np.hypot(bone[0], bone[2]))
    ahead, up = np.cos(turn) * flat - np.sin(turn) * bone[1], np.sin(turn) * flat + np.cos(turn) * bone[1]
    east, south = (bone[0] / flat, bone[2] / flat) if flat > 1e-9 else (1.0, 0.0)
    return _unit(np.array([east * ahead, up, south * ahead]))


def _unit(vectors: Float64Array) -> Float64Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))
