"""Groups are stored whole, or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from dancedata.building.result import Result
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.text import listed


class Groups(NamedTuple):
    """The groups of a source."""

    members: Mapping[str, Sequence[str]]  # ids of dancers, or what stands for those that are not listed
    sizes: Mapping[str, int]  # dancers of each group
    keep: bool  # whether a group is stored without dancers that were left out


def groups_of(clips: Sequence[ClipRef], keep: bool) -> Groups:
    """Return the groups of the clips of a source."""
    members: dict[str, list[ClipRef]] = {}
    for ref in sorted(clips, key=lambda ref: ref.member):
        if ref.group:
            members.setdefault(ref.group, []).append(ref)
    sizes = {group: max(len(of), *(ref.group_size for ref in of)) for group, of in members.items()}
    named = {group: [ref.id for ref in of] for group, of in members.items()}
    for group, ids in named.items():
        n = sizes[group] - len(ids)
        ids += [f"{n} that the source lacks"] if n else []
    return Groups(named, sizes, keep)


def whole(results: Sequence[Result], groups: Groups) -> list[Result]:
    """Return results in which groups that lack a dancer of the source are left out, with their copies."""
    if groups.keep:
        return list(results)
    origins = {result.take.id: result for result in results}
    return [_whole(result, origins[result.take.origin.id], groups.members) for result in results]


def _whole(result: Result, origin: Result, members: Mapping[str, Sequence[str]]) -> Result:
    stored = {origin.take.dancers[k].id for k in origin.stay}
    lacking = [member for member in members.get(origin.take.group, ()) if member not in stored]
    if not lacking or not result.stay:
        return result
    detail = f"group {origin.take.group} is incomplete without {listed(lacking)}"
    fix = "correct the files of the dancers that were left out, or store the others: --set groups.incomplete=keep"
    dancers = [origin.take.dancers[k] for k in origin.stay if origin is result]
    rejects = [Reject("incomplete_group", d.id, str(d.ref.motion_path), detail=detail, fix=fix) for d in dancers]
    return result.left_out(rejects)
