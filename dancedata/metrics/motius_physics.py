"""Motius' physical metrics: jitter, dynamics, sliding, penetration, floating."""

from dataclasses import astuple, dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from dancedata.core.dance import Dance, checked_joints
from dancedata.core.plugins import Better, Metric
from dancedata.core.registry import METRICS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.core.tracks import runs
from dancedata.core.typing import override
from dancedata.metrics.arguments import BoolArray, Up, at_least, first_joints, y_up

N_JOINTS = 22
_TOES = list(SMPL24.feet[2:])
#: Steps per frame and heights, metres.
_DEPTH_M, _CONTACT_STEP_M, _CONTACT_HEIGHT_M = 0.005, 0.01, 0.02
_ROOT_STEP_M, _TINY_STEP_M, _EPS = 0.001, 1.2e-4, 1e-6
#: Steps of a foot relative to the pelvis's.
_SLOW, _FAST, _FLOATS = 0.6, 1.75, 0.4
#: Shortest run of frames without contact that counts.
_MIN_RUN = 4
_MAX_PEAKS = 2


@dataclass(frozen=True)
class Physics:
    """Motius' numbers of a clip, per frame: only clips of one rate compare. Its table has penetration x 1000."""

    jitter: float  # mean second difference of positions plus that of positions relative to the root, metres
    dynamic: float  # the same of first differences
    penetration: float  # mean depth of the toes below -5 mm; the floor is their lowest point, so it is 0
    floating: float  # share of frames with contacts that do not fit the root's motion; its table has it x 100
    sliding: float  # mean horizontal step of a toe in contact, metres


def physics(joints: Float64Array, *, up: Up = "y") -> Physics:
    """Return the physical metrics of Motius (ZeyuLing/Motius 50cf750, motius/evaluation).

    Computed in float32 up to the positions relative to the root, as there; in float64 from then on.

    Parameters
    ----------
    joints
        (T, J, 3) positions, metres: the first joints of SMPL or SMPL-X, at least 22.
    up
        Vertical axis.

    Raises
    ------
    Undefined
        "short": below 3 frames.
    DataError
        "missing_joints".
    """
    positions = first_joints(checked_joints(joints), N_JOINTS)
    at_least(3, positions)
    positions = y_up(positions, up)
    relative = positions - positions[:, :1]
    jitter, dynamic = (
        sum(float(np.linalg.norm(np.diff(p, n=n, axis=0), axis=2).mean()) for p in (positions, relative))
        for n in (2, 1)
    )
    toes = positions[:, _TOES]
    height = toes[..., 1] - toes[..., 1].min()
    step = _repeated(np.diff(toes, axis=0))
    contact = (np.linalg.norm(step, axis=2) < _CONTACT_STEP_M) | (height < _CONTACT_HEIGHT_M)
    slide = np.linalg.norm(step[..., (0, 2)], axis=2)
    return Physics(
        jitter=jitter,
        dynamic=dynamic,
        penetration=float((-_DEPTH_M - height).clip(min=0).mean()),
        floating=_floating(positions[:, 0], toes, contact),
        sliding=float(((slide * contact).sum(axis=0) / (contact.sum(axis=0) + _EPS)).mean()),
    )


def _repeated(steps: Float64Array) -> Float64Array:
    return np.concatenate([steps, steps[-1:]])


def _floating(pelvis: Float64Array, toes: Float64Array, contact: BoolArray) -> float:
    root = np.linalg.norm(_repeated(np.diff(pelvis, axis=0)), axis=1)
    relative = np.linalg.norm(_repeated(np.diff(toes - pelvis[:, None], axis=0)), axis=2) / (root[:, None] + _EPS)
    step = np.linalg.norm(_repeated(np.diff(toes, axis=0)), axis=2)
    moving = root >= _ROOT_STEP_M
    free = [runs(~column, _MIN_RUN) for column in contact.T]
    bad = int((moving & _bad_contacts(contact, _inverted(step, relative, root))).sum())
    floats = sum(
        int((relative[start:stop, foot] < _FLOATS).sum())
        for foot, spans in enumerate(free)
        for start, stop in spans
        if (~moving[start:stop]).sum() * 2 <= stop - start
    )
    swings = sum(_swing(toes[:, 0], max(a, c), min(b, d)) for (a, b), (c, d) in product(*free))
    return (bad + floats / 2 + swings) / len(pelvis)


def _inverted(step: Float64Array, relative: Float64Array, root: Float64Array) -> BoolArray:
    """Return whether a toe moves though it should stand: with the pelvis, or much faster; (T, 2)."""
    fast = (relative > _FAST) & (root[:, None] > _TINY_STEP_M)
    return np.asarray((step > _TINY_STEP_M) & ((relative < _SLOW) | fast))


def _bad_contacts(contact: BoolArray, inverted: BoolArray) -> BoolArray:
    """Return frames in which all toes in contact, one or two, are inverted, (T,)."""
    return np.asarray(contact.any(axis=1) & (inverted | ~contact).all(axis=1))


def _swing(toe: Float64Array, start: int, stop: int) -> int:
    """Return the number of frames if the toe's direction of flight has more than two peaks; 0 otherwise."""
    from scipy.signal import find_peaks

    if stop - start < _MIN_RUN:
        return 0
    path = toe[start + 1 : stop] - toe[start]
    lengths = (np.linalg.norm(path, axis=1) + _EPS) * (np.linalg.norm(path[-1]) + _EPS)
    angle = np.degrees(np.arccos((path @ path[-1] / lengths).clip(-1, 1)))
    return stop - start if len(find_peaks(angle)[0]) > _MAX_PEAKS else 0


@METRICS.register("physics")
@dataclass(frozen=True)
class MotiusPhysics(Metric):
    """Jitter, Dynamic, Penet, Float and Slide of Motius' table.

    Attributes
    ----------
    up
        The axis that is vertical.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = "ZeyuLing/Motius 50cf750, motius/evaluation"
    better: ClassVar[dict[str, Better]] = {
        "jitter": "lower", "dynamic": "closer", "penetration": "lower", "floating": "lower", "sliding": "lower",
    }  # fmt: skip
    bounds: ClassVar[tuple[float, float]] = (0, np.inf)

    up: Up = "y"

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        return ("jitter", "dynamic", "penetration", "floating", "sliding")

    @override
    def measure(self, dance: Dance) -> Float64Array:
        return np.array(astuple(physics(dance.joints, up=self.up)))
