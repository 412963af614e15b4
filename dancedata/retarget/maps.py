"""Joint maps: which joint of a skeleton is which of SMPL's 24. They are data: JSON files in the folder `maps`.

A map is ``{"about": "...", "joints": {"left_hip": ["LeftUpLeg"], ...}}``, names in order of preference. Namespaces
("mixamorig:"), case, spaces and _ - . are ignored, and a prefix or suffix that all joints share.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import shown
from dancedata.files.strict_json import read_json
from dancedata.formats.bvh.producers import affixed, plain

_FOLDER = Path(__file__).with_name("maps")
#: Largest file of a joint map, bytes.
_LIMIT = 1 << 20
_REQUIRED = (
    "pelvis",
    *(f"{s}_{j}" for j in ("hip", "knee", "ankle", "shoulder", "elbow") for s in ("left", "right")),
)

#: SMPL joint -> names in the other skeleton, the preferred one first.
Names = Mapping[str, tuple[str, ...]]


def map_names() -> tuple[str, ...]:
    """Return the names of the maps that come with the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.json")))


def load_map(map_or_path: str | Path | Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Return a joint map: a name of the package's, the path of a JSON file, or SMPL joint -> name or names."""
    if isinstance(map_or_path, Mapping):
        return _checked(map_or_path, "joint map")
    if str(map_or_path) in map_names():
        return _shipped(str(map_or_path))
    path = Path(map_or_path).expanduser()
    if path.suffix != ".json":
        raise UsageError(f"unknown joint map {shown(str(map_or_path))!r}",
                         allowed=f"auto, {', '.join(map_names())}, or the path of a .json file",
                         fix=did_you_mean(str(map_or_path), map_names()))  # fmt: skip
    try:
        document = read_json(path, _LIMIT)
    except (OSError, ValueError) as error:
        raise UsageError("the joint map cannot be read", where=path, found=str(error)) from error
    return _checked(document.get("joints") if isinstance(document, dict) else None, str(path))


@lru_cache(maxsize=16)
def _shipped(name: str) -> dict[str, tuple[str, ...]]:
    return _checked(read_json(_FOLDER / f"{name}.json", _LIMIT)["joints"], name)


def _checked(joints: Any, where: str) -> dict[str, tuple[str, ...]]:
    if not isinstance(joints, Mapping) or not joints:
        raise UsageError("a joint map has a mapping of SMPL's joints to names", where=where,
                         found=shown(repr(joints)),
                         allowed='{"joints": {"left_hip": ["LeftUpLeg"], ...}}')  # fmt: skip
    checked = {}
    for joint, names in joints.items():
        SMPL24.index(joint)
        listed = [names] if isinstance(names, str) else names
        if not isinstance(listed, list | tuple) or not all(isinstance(name, str) for name in listed):
            raise UsageError(
                "the names of a joint must be texts", where=f"{where}, {joint}", found=shown(repr(names))
            )
        checked[joint] = tuple(listed)
    return checked


def map_skeleton(skeleton: Skeleton, names: Names | None = None) -> dict[int, int]:
    """Return the index in SMPL24 -> index in a skeleton; by default with the map that matches most joints."""
    tables = [names] if names is not None else [_shipped(name) for name in map_names()]
    joints = dict(enumerate(map(plain, skeleton.joints)))
    matches = [(_matches(joints, table), table) for table in tables]
    if all(map(_missing, (match for match, _ in matches))):
        for table in tables:
            needed = [table.get(joint, ()) for joint in _REQUIRED]
            matches += [(_matches(cores, table), table) for _, cores in affixed(joints, needed)]
    # Of maps that match equally many joints, the one that names fewer others.
    of = max(matches, key=lambda match: (len(match[0]), -len(match[1])))[0]
    missing = _missing(of)
    if missing:
        raise UsageError(
            f"skeleton {skeleton.name} cannot be mapped to SMPL's joints: no joint for {', '.join(missing)}",
            found=f"joints {', '.join(skeleton.joints[:8])}, ...",
            fix="write a joint map and name it in retarget.joint_map",
        )
    for joint in of:
        above = SMPL24.parents[joint]
        while above not in of and above != -1:
            above = SMPL24.parents[above]
        if above != -1 and of[above] not in _ancestors(skeleton.parents, of[joint]):
            raise UsageError(f"the joint map does not fit the tree of skeleton {skeleton.name}",
                             found=f"{skeleton.joints[of[joint]]} ({SMPL24.joints[joint]}) is not below "
                             f"{skeleton.joints[of[above]]} ({SMPL24.joints[above]})",
                             fix="correct retarget.joint_map")  # fmt: skip
    return of


def _missing(of: Mapping[int, int]) -> list[str]:
    mapped = {SMPL24.joints[j] for j in of}
    missing = [joint for joint in _REQUIRED if joint not in mapped]
    return missing if mapped & {"neck", "head"} else [*missing, "neck or head"]


def _matches(joints: Mapping[int, str], table: Names) -> dict[int, int]:
    index_of: dict[str, int] = {}
    for k, joint in joints.items():
        index_of.setdefault(joint, k)
    of: dict[int, int] = {}
    for joint, names in table.items():
        index = next((index_of[plain(name)] for name in names if plain(name) in index_of), None)
        if index is not None and index not in of.values():
            of[SMPL24.index(joint)] = index
    return dict(sorted(of.items()))


def _ancestors(parents: Sequence[int], joint: int) -> list[int]:
    line = []
    while (joint := parents[joint]) != -1:
        line.append(joint)
    return line
