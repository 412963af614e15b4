"""Kinetic features of a dance: how fast each joint moves sideways and up, and its mean acceleration.

From fairmotion (Gopinath and Won 2020, BSD) and the AIST++ API (Li et al. 2021), after Onuma et al. 2008.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.dance import Dance, checked_joints
from dancedata.core.plugins import Better
from dancedata.core.registry import METRICS
from dancedata.core.rotations import Float64Array
from dancedata.core.typing import override
from dancedata.metrics.arguments import Up, at_least, axis_of, checked_rate, first_joints, known_name
from dancedata.metrics.root import Root, rooted
from dancedata.metrics.set_statistics import SetMetric

Energy = Literal["fixed", "code"]
Definition = Literal["fairmotion", "megadance", "flowerdance"]

#: Frames on each side that a speed is averaged over.
_HALF = 2
_MIN_FRAMES = 3


@dataclass(frozen=True)
class KineticVariant:
    """Kinetic features as one paper or program computes them.

    `definition`: Formula: see `kinetic`, `kinetic_megadance`, `kinetic_flowerdance`.
    `energy`: "fixed", or "code" with the slip of the released code; of `fairmotion` only.
    `frame_s`: Duration of a frame that is assumed; None: the clip's own.
    `rounded`: Whether features are rounded to float32, as they are stored there.
    """

    source: str
    definition: Definition = "fairmotion"
    energy: Energy = "fixed"
    frame_s: float | None = None
    rounded: bool = True

    def __call__(self, joints: Float64Array, fps: float, *, up: Up = "y") -> Float64Array:
        """Return the features (3 J,) of joints (T, J, 3)."""
        rate = fps if self.frame_s is None else 1 / self.frame_s
        if self.definition == "megadance":
            features = kinetic_megadance(joints, rate, up=up)
        elif self.definition == "flowerdance":
            features = kinetic_flowerdance(joints, rate, up=up)
        else:
            features = kinetic(joints, rate, energy=self.energy, up=up)
        return features.astype(np.float32).astype(np.float64) if self.rounded else features


#: By name. "fixed" is the formula of the papers at the clip's own rate; the others are programs.
KINETIC_VARIANTS = {
    "fixed": KineticVariant(
        "Onuma, Faloutsos, Hodgins 2008, FMDistance; Li et al. 2021, AI Choreographer, 5.2.1", rounded=False
    ),
    "code": KineticVariant(
        "google/aistplusplus_api 2dd7b3e, features/kinetic.py; the same in Bailando, Lodge, POPDG, DGSDP, Motius",
        energy="code",
        frame_s=1 / 60,
    ),
    "gcd-code": KineticVariant("aioz-ai/GCD b9524d8, eval/features/kinetic.py", energy="code", frame_s=1 / 30),
    "gcd-fixed": KineticVariant("aioz-ai/GCD b9524d8, features of groups", frame_s=1 / 30),
    "megadance": KineticVariant("XulongT/MEGADance e145b8f, utils/metric.py", "megadance", frame_s=1 / 30),
    "flowerdance-code": KineticVariant("XulongT/FlowerDance 2352a1a, model/metric.py", "flowerdance", frame_s=1 / 60),
}


def kinetic(joints: Float64Array, fps: float, *, energy: Energy = "fixed", up: Up = "y") -> Float64Array:
    """Return the kinetic features of a dance.

    v_i is the mean velocity of the steps i - 2 ... i + 2 that exist, a_i the mean acceleration of the frames
    i - 2 ... i + 2 that have two neighbours. Over the frames i = 1 ... T - 1, for each joint:

    - the mean of the squared horizontal velocity, m2/s2,
    - the mean of the squared vertical velocity, m2/s2,
    - the mean of ``|a_i|``, m/s2.

    Parameters
    ----------
    joints, fps
        (T, J, 3) positions, metres, and their frames per second.
    energy
        "code" is the released code's acceleration, in which the earlier position is divided by the frame time and the
        later one is not: ((P[k+1] - P[k]) / dt - (P[k] - P[k-1] / dt)) / dt. It is nearly proportional to the
        distance from the origin.
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
    known_name("energy", energy, ("fixed", "code"))
    return _means(frame_features(joints, fps, energy=energy, up=up))


def frame_features(
    joints: Float64Array, fps: float, *, energy: Energy = "fixed", up: Up = "y", half: int = _HALF
) -> Float64Array:
    """Return the kinetic features of the frames 1 ... T - 1 by themselves, (T - 1, J, 3); `kinetic` is their mean.

    Arguments as `kinetic`; `half` is the number of frames on each side that velocity and acceleration are means of.
    """
    positions, step_s = _checked(joints, fps)
    n = len(positions)
    frames = np.arange(1, n)
    first, last = np.maximum(frames - half, 1), np.minimum(frames + half, n - 1)
    velocity = (positions[last] - positions[first - 1]) / ((last - first + 1) * step_s)[:, None, None]
    earlier, now, later = positions[:-2], positions[1:-1], positions[2:]
    before = now - earlier / step_s if energy == "code" else (now - earlier) / step_s
    acceleration = ((later - now) / step_s - before) / step_s
    # The frames 1 ... T - 2 have an acceleration; frame T - 1 sees those of its neighbours.
    sums, counts = _box_sums(acceleration, n - 1, half)
    return _features(velocity, sums / counts[:, None, None], up)


