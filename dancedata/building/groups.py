"""Groups are stored whole, or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dancedata.building.result import Result
from dancedata.core.clip import Reject
from dancedata.core.text import listed


def whole(results: Sequence[Result], members: Mapping[str, Sequence[str]], keep: bool) -> list[Result]:
    """Set groups aside that lack a dancer of the source, with their copies; or `keep` the others.

    `members`: Ids of each group's dancers in the source, and a text for those that it does not list.
    """
    roots = {result.take.place: result for result in results}
    return [result if keep else _whole(result, roots[result.take.root.place], members) for result in results]


def _whole(result: Result, root: Result, members: Mapping[str, Sequence[str]]) -> Result:
    stored = {root.take.dancers[k].id for k in root.stay}
    lacking = [member for member in members.get(root.take.group, ()) if member not in stored]
    if not lacking or not result.stay:
        return result
    detail = f"group {root.take.group} is incomplete without {listed(lacking)}"
    fix = "mend the dancers that were left out, or store the others: --set groups.incomplete=keep"
    dancers = [root.take.dancers[k] for k in root.stay if root is result]
    rejects = [Reject("incomplete_group", d.id, str(d.ref.motion_path), detail=detail, fix=fix) for d in dancers]
    return result.left_out(rejects)
