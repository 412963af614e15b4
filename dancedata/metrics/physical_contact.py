"""Physical foot contact (PFC) and physical body contact (PBC): acceleration of the body without a standing foot."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.dance import Dance, Undefined, checked_joints
from dancedata.core.plugins import Better, Metric
from dancedata.core.registry import METRICS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.typing import override
from dancedata.metrics.arguments import Up, at_least, axis_of, checked_rate, first_joints, known_name

#: The rate of EDGE's data, at which all figures were published.
EDGE_FPS = 30.0
_SCALE = 10_000.0
_LEFT_ANKLE, _RIGHT_ANKLE, _LEFT_TOE, _RIGHT_TOE = SMPL24.feet
_HEAD, _NECK = SMPL24.index("head"), SMPL24.index("neck")
_ARMS = tuple(
    tuple(SMPL24.index(f"{side}_{joint}") for joint in ("wrist", "hand", "collar")) for side in ("left", "right")
)
#: POPDG's weights of the arms and of the head.
_ARM_WEIGHT, _HEAD_WEIGHT = 0.01, 0.1


@dataclass(frozen=True)
class PfcVariant:
    """Constant that the mean of PFC is multiplied by, and the unit of time of the speeds of the feet.

    Per frame of the clip, the value falls with the square of the rate.
    """

    source: str
    scale: float
    per: Literal["1/30 s", "frame", "s"]

    def factor(self, fps: float) -> float:
        """Return what the mean of products of two steps per frame is multiplied by."""
        frames_per_unit = {"1/30 s": fps / EDGE_FPS, "frame": 1.0, "s": fps}[self.per]
        return self.scale * frames_per_unit**2


#: By name. All three agree at 30 frames per second, "paper" except for a constant.
PFC_VARIANTS = {
    "rescaled": PfcVariant(
        "EDGE's code with speeds per 1/30 s, so that it does not depend on the rate", _SCALE, "1/30 s"
    ),
    "code": PfcVariant("Stanford-TML/EDGE 17c3428, eval/eval_pfc.py; POPDG, DGSDP, FlowerDance", _SCALE, "frame"),
    "paper": PfcVariant("Tseng et al. 2023, EDGE, section 5.2: no constant; taken with speeds in m/s", 1.0, "s"),
}


def pfc(joints: Float64Array, fps: float, *, variant: str = "rescaled", up: Up = "y") -> float:
    """Return the physical foot contact score: lower is better, 0 if one foot is planted (EDGE, Tseng et al. 2023).

    The mean over the frames 1 ... T - 2 of ``|a| / max |a|`` times the speeds of both feet. a is the acceleration of
    the root with its downward part set to 0; the speed of a foot is the lesser of its ankle's and its toe's,
    horizontal.

    Parameters
    ----------
    joints, fps
        (T, J, 3) positions, metres: SMPL's joints, at least 12; and their frames per second.
    variant
        A key of `PFC_VARIANTS`.
    up
        Vertical axis.

    Raises
    ------
    Undefined
        "short": below 3 frames; "still": the root never accelerates, 0 / 0.
    DataError
        "missing_joints".
    """
    known_name("variant of PFC", variant, PFC_VARIANTS)
    factor = PFC_VARIANTS[variant].factor(checked_rate(fps))
    return factor * float(_foot_products(_checked(joints, _RIGHT_TOE + 1), axis_of(up)).mean())


def pbc(joints: Float64Array, fps: float, *, variant: str = "rescaled", up: Up = "y") -> float:
    """Return the physical body contact score of POPDG (Luo et al. 2024): higher is better.

    10,000 times the mean of products of speeds and relative accelerations of both arms and of the head, minus those
    of the feet (`pfc`). POPDG's program prints it as "PFC".

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres: SMPL's 24 joints; with SMPL-X, 22 and 23 are the jaw and the left eye.
    fps, up
        As `pfc`.
    variant
        "code": speeds per frame, as POPDG at 30 per second; "rescaled": those of feet per 1/30 s, as `pfc`, and so
        are those of arms and head.

    Raises
    ------
    Undefined, DataError
        As `pfc`.
    """
    known_name("variant of PBC", variant, ("rescaled", "code"))
    positions = _checked(joints, SMPL24.n_joints)
    unit = checked_rate(fps) / EDGE_FPS if variant == "rescaled" else 1.0
    speed = np.linalg.norm(np.diff(positions, axis=0)[1:], axis=2) * unit
    effort = _relative(np.linalg.norm(np.diff(positions, n=2, axis=0), axis=2))
    arms = sum(np.minimum(speed[:, wrist], speed[:, hand]) * effort[:, collar] for wrist, hand, collar in _ARMS)
    reward = _ARM_WEIGHT * arms + _HEAD_WEIGHT * speed[:, _HEAD] * effort[:, _NECK]
    return _SCALE * float((reward - unit**2 * _foot_products(positions, axis_of(up))).mean())


def _checked(joints: Float64Array, n_joints: int) -> Float64Array:
    positions = first_joints(checked_joints(joints), n_joints)
    at_least(3, positions)
    return positions


def _foot_products(positions: Float64Array, axis: int) -> Float64Array:
    """Return relative acceleration of the root times the steps of both feet, (T - 2,)."""
    root = np.diff(positions[:, 0], n=2, axis=0)
    root[:, axis] = root[:, axis].clip(min=0)
    acceleration = np.linalg.norm(root, axis=1)
    if not acceleration.max() > 0:
        raise Undefined("still", found="a root that is at rest, falls freely or moves evenly")
    horizontal = np.delete(np.diff(positions[:, SMPL24.feet], axis=0)[1:], axis, axis=2)
    step = np.linalg.norm(horizontal, axis=2)
    left, right = np.minimum(step[:, 0], step[:, 2]), np.minimum(step[:, 1], step[:, 3])
    return np.asarray(left * right * acceleration / acceleration.max(), dtype=np.float64)


def _relative(values: Float64Array) -> Float64Array:
    """Divide columns by their maxima, except those of zeros."""
    largest = values.max(axis=0)
    return values / np.where(largest > 0, largest, 1)


@METRICS.register("pfc")
@dataclass(frozen=True)
class Pfc(Metric):
    """Physical foot contact score (EDGE): the mean over clips, and the median, as its tails are heavy.

    Attributes
    ----------
    variant
        A key of `PFC_VARIANTS`.
    up
        The axis that is taken as vertical.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = "Tseng et al. 2023, EDGE; Stanford-TML/EDGE 17c3428, eval/eval_pfc.py"
    better: ClassVar[dict[str, Better]] = {"pfc": "lower", "pfc_median": "lower"}
    bounds: ClassVar[tuple[float, float]] = (0, np.inf)

    variant: str = "rescaled"
    up: Up = "y"

    def __post_init__(self) -> None:
        known_name("variant of PFC", self.variant, PFC_VARIANTS)

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        return ("pfc",)

    @override
    def measure(self, dance: Dance) -> Float64Array:
        return np.array([pfc(dance.joints, dance.fps, variant=self.variant, up=self.up)])

    @override
    def summarise(self, rows: Float64Array, pool: Float64Array | None = None) -> dict[str, float]:
        return {**super().summarise(rows, pool), "pfc_median": float(np.median(rows))}


@METRICS.register("pbc")
@dataclass(frozen=True)
class Pbc(Metric):
    """Physical body contact score (POPDG).

    Attributes
    ----------
    variant
        "rescaled" or "code", see `pbc`.
    up
        The axis that is taken as vertical.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = "Luo et al. 2024, POPDG; Luke-Luo1/POPDG ec57d87, eval"
    better: ClassVar[dict[str, Better]] = {"pbc": "higher"}

    variant: Literal["rescaled", "code"] = "rescaled"
    up: Up = "y"

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        return ("pbc",)

    @override
    def measure(self, dance: Dance) -> Float64Array:
        return np.array([pbc(dance.joints, dance.fps, variant=self.variant, up=self.up)])
