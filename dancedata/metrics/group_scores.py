"""Metrics of groups and duets as plug-ins, over the functions of `dancedata.metrics.groups`."""

from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.dance import Dance, Undefined
from dancedata.core.plugins import Better, Metric
from dancedata.core.registry import METRICS
from dancedata.core.rotations import Float64Array
from dancedata.core.typing import override
from dancedata.metrics.beats import beat_alignment, motion_beat_times
from dancedata.metrics.groups import (
    LIMB_RADIUS_M,
    beat_echo,
    collisions,
    contact_spans,
    duet_distances,
    group_correlation,
    group_kinetic,
    root_distances,
)
from dancedata.metrics.set_statistics import SetMetric

_GCD = "Le et al. 2023, Controllable Group Choreography Using Contrastive Diffusion; aioz-ai/GCD b9524d8, eval"
_DUOLANDO = "Siyao et al. 2024, Duolando; lisiyao21/Duolando abb93e6, utils/metrics_duet.py"
#: Width of the kernel of beats at their instants, seconds: Duolando's 3 frames at 30 per second.
_ECHO_S = 0.1


class _GroupMetric(Metric):
    """Measures groups of dancers; by default the columns are the scores."""

    of_groups: ClassVar[bool] = True
    bounds: ClassVar[tuple[float, float]] = (0, np.inf)

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        return tuple(self.better)


@METRICS.register("group_kinetic")
@dataclass(frozen=True)
class GroupKinetic(SetMetric, _GroupMetric):
    """GMR, group motion realism: the Frechet distance of kinetic features of groups, and their diversity.

    Attributes
    ----------
    joints
        The first joints of the dancers that are measured.
    statistics
        Normalisation of features, a key of `STATISTICS`.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = _GCD
    better: ClassVar[dict[str, Better]] = {"fid_group": "lower", "div_group": "closer"}
    score: ClassVar[str] = "group"

    joints: int = 24
    statistics: str = "numpy"

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        what = ("horizontal", "vertical", "energy")
        return tuple(f"group_kinetic_{joint}_{name}" for joint in range(self.joints) for name in what)

    @override
    def measure(self, dance: Dance) -> Float64Array:
        return group_kinetic(dance.joints[:, :, : self.joints], dance.fps)


@METRICS.register("group_correlation")
@dataclass(frozen=True)
class GroupCorrelation(_GroupMetric):
    """GMC, group motion correlation, see `group_correlation`.

    Attributes
    ----------
    joints
        The first joints of the dancers that are measured.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = _GCD
    better: ClassVar[dict[str, Better]] = {"gmc": "closer"}

    joints: int = 24

    @override
    def measure(self, dance: Dance) -> Float64Array:
        return np.array([group_correlation(dance.joints[:, :, : self.joints], dance.fps)])


@METRICS.register("collisions")
@dataclass(frozen=True)
class Collisions(_GroupMetric):
    """TIF, intersecting pairs of bodies per frame in both orders, and the share of frames with any: `collisions`."""

    version: ClassVar[int] = 1
    source: ClassVar[str] = "Le et al. 2023, Music-Driven Group Choreography, CVPR; capsules in place of meshes"
    better: ClassVar[dict[str, Better]] = {"tif": "closer", "colliding": "closer"}

    @override
    def measure(self, dance: Dance) -> Float64Array:
        _require_dancers(dance)
        hits = collisions(dance.joints, radius_m=LIMB_RADIUS_M)
        return np.array([hits.sum(axis=(0, 1)).mean(), hits.any(axis=(0, 1)).mean()])


