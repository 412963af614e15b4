"""The up axis of files of equal facts, judged over all of them: certain ones decide for those that show no floor."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.sides import body_direction, lies, stands, wrong_up
from dancedata.core.text import counted, listed
from dancedata.datasets.folder.facts import IN_MANIFEST, Fact
from dancedata.datasets.folder.load import Reading, load_motion, wrong_axis

#: Files that are judged first; only if one of them does not stand, all are.
_FIRST = 16
#: So many files that lie along one axis, and none that stands, are not dancers who lie.
_MANY = 3
#: Cosine of directions that count as one.
_ALIKE = 0.8

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Stance:
    """How the body of a file is, if its up axis is the one that is taken.

    `mean`: (3,) direction from the feet to the head, on average; +Y up.
    `certain`: 1 for one that certainly stands, -1 for one that certainly stands along another axis, else 0.
    """

    mean: Floats
    certain: int
    lies: bool

    @classmethod
    def of(cls, joints: Floats) -> "Stance":
        """Judge joints (T, J, 3), metres, +Y up."""
        wrong = wrong_up(joints)
        certain = -1 if wrong is not None and wrong[1] else int(stands(joints))
        return cls(body_direction(joints), certain, lies(joints))

    def __bool__(self) -> bool:
        """Whether it stands along +Y, as far as is known."""
        return not self.lies and self.certain >= 0


def wrong_files(stances: Mapping[str, Stance]) -> tuple[set[str], Floats]:
    """Return the names of files whose up axis is wrong, and the direction in which their bodies are; none, and zeros.

    Those along which a file certainly stands are wrong; so are all that do not certainly stand where more files
    certainly stand along another axis than along +Y, or where nothing is certain and several lie alike.
    """
    wrong = [stance for stance in stances.values() if stance.certain < 0]
    if not wrong:
        lying = [stance.mean for stance in stances.values() if stance.lies]
        mean = _unit(np.sum(lying, axis=0)) if lying else np.zeros(3)
        alike = sum(float(_unit(direction) @ mean) > _ALIKE for direction in lying)
        if not (alike >= _MANY and alike == len(stances)):
            return set(), np.zeros(3)
        return set(stances), mean
    mean = _unit(np.sum([stance.mean for stance in wrong], axis=0))
    most = len(wrong) > sum(stance.certain > 0 for stance in stances.values())
    return {
        name
        for name, stance in stances.items()
        if stance.certain < 0
        or (stance.certain == 0 and (most or (stance.lies and float(_unit(stance.mean) @ mean) > _ALIKE)))
    }, mean


def judge_up(files: Sequence[tuple[ClipRef, Reading, Fact[str], str]]) -> list[Reject]:
    """Return the rejects of clips whose up axis is wrong, as other files of their folder show."""
    groups: dict[tuple[str, str, str], list[tuple[ClipRef, Reading]]] = {}
    facts = {}
    for ref, reading, up, kind in files:
        if up.where != IN_MANIFEST:
            groups.setdefault((kind, up.value, up.where), []).append((ref, reading))
            facts[ref.id] = up
    return [reject for group in groups.values() for reject in _of_group(group, facts[group[0][0].id])]


def _of_group(group: Sequence[tuple[ClipRef, Reading]], up: Fact[str]) -> list[Reject]:
    first = {int(k) for k in np.linspace(0, len(group) - 1, min(_FIRST, len(group)))}
    stances = _stances([group[k] for k in sorted(first)], up)
    if all(stances.values()):
        return []
    stances |= _stances([pair for k, pair in enumerate(group) if k not in first], up)
    wrong, mean = wrong_files(stances)
    certain = [name for name in sorted(wrong) if stances[name].certain < 0]
    rejects = []
    for ref, _ in group:
        if ref.id not in wrong:
            continue
        others = [name for name in certain if name != ref.id]
        why = "and a steadier floor along that axis" if stances[ref.id].certain < 0 else _as_others(others, wrong)
        error = wrong_axis(ref.motion_path, mean, up, why)
        if error is not None:
            rejects.append(Reject(error.reason, clip=ref.id, file=str(ref.motion_path), detail=str(error)))
    return rejects


def _as_others(certain: Sequence[str], wrong: set[str]) -> str:
    if certain:
        number = counted(len(certain), "clip")
        return f"as {number} of this folder on a steadier floor along that axis: {listed(certain)}"
    return f"as all {counted(len(wrong), 'clip')} of this folder"


def _stances(files: Sequence[tuple[ClipRef, Reading]], up: Fact[str]) -> dict[str, Stance]:
    stances = {}
    for ref, reading in files:
        # Declared for the file, the axis is not questioned while it is read.
        believed = replace(reading, manifest=replace(reading.manifest, up=up.value))
        try:
            stances[ref.id] = Stance.of(load_motion(ref.motion_path, believed).joints())
        except DataError:
            continue  # another reject
    return stances


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))
