"""Left, right and up of a motion, judged by its anatomy: direction of toes, bends of knees and elbows, and the floor.

The numbers next to the limits are medians of whole clips of real dances (AIST++ with breakdance, three BVH captures).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.motion import Motion
from dancedata.core.rotations import Float64Array, matrix_from_rotvec
from dancedata.core.tracks import lengths

#: Most frames that are inspected.
_FRAMES = 600
#: Sine of the bend of a knee or an elbow that counts, 15 degrees; least share of the frames in which it is bent.
_BENT, _LEAST_BENT = 0.26, 0.2
#: All evidence below this cosine is a contradiction; above it and below 0, a doubt.
_CERTAIN = -0.25
#: Elbows below this bend backwards: 0.41 to 0.88 in real dances, down to -0.26 in made-up ones.
MIN_ELBOWS = -0.35
#: Ankles nearer than this, in widths of the hips, cross: 1.2 to 3.7 in real dances, 0.6 in two seconds of them.
MIN_STANCE = 0.3
#: The body's mean direction, from the feet to the head, counts as another axis from this cosine on; as a certain one.
_ALONG, _CERTAINLY_ALONG = 0.5, 0.8
#: Below this cosine with +Y a body does not stand: at least 0.5 in 1.5 s of real dances, breakdance included.
_LYING = 0.3
#: Fewer frames do not show a floor.
_LEAST_FRAMES = 30
#: How much steadier the floor along that axis is than the one along +Y; less where the body is upside down, as both
#: are then moved by the same bending of its knees.
_STEADIER = 0.5
#: Feet move along a floor by this, metres: the middle half of their places. 0.12 and more in real dances.
_STEPS_M = 0.05


@dataclass(frozen=True)
class Sides:
    """Agreement of the names of the sides with the anatomy; medians over frames, NaN without evidence."""

    toes: float  # cosine of feet's direction and hips' front: 0.48 to 0.92
    knees: float  # cosine of bending axis and hips' left: 0.71 to 0.99
    chest: float  # cosine of shoulders' left and hips' left: 0.91 to 1
    elbows: float  # forearm to the upper arm's front: 0.41 to 0.88
    stance: float  # the left ankle's place to the left of the right one, in widths of hips

    @property
    def legs(self) -> float:
        """Toes or knees, whichever agree better, as pointed feet say nothing; NaN without evidence."""
        return float(np.fmax(self.toes, self.knees))

    @property
    def swapped(self) -> str:
        """Contradicted names: "sides" of the whole body, "legs" or "arms" alone; "" for none."""
        if self.chest < 0:
            return "legs" if self.legs < 0 else "arms"
        return "sides" if self.legs < 0 else ""

    @property
    def certain(self) -> bool:
        """Whether all evidence contradicts the names."""
        return self.chest < _CERTAIN or self.legs < _CERTAIN

    def __str__(self) -> str:
        named = {"toes": self.toes, "knees": self.knees, "shoulders": self.chest}
        return ", ".join(f"{name} {value:+.2f}" for name, value in named.items() if value == value)


def sides_of(joints: Float64Array, motion: Motion | None = None, *, toes: bool = True) -> Sides:
    """Measure a body by joints (T, J, 3), SMPL's 22 first, elbows by rotations; `toes`: whether they are known."""
    places = sampled(joints)
    left = places[:, 1] - places[:, 2]
    width = lengths(left)
    up = (places[:, 16] + places[:, 17] - places[:, 1] - places[:, 2]) / 2
    shoulders = places[:, 16] - places[:, 17]
    feet = places[:, (10, 11)] - places[:, (7, 8)]
    front = np.cross(left, up)[:, None]
    across = ((places[:, 7] - places[:, 8]) * left).sum(-1)
    return Sides(
        toes=_median(_cosine(feet, front)) if toes else np.nan,
        knees=_knees(places, left),
        chest=_median(_cosine(_level(shoulders, up), _level(left, up))),
        elbows=np.nan if motion is None else _elbows(motion),
        stance=_median(across / np.maximum(width * width, 1e-12)),
    )


