"""Producers of BVH files: the names of their joints, as data, and which of them a file comes from.

A producer is a JSON file in the folder `producers`: ``joints``, SMPL's joint -> names, the preferred one first
(``{side}`` is left and right, ``{Side}`` Left and Right, ``{S}`` L and R), or the producer that has the same;
``evidence``, names that are typical of it ("mixamorig:" is a namespace or a prefix); ``without``, names that it does
not have. Where `joints` changes, raise the version of `dancedata.datasets.folder`: names are not part of cache keys.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import takewhile
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


def plain(name: str) -> str:
    """Return a name without namespace, case, spaces and separators."""
    return re.sub(r"[\s_.\-]", "", re.split(r"[:|]", name)[-1]).lower()


def affixed(
    joints: Mapping[int, str], known: Iterable[Iterable[str]]
) -> Iterator[tuple[tuple[str, str], dict[int, str]]]:
    """Yield what joints may all have before and behind their names, and the names of those that have it, without it.

    `joints`: `plain` names by index. `known`: Names of each joint that a body needs, all of which have both.
    """
    shared: set[tuple[str, str]] | None = None
    for names in known:
        cores = set(map(plain, names))
        found = [(joint, core) for joint in joints.values() for core in cores if core in joint]
        parts = {part[::2] for joint, core in found for part in (joint.partition(core), joint.rpartition(core))}
        shared = parts if shared is None else shared & parts
    for prefix, suffix in sorted((shared or set()) - {("", "")}):
        yield (
            (prefix, suffix),
            {
                k: joint[len(prefix) : len(joint) - len(suffix)]
                for k, joint in joints.items()
                if len(joint) > len(prefix + suffix) and joint.startswith(prefix) and joint.endswith(suffix)
            },
        )


@dataclass(frozen=True)
class Producer:
    """A program that writes BVH: its names of SMPL's joints, the preferred first, typical ones, and ones it lacks."""

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
    """The producers with most evidence, which map the joints of a file in one way (index in SMPL24 -> in the file).

    `affixes`: What all these joints have before and behind the producers' names, as written: "Character1_", "".
    """

    producers: tuple[Producer, ...]
    evidence: tuple[str, ...]
    of: Mapping[int, int]
    affixes: tuple[str, str] = ("", "")

    def __str__(self) -> str:
        names = " or ".join(producer.name for producer in self.producers)
        by = f"by {', '.join(self.evidence)}" if self.evidence else "nothing typical of one of them, and one map"
        text = f"{names} ({by})" if names and (self.evidence or len(self.producers) > 1) else names
        named = [f"{kind} {affix!r}" for kind, affix in zip(("prefix", "suffix"), self.affixes, strict=True) if affix]
        return ", ".join([text, *named])


@lru_cache(maxsize=1)
def producers() -> Mapping[str, Producer]:
    """Return the producers that come with the package, by name."""
    return {path.stem: _read(path) for path in sorted(_FOLDER.glob("*.json"))}


def _read(path: Path) -> Producer:
    document = read_json(path, _LIMIT)
    if isinstance(document["joints"], str):
        joints = dict(_read(path.with_stem(document["joints"])).joints)
        document["joints"] = {}
    else:
        joints = {}
    for joint, names in document["joints"].items():
        for side in ("left", "right") if "{" in joint else ("",):
            filled = tuple(name.format(Side=side.capitalize(), S=side[:1].upper()) for name in names)
            joints[joint.format(side=side)] = filled
    lists = (tuple(document[key]) for key in ("evidence", "without"))
    return Producer(path.stem, document["about"], joints, *lists)


