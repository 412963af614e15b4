"""Producers of BVH files: the names of their joints, as data, and which of them a file comes from.

A producer is a JSON file in the folder `producers`: ``joints``, SMPL's joint -> names, the preferred one first
(``{side}`` is left and right, ``{Side}`` Left and Right, ``{S}`` L and R); ``evidence``, names that are typical of it
("mixamorig:" is a namespace); ``without``, names that it does not have. Where `joints` changes, raise the version of
`dancedata.datasets.folder`: the names are not part of cache keys.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from dancedata.core.errors import DataError, did_you_mean
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed
from dancedata.files.strict_json import read_json

_FOLDER = Path(__file__).with_name("producers")
_LIMIT = 1 << 16
#: SMPL's joints that a skeleton must have; neck or head is required as well.
REQUIRED = tuple(
    ["pelvis"]
    + [f"{s}_{j}" for j in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist") for s in ("left", "right")]
)


@dataclass(frozen=True)
class Producer:
    """A program or dataset that writes BVH.

    Attributes
    ----------
    name, about
        Its name in `joint_map`, and what it is.
    joints
        SMPL joint -> names, the preferred one first. Namespaces, case, spaces and _ - . do not matter.
    evidence, without
        Names that are typical of it, and names that it does not have.
    """

    name: str
    about: str
    joints: Mapping[str, tuple[str, ...]]
    evidence: tuple[str, ...]
    without: tuple[str, ...]

    def found_in(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return its evidence among the names of a file; none if the file has a name that it lacks."""
        known = {plain(name) for name in names}
        spaces = {name.rpartition(":")[0].rstrip("0123456789").lower() for name in names}
        if any(plain(name) in known for name in self.without):
            return ()
        return tuple(e for e in self.evidence if (e[:-1] in spaces if e.endswith(":") else plain(e) in known))

    def matches(self, index_of: Mapping[str, int]) -> dict[int, int]:
        """Return the index in SMPL24 -> index in a file, whose indices are given by `plain` names."""
        found: dict[int, int] = {}
        for joint, names in self.joints.items():
            index = next((index_of[plain(n)] for n in names if plain(n) in index_of), None)
            if index is not None:
                found[SMPL24.index(joint)] = index
        return found


@dataclass(frozen=True)
class Detected:
    """The producers that a file may come from, all of which map its joints in the same way.

    Attributes
    ----------
    producers
        Those with most evidence; empty if no name is known.
    evidence
        The names that are typical of them, in the file.
    of
        Index in SMPL24 -> index in the file.
    """

    producers: tuple[Producer, ...]
    evidence: tuple[str, ...]
    of: Mapping[int, int]

    def __str__(self) -> str:
        names = " or ".join(producer.name for producer in self.producers)
        by = f"by {', '.join(self.evidence)}" if self.evidence else "nothing typical of one of them, and one map"
        return f"{names} ({by})" if names and (self.evidence or len(self.producers) > 1) else names


@lru_cache(maxsize=1)
def producers() -> Mapping[str, Producer]:
    """Return the producers that come with the package, by name."""
    return {path.stem: _read(path) for path in sorted(_FOLDER.glob("*.json"))}


def _read(path: Path) -> Producer:
    document = read_json(path, _LIMIT)
    joints = {}
    for joint, names in document["joints"].items():
        for side in ("left", "right") if "{" in joint else ("",):
            filled = tuple(name.format(Side=side.capitalize(), S=side[:1].upper()) for name in names)
            joints[joint.format(side=side)] = filled
    lists = (tuple(document[key]) for key in ("evidence", "without"))
    return Producer(path.stem, document["about"], joints, *lists)


def plain(name: str) -> str:
    """Return a name without namespace, case, spaces and separators."""
    return re.sub(r"[\s_.\-]", "", re.split(r"[:|]", name)[-1]).lower()