def wrong_up(joints: Float64Array) -> tuple[Float64Array, bool] | None:
    """Return the body's mean direction if the dancer stands along an axis other than +Y, and whether that is certain.

    Dancers lie down and stand on their hands: an axis is wrong only if the lowest joint along the other one keeps
    its height better than that along +Y, as on a floor, on which the feet move.
    """
    places, mean = sampled(joints)[:, :22], body_direction(joints)
    axis = int(np.abs(mean).argmax())
    if len(places) < _LEAST_FRAMES or abs(mean[axis]) <= _ALONG or (axis == 1 and mean[1] > 0):
        return None
    unrest_y, unrest = _unrest(places[..., 1]), _unrest(places[..., axis] * np.sign(mean[axis]))
    steadier = unrest < unrest_y * (1 if axis == 1 else _STEADIER)
    steps = _middle_half(places[:, (7, 8)])[:, np.arange(3) != axis].max()
    return (mean, bool(abs(mean[axis]) > _CERTAINLY_ALONG)) if steadier and steps > _STEPS_M else None


def stands(joints: Float64Array) -> bool:
    """Whether the dancer certainly stands along +Y: the lowest joint keeps its height best along this axis."""
    places = sampled(joints)[:, :22]
    if len(places) < _LEAST_FRAMES or body_direction(joints)[1] <= _CERTAINLY_ALONG:
        return False
    unrest_y, steps = _unrest(places[..., 1]), _middle_half(places[:, (7, 8)])[:, (0, 2)].max()
    others = min(_unrest(sign * places[..., axis]) for axis in (0, 2) for sign in (1, -1))
    return bool(unrest_y < others and steps > _STEPS_M)


def lies(joints: Float64Array) -> bool:
    """Whether the body lies, or is upside down, for the whole clip; of one that tumbles the mean has no direction."""
    mean = body_direction(joints)
    return bool(mean[1] < _LYING and np.linalg.norm(mean) > _ALONG)


def body_direction(joints: Float64Array) -> Float64Array:
    """Return the mean of the unit vectors (3,) from the feet to the head of joints (T, J, 3)."""
    places = sampled(joints)
    return np.asarray(_unit(places[:, 15] - places[:, (7, 8)].mean(axis=1)).mean(axis=0))


def sampled(frames: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the frames (T, ...) to inspect: every n-th one, at most 600."""
    return frames[:: -(-len(frames) // _FRAMES)]


def _knees(places: Float64Array, left: Float64Array) -> float:
    thighs = _unit(places[:, (4, 5)] - places[:, (1, 2)])
    axes = np.cross(thighs, _unit(places[:, (7, 8)] - places[:, (4, 5)]))
    return _where_bent(_cosine(axes, left[:, None]), lengths(axes))


def _elbows(motion: Motion) -> float:
    bones = _unit(motion.skeleton.offsets[[20, 21]])
    turns = matrix_from_rotvec(sampled(motion.rotations)[:, (18, 19)])
    forearms = np.einsum("tjab,jb->tja", turns, bones)
    return _where_bent(forearms[..., 2], lengths(np.cross(forearms, bones)))


def _where_bent(values: Float64Array, sines: Float64Array) -> float:
    bent = sines > _BENT
    return _median(values[bent]) if bent.mean() > _LEAST_BENT else np.nan


def _unrest(heights: Float64Array) -> float:
    """Return how much the lowest joint moves along an axis: the middle half of its heights, metres."""
    return float(_middle_half(heights.min(axis=1)))


def _middle_half(values: Float64Array) -> Float64Array:
    """Return the span of the middle half of the frames (T, ...)."""
    low, high = np.quantile(values, (0.25, 0.75), axis=0)
    return np.asarray(high - low)


def _unit(vectors: Float64Array) -> Float64Array:
    return np.asarray(vectors / np.maximum(lengths(vectors), 1e-12)[..., None])


def _cosine(one: Float64Array, two: Float64Array) -> Float64Array:
    return np.asarray((_unit(one) * _unit(two)).sum(axis=-1))


def _level(vectors: Float64Array, up: Float64Array) -> Float64Array:
    """Return the part of vectors at right angles to `up`."""
    axis = _unit(up)
    return np.asarray(vectors - axis * (vectors * axis).sum(axis=-1, keepdims=True))


def _median(values: Float64Array) -> float:
    return float(np.median(values))