@METRICS.register("root_distances")
@dataclass(frozen=True)
class RootDistances(_GroupMetric):
    """Distances of pelves in metres: the mean over pairs and frames, and the mean over frames of the nearest pair."""

    version: ClassVar[int] = 1
    source: ClassVar[str] = "this project"
    better: ClassVar[dict[str, Better]] = {"root_distance": "closer", "nearest_roots": "closer"}

    @override
    def measure(self, dance: Dance) -> Float64Array:
        _require_dancers(dance)
        of_pairs = root_distances(dance.joints)[np.triu_indices(len(dance.joints), 1)]
        return np.array([of_pairs.mean(), of_pairs.min(axis=0).mean()])


@METRICS.register("contact_spans")
@dataclass(frozen=True)
class ContactSpans(_GroupMetric):
    """Contacts of a hand with another dancer: the share of frames with one, and spans per minute, means over pairs.

    Attributes
    ----------
    within_m
        Largest distance of wrist and joint.
    least_s
        Shorter contacts are left out.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = "this project"
    better: ClassVar[dict[str, Better]] = {"touching": "closer", "contacts_per_minute": "closer"}

    within_m: float = 0.1
    least_s: float = 1 / 6

    @override
    def measure(self, dance: Dance) -> Float64Array:
        _require_dancers(dance)
        rows = []
        for a, b in combinations(dance.joints, 2):
            spans = contact_spans(a, b, within_m=self.within_m, least_frames=max(1, round(self.least_s * dance.fps)))
            touching = np.zeros(dance.n_frames, dtype=np.bool_)
            for span in spans:
                touching[span.start : span.end] = True
            rows.append([touching.mean(), len(spans) * 60 * dance.fps / dance.n_frames])
        return np.asarray(np.mean(rows, axis=0), dtype=np.float64)


@METRICS.register("duet_distances")
@dataclass(frozen=True)
class DuetDistances(SetMetric, _GroupMetric):
    """FID_cd and Div_cd: Frechet distance and diversity of the distances of two dancers, see `duet_distances`.

    Attributes
    ----------
    statistics
        Normalisation of features, a key of `STATISTICS`.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = _DUOLANDO
    better: ClassVar[dict[str, Better]] = {"fid_cd": "lower", "div_cd": "closer"}
    score: ClassVar[str] = "cd"

    statistics: str = "numpy"

    @property
    @override
    def columns(self) -> tuple[str, ...]:
        return tuple(f"duet_distance_{k}" for k in range(100))

    @override
    def measure(self, dance: Dance) -> Float64Array:
        return duet_distances(*_duet(dance))


@METRICS.register("beat_echo")
@dataclass(frozen=True)
class BeatEcho(_GroupMetric):
    """BED, beat echo degree: how near a beat of the follower is to each beat of the leader.

    Attributes
    ----------
    beats
        "instants": in seconds, with a kernel of 0.1 s. "bailando": Duolando's frames, with a kernel of 3 frames.
    """

    version: ClassVar[int] = 1
    source: ClassVar[str] = _DUOLANDO
    better: ClassVar[dict[str, Better]] = {"bed": "closer"}
    bounds: ClassVar[tuple[float, float]] = (0, 1)

    beats: Literal["instants", "bailando"] = "instants"

    @override
    def measure(self, dance: Dance) -> Float64Array:
        follower, leader = _duet(dance)
        if self.beats == "bailando":
            return np.array([beat_echo(leader, follower, dance.fps, detector=self.beats)])
        of_both = [motion_beat_times(joints, dance.fps) for joints in (leader, follower)]
        if not all(map(len, of_both)):
            raise Undefined("no_motion_beats")
        return np.array([beat_alignment(*of_both, sigma=_ECHO_S)])


def _require_dancers(dance: Dance) -> None:
    if len(dance.joints) < 2:
        raise Undefined("few_dancers", found=f"{len(dance.joints)}", allowed="at least 2")


def _duet(dance: Dance) -> tuple[Float64Array, Float64Array]:
    """Return follower and leader."""
    if len(dance.joints) != 2:
        raise Undefined("no_duet", found=f"{len(dance.joints)} dancers", allowed="2, the follower first")
    return dance.joints[0], dance.joints[1]