def detect(path: Path, names: Sequence[str], declared: Mapping[str, str], chosen: str = "") -> Detected:
    """Return the producer of a file by the names of its joints.

    The producer whose names match most joints; of several that map the joints in the same way, those with most
    evidence.

    Parameters
    ----------
    declared
        SMPL joint -> name, which is not looked for; "" excludes a joint.
    chosen
        A producer, which is not questioned.

    Raises
    ------
    DataError
        ``ambiguous_joint_map`` if a file has all required joints by the names of several producers that map them
        differently, or several joints of one name; ``bad_declaration`` for an unknown producer.
    """
    known = producers()
    if chosen and chosen not in known:
        raise DataError(
            f"joint_map: unknown producer {chosen!r}",
            reason="bad_declaration",
            where=str(path),
            allowed=did_you_mean(chosen, tuple(known)),
            fix="name a producer, or map the joints: joint_map {left_hip: NAME, ...}",
        )
    index_of: dict[str, int] = {}
    for k, name in enumerate(names):
        index_of.setdefault(plain(name), k)
    taken = {names.index(name) for name in declared.values() if name}
    found = {}
    for producer in [known[chosen]] if chosen else known.values():
        matches = producer.matches(index_of)
        skipped = {SMPL24.index(joint) for joint in declared}
        found[producer.name] = {s: k for s, k in matches.items() if s not in skipped and k not in taken}
    most = max(len(of) for of in found.values())
    of = next(of for of in found.values() if len(of) == most)
    if not chosen:
        _require_one(path, names, found, of, set(declared))
    _require_unique(path, names, of)
    alike = [known[name] for name, other in found.items() if other == of] if most else []
    evidence = {producer.name: producer.found_in(names) for producer in alike}
    best = max(map(len, evidence.values()), default=0)
    left = tuple(producer for producer in alike if len(evidence[producer.name]) == best)
    return Detected(left, evidence[left[0].name] if left else (), of)


def _require_one(
    path: Path, names: Sequence[str], found: Mapping[str, dict[int, int]], of: Mapping[int, int], declared: set[str]
) -> None:
    """Raise DataError if two producers name all joints that a body needs, and name different ones."""
    required = [SMPL24.index(joint) for joint in REQUIRED if joint not in declared]
    ours = [of.get(s) for s in required]
    others = {
        name: other
        for name, other in found.items()
        if None not in (theirs := [other.get(s) for s in required]) and theirs != ours
    }
    if None in ours or not others:
        return
    same = [name for name, other in found.items() if other == of]
    name, other = next(iter(others.items()))
    place = next(s for s in required if of[s] != other[s])
    of_each = " or ".join(f"{names[m[place]]} (as {who} has it)" for who, m in ((same[0], of), (name, other)))
    raise DataError(
        "the joints of this file have the names of several producers",
        reason="ambiguous_joint_map",
        where=str(path),
        found=f"all required joints of {listed([*same, *others])}; {SMPL24.joints[place]} is {of_each}",
        allowed="one producer",
        fix=f"declare joint_map: {same[0]} or joint_map: {name}, in a column of the manifest or in the recipe",
    )


def _require_unique(path: Path, names: Sequence[str], of: Mapping[int, int]) -> None:
    """Raise DataError if a joint that is mapped has a namesake, as in another namespace, such as a second person."""
    for s, k in of.items():
        refuse_twins(path, names, SMPL24.joints[s], [i for i, n in enumerate(names) if plain(n) == plain(names[k])])


def refuse_twins(path: Path, names: Sequence[str], joint: str, twins: Sequence[int]) -> None:
    """Raise DataError if several joints of a file, given by their indices, may be a joint of SMPL."""
    found = [names[k] for k in twins]
    if len(found) > 1:
        raise DataError(
            f"several joints of this file may be {joint}",
            reason="ambiguous_joint_map",
            where=str(path),
            found=listed(found),
            allowed="one of them",
            fix=f"declare the joint: joint_map {{{joint}: {found[0]}}}, and others like it"
            if len(set(found)) > 1
            else "give joints of one name different names in the file",
        )