def detect(path: Path, names: Sequence[str], declared: Mapping[str, str], chosen: str = "") -> Detected:
    """Return the producers whose names match most joints of a file, of equal ones those with most evidence.

    `declared`: SMPL joint -> name, which is not looked for. `chosen`: A producer, which is not questioned.
    Raises DataError: ``ambiguous_joint_map`` for several bodies or namesakes, ``bad_declaration`` for no producer.
    """
    known = producers()
    if chosen and chosen not in known:
        raise DataError(f"joint_map: unknown producer {chosen!r}", reason="bad_declaration", where=str(path),
                        allowed=did_you_mean(chosen, tuple(known)),
                        fix="name a producer, or map the joints: joint_map {left_hip: NAME, ...}")  # fmt: skip
    considered = [known[chosen]] if chosen else list(known.values())
    need = [joint for joint in REQUIRED if joint not in declared]
    taken = {names.index(name) for name in declared.values() if name}
    free = {k: name for k, name in enumerate(names) if k not in taken}
    found = [_Match.of_names(producer, free, declared) for producer in considered]
    if not any(match.has(need) for match in found) and need:
        found += [match for producer in considered for match in _affixed(producer, free, declared, need)]
    best = _best(path, names, found, need)
    _require_unique(path, names, best.of)
    alike = [match for match in found if match.of == best.of] if best.of else []
    most = max((len(match.evidence) for match in alike), default=0)
    left = [match for match in alike if len(match.evidence) == most]
    affixes = _as_written([names[k] for k in best.of.values()], best.affixes)
    return Detected(tuple(m.producer for m in left), left[0].evidence if left else (), best.of, affixes)


@dataclass(frozen=True)
class _Match:
    """The joints that one producer names in a file, all with one prefix and suffix, as `plain` names have them."""

    producer: Producer
    of: dict[int, int]
    evidence: tuple[str, ...]
    affixes: tuple[str, str] = ("", "")

    @classmethod
    def of_names(
        cls,
        producer: Producer,
        names: Mapping[int, str],
        declared: Iterable[str],
        affixes: tuple[str, str] = ("", ""),
    ) -> "_Match":
        index_of: dict[str, int] = {}
        for k, name in names.items():
            index_of.setdefault(plain(name), k)
        skipped = {SMPL24.index(joint) for joint in declared}
        of = {s: k for s, k in producer.matches(index_of).items() if s not in skipped}
        return cls(producer, of, producer.found_in(list(names.values())), affixes)

    def has(self, joints: Iterable[str]) -> bool:
        return all(SMPL24.index(joint) in self.of for joint in joints)


def _affixed(
    producer: Producer, names: Mapping[int, str], declared: Iterable[str], need: Sequence[str]
) -> Iterator[_Match]:
    """Yield the matches that have all needed joints, each with the same prefix and suffix: "Character1_Hips"."""
    plains = {k: plain(name) for k, name in names.items()}
    for affixes, cores in affixed(plains, [producer.joints[joint] for joint in need]):
        spaced = {k: f"{affixes[0]}:{core}" for k, core in cores.items()}
        match = _Match.of_names(producer, spaced, declared, affixes)
        if match.has(need):
            yield match


def _as_written(names: Sequence[str], affixes: tuple[str, str]) -> tuple[str, str]:
    """Return the prefix and the suffix of `plain` names as a file has them."""
    letters = (zip(*(name[::way] for name in names), strict=False) for way in (1, -1))
    prefix, suffix = ("".join(c[0] for c in takewhile(lambda c: len(set(c)) == 1, run)) for run in letters)
    return prefix if affixes[0] else "", suffix[::-1] if affixes[1] else ""


def _best(path: Path, names: Sequence[str], found: Sequence[_Match], need: Sequence[str]) -> _Match:
    """Return the match with most joints; DataError if complete ones, with evidence first, contradict each other."""
    complete = [match for match in found if match.has(need)]
    required = [SMPL24.index(joint) for joint in need]

    def maps(matches: Iterable[_Match]) -> set[tuple[int, ...]]:
        return {tuple(match.of[s] for s in required) for match in matches}

    if len(maps(complete)) > 1:
        complete = [match for match in complete if match.evidence] or complete
    best = max(complete or found, key=lambda match: len(match.of))
    other = next((match for match in complete if maps([match]) != maps([best])), None)
    if other is None:
        return best
    place = next(s for s in required if best.of[s] != other.of[s])
    both = [f"{names[match.of[place]]} (as {match.producer.name} has it)" for match in (best, other)]
    of_name = [f"joint_map: {match.producer.name}" for match in (best, other)]
    raise DataError(
        "the joints of this file have the names of several producers, or of several bodies",
        reason="ambiguous_joint_map",
        where=str(path),
        found=f"all required joints of {listed(list(dict.fromkeys(m.producer.name for m in complete)))}; "
        f"{SMPL24.joints[place]} is {' or '.join(both)}",
        allowed="one of them",
        fix=f"declare {' or '.join(of_name)}, in a column of the manifest or in the recipe"
        if of_name[0] != of_name[1]
        else "map the joints: joint_map {left_hip: NAME, ...}",
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