def kinetic_megadance(joints: Float64Array, fps: float, *, up: Up = "y") -> Float64Array:
    """Return the kinetic features as MEGADance computes them, (3 J,).

    Velocities, the first repeated, are smoothed by a 5-frame box filter with zero padding.
    Accelerations are those of the smoothed velocities, smoothed again. Means are over all T frames.
    Arguments as `kinetic`.
    """
    positions, step_s = _checked(joints, fps)
    velocity = _box_of_zeros(_differences_repeated(positions) / step_s)
    return _means(_features(velocity, _box_of_zeros(_differences_repeated(velocity) / step_s), up))


def kinetic_flowerdance(joints: Float64Array, fps: float, *, up: Up = "y") -> Float64Array:
    """Return the kinetic features as FlowerDance's code computes them, (3 J,).

    The step before frame 0 is the one from the last frame (index -1 wraps round), frame 0 itself has no velocity, and
    the acceleration is the same operation on the velocities. Means are over all T frames. Arguments as `kinetic`.
    """
    positions, step_s = _checked(joints, fps)
    velocity = _wrapped_velocity(positions, step_s)
    return _means(_features(velocity, _wrapped_velocity(velocity, step_s), up))


def _checked(joints: Float64Array, fps: float) -> tuple[Float64Array, float]:
    positions = checked_joints(joints)
    at_least(_MIN_FRAMES, positions)
    return positions, 1 / checked_rate(fps)


def _features(velocity: Float64Array, acceleration: Float64Array, up: Up) -> Float64Array:
    """Return squared horizontal and vertical speed and size of the acceleration, (T, J, 3)."""
    axis = axis_of(up)
    squares = velocity**2
    horizontal = np.delete(squares, axis, axis=2).sum(axis=2)
    return np.stack([horizontal, squares[..., axis], np.linalg.norm(acceleration, axis=2)], axis=2)


def _means(features: Float64Array) -> Float64Array:
    return np.asarray(features.mean(axis=0).ravel(), dtype=np.float64)


def _box_sums(values: Float64Array, n: int, half: int = _HALF) -> tuple[Float64Array, Float64Array]:
    """Return sums over the rows i - half ... i + half of `values` that exist, and their number, for i < n."""
    padded = np.zeros((n + 2 * half, *values.shape[1:]))
    exists = np.zeros(n + 2 * half)
    padded[half : half + len(values)] = values
    exists[half : half + len(values)] = 1
    sums, counts = np.zeros((n, *values.shape[1:])), np.zeros(n)
    for shift in range(2 * half + 1):
        sums += padded[shift : shift + n]
        counts += exists[shift : shift + n]
    return sums, counts


def _box_of_zeros(values: Float64Array) -> Float64Array:
    return _box_sums(values, len(values))[0] / (2 * _HALF + 1)


def _differences_repeated(values: Float64Array) -> Float64Array:
    steps = np.diff(values, axis=0)
    return np.concatenate([steps[:1], steps])


def _wrapped_velocity(values: Float64Array, step_s: float) -> Float64Array:
    steps = (values - np.roll(values, 1, axis=0)) / step_s
    sums, counts = _box_sums(steps, len(steps))
    velocity = sums / counts[:, None, None]
    velocity[0] = 0
    return velocity


@METRICS.register("kinetic")
@dataclass(frozen=True)
class Kinetic(SetMetric):
    """Frechet distance and diversity of kinetic features, FID_k and Div_k of the papers.

    Attributes
    ----------
    variant
        A key of `KINETIC_VARIANTS`.
    root
        Origin of positions, see `rooted`.
    up
        The axis that is taken as vertical.
    joints
        The first joints of the clip that are measured.
    statistics
        Normalisation of features, a key of `STATISTICS`.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = "Li et al. 2021, AI Choreographer, 5.2.1; variants: KINETIC_VARIANTS"
    better: ClassVar[dict[str, Better]] = {"fid_k": "lower", "div_k": "closer"}
    score: ClassVar[str] = "k"

    variant: str = "fixed"
    root: Root = "zero_start"
    up: Up = "y"
    joints: int = 24
    statistics: str = "numpy"

    def __post_init__(self) -> None:
        known_name("variant of kinetic features", self.variant, KINETIC_VARIANTS)
        super().__post_init__()

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        kinds = ("horizontal", "vertical", "energy")
        return tuple(f"{joint}.{kind}" for joint in range(self.joints) for kind in kinds)

    @override
    def measure(self, dance: Dance) -> Float64Array:
        positions = rooted(first_joints(dance.joints, self.joints), self.root)
        return KINETIC_VARIANTS[self.variant](positions, dance.fps, up=self.up)
