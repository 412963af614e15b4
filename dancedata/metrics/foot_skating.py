"""Foot skating: the share of frames in which a foot on the ground slides."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dancedata.core.dance import Dance, Undefined, checked_joints
from dancedata.core.ground import ground_height
from dancedata.core.plugins import Better, Metric
from dancedata.core.registry import METRICS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.typing import override
from dancedata.metrics.arguments import (
    BoolArray,
    IntArray,
    Up,
    at_least,
    checked_rate,
    first_joints,
    known_name,
    y_up,
)

_LEFT_ANKLE, _RIGHT_ANKLE, _LEFT_TOE, _RIGHT_TOE = SMPL24.feet
#: Ankle and toe of the left and of the right foot.
_FEET = ((_LEFT_ANKLE, _LEFT_TOE), (_RIGHT_ANKLE, _RIGHT_TOE))
#: Heights above the ground of an ankle and a toe in contact, metres (Lodge).
_ANKLE_M, _TOE_M = 0.08, 0.05
#: Lodge's limit of a step, metres per frame, and the same as a speed at its 30 frames per second.
_STEP_M, _SPEED_M_S = 0.01, 0.3
#: Guided Motion Diffusion: height, and speed at its 20 frames per second.
_GMD_HEIGHT_M, _GMD_SPEED_M_S, _GMD_FPS = 0.05, 0.5, 20.0
#: Duolando: steps of the pelvis, and of the ankles relative to it, metres per frame.
_PELVIS_M, _ANKLE_STEP_M = 0.03, 0.01


@dataclass(frozen=True, eq=False)
class Skating:
    """Counts of frames, for one foot after the other, or for both together."""

    sliding: IntArray  # (F,) frames in which the foot slides
    counted: IntArray  # (F,) frames that these are a share of

    @property
    def ratios(self) -> Float64Array:
        """Shares (F,); Undefined ("no_contact") if there is nothing to divide by."""
        if not self.counted.all():
            raise Undefined("no_contact", found=f"frames in contact: {self.counted.tolist()}")
        return np.asarray(self.sliding / self.counted, dtype=np.float64)

    @property
    def ratio(self) -> float:
        """The mean of `ratios`."""
        return float(self.ratios.mean())


def _steps(positions: Float64Array) -> Float64Array:
    """Return horizontal steps to the next frame, (T, J, 2); 0 for the last one."""
    steps = np.zeros((*positions.shape[:2], 2))
    steps[:-1] = np.diff(positions[..., (0, 2)], axis=0)
    return steps


def _lodge(positions: Float64Array, moving: BoolArray) -> Skating:
    heights = positions[:, :, 1] - ground_height(positions, SMPL24)  # of the toes in frame 0
    contacts = np.stack(
        [(heights[:, ankle] <= _ANKLE_M) & (heights[:, toe] <= _TOE_M) for ankle, toe in _FEET], axis=1
    )
    slides = np.stack([moving[:, foot].any(axis=1) for foot in _FEET], axis=1)
    return Skating((contacts & slides).sum(axis=0), contacts.sum(axis=0))


def _lodge_code(positions: Float64Array, fps: float) -> Skating:
    return _lodge(positions, np.abs(_steps(positions).sum(axis=2) / 2) > _STEP_M)


def _lodge_norm(positions: Float64Array, fps: float) -> Skating:
    return _lodge(positions, np.linalg.norm(_steps(positions), axis=2) > _STEP_M)


def _speed(positions: Float64Array, fps: float) -> Skating:
    return _lodge(positions, np.linalg.norm(_steps(positions), axis=2) * fps > _SPEED_M_S)


def _gmd(positions: Float64Array, fps: float) -> Skating:
    toes = positions[:, (_LEFT_TOE, _RIGHT_TOE)]
    speed = np.linalg.norm(_steps(toes)[:-1], axis=2) * _GMD_FPS
    # A 5-frame box filter with zero padding.
    smooth = np.stack([np.convolve(column, np.ones(5) / 5, mode="full")[2:-2] for column in speed.T], axis=1)
    low = toes[..., 1] < _GMD_HEIGHT_M
    skates = low[:-1] & low[1:] & (speed > _GMD_SPEED_M_S) & (smooth > _GMD_SPEED_M_S)
    return Skating(np.array([skates.any(axis=1).sum()]), np.array([len(speed)]))


def _duolando(positions: Float64Array, fps: float) -> Skating:
    pelvis = np.diff(positions[:, 0], axis=0)
    ankles = np.diff(positions[:, (_LEFT_ANKLE, _RIGHT_ANKLE)] - positions[:, :1], axis=0)
    still = (np.linalg.norm(ankles, axis=2) < _ANKLE_STEP_M).all(axis=1)
    glides = np.linalg.norm(pelvis[:, (0, 2)], axis=1) > _PELVIS_M
    # As in the code: the first step never slides, but counts.
    return Skating(np.array([(glides & still)[1:].sum()]), np.array([len(pelvis)]))


@dataclass(frozen=True)
class SkatingRule:
    """A definition of skating."""

    source: str
    # the rule: positions (T, J, 3) with y up, frames per second -> `Skating`
    count: Callable[[Float64Array, float], Skating]
    feet: bool = True  # whether each foot is counted by itself
    pooled: bool = False  # whether frames of all clips are added up, in place of a mean of shares


#: By name. "speed" is Lodge's with the norm of the horizontal speed, 0.3 m/s, so that it does not depend on the rate.
SKATING_RULES = {
    "speed": SkatingRule("Lodge's rule with the norm of the speed, in m/s", _speed),
    "lodge-norm": SkatingRule("Lodge's rule with the norm of the step per frame", _lodge_norm),
    "lodge-code": SkatingRule("li-ronghui/LODGE a898e59, metric: mean of the signed components", _lodge_code),
    "gmd": SkatingRule(
        "Karunratanakul et al. 2023, korrawe/guided-motion-diffusion, calculate_skating_ratio", _gmd, feet=False
    ),
    "duolando": SkatingRule(
        "lisiyao21/Duolando abb93e6, metric_footskating_dur.py", _duolando, feet=False, pooled=True
    ),
}


def skating(joints: Float64Array, fps: float, *, rule: str = "speed", up: Up = "y") -> Skating:
    """Count the frames in which feet skate.

    Rules "speed", "lodge-norm", "lodge-code": the ground is at the toes' height in frame 0. A foot is in contact if
    its ankle is at most 8 cm and its toe at most 5 cm above; it slides if ankle or toe moves sideways to the next
    frame, by 0.3 m/s ("speed"), 1 cm a frame ("lodge-norm"), or by a mean of the signed components x and z of 1 cm a
    frame ("lodge-code", to which motion along x = -z is invisible). Shares are of the frames in contact.

    "gmd": a toe below 5 cm in two frames moves with more than 2.5 cm a frame, by itself and as a mean of five frames;
    the floor has to be at 0, the constants are for 20 frames per second. A share of all frames.

    "duolando": the pelvis moves sideways by more than 3 cm a frame while both ankles move by less than 1 cm relative
    to it. A share of all steps. Duolando's program takes z as up, as DD100 has it.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres: the first joints of SMPL or SMPL-X, at least 12.
    fps
        Frames per second; only "speed" depends on it.
    rule
        A key of `SKATING_RULES`.
    up
        Vertical axis.

    Raises
    ------
    Undefined
        "short": below 2 frames. `Skating.ratios` raises "no_contact".
    DataError
        "missing_joints".

    Examples
    --------
    >>> from dancedata.metrics import skating
    >>> from dancedata.synthetic import synthesise_motion
    >>> joints = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)[0].joints()
    >>> skating(joints, 60)
    Skating(sliding=array([2, 1]), counted=array([83, 90]))
    """
    known_name("skating rule", rule, SKATING_RULES)
    positions = first_joints(checked_joints(joints), _RIGHT_TOE + 1)
    at_least(2, positions)
    return SKATING_RULES[rule].count(y_up(positions, up), checked_rate(fps))


@METRICS.register("skating")
@dataclass(frozen=True)
class FootSkating(Metric):
    """Foot skating ratio: FSR, skating ratio.

    Attributes
    ----------
    rule
        A key of `SKATING_RULES`.
    up
        The axis that is vertical.
    """

    version: ClassVar[int] = 2
    source: ClassVar[str] = "Li et al. 2024, Lodge; rules: SKATING_RULES"
    better: ClassVar[dict[str, Better]] = {"skating_left": "lower", "skating_right": "lower", "skating": "lower"}
    bounds: ClassVar[tuple[float, float]] = (0, 1)

    rule: str = "speed"
    up: Up = "y"

    def __post_init__(self) -> None:
        known_name("skating rule", self.rule, SKATING_RULES)

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        """Shares of the left and the right foot, or frames that skate and frames."""
        return ("skating_left", "skating_right") if SKATING_RULES[self.rule].feet else ("skating_frames", "frames")

    @override
    def measure(self, dance: Dance) -> Float64Array:
        counts = skating(dance.joints, dance.fps, rule=self.rule, up=self.up)
        if SKATING_RULES[self.rule].feet:
            return counts.ratios
        return np.array([counts.sliding[0], counts.counted[0]], dtype=np.float64)

    @override
    def summarise(self, rows: Float64Array, pool: Float64Array | None = None) -> dict[str, float]:
        means = super().summarise(rows, pool)
        rule = SKATING_RULES[self.rule]
        if rule.feet:
            return {**means, "skating": float(rows.mean())}
        if rule.pooled:
            return {"skating": float(rows[:, 0].sum() / rows[:, 1].sum())}
        return {"skating": float((rows[:, 0] / rows[:, 1]).mean())}
