"""The windows of takes that the rules keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dancedata.building.plugins import Annotator, Field, Seen, WindowRule
from dancedata.building.result import Result
from dancedata.building.segments import all_segments
from dancedata.core.clip import Reject
from dancedata.core.errors import UsageError, error_note
from dancedata.core.grid import WindowSpec
from dancedata.core.text import listed


def judged(
    results: Sequence[Result],
    rules: Sequence[WindowRule],
    fields: Sequence[Field],
    annotators: Sequence[Annotator],
    windows: WindowSpec,
) -> list[Result]:
    """Return what the rules leave of windows and dancers. A copy has what its parent has, if it keeps the time."""
    done: dict[tuple[str, str], Result] = {}
    computed = {result.take.id: result for result in results}
    for result in results:
        take = result.take
        parent = None if take.parent is None else done[take.parent.id]
        if parent is not None:
            stay = tuple(k for k in result.stay if k in parent.stay)
            rejects = result.rejects if parent.stay else ()  # those of its parent are enough
            result = replace(result, starts=result.starts if stay else (), stay=stay, rejects=rejects)
        if parent is not None and take.steps[-1].keeps_time:
            result = replace(result, starts=parent.starts if result.stay else ())
        elif rules and result.starts:
            of_parent = None if take.parent is None else computed[take.parent.id]
            segments = all_segments(computed[take.id], annotators, of_parent, windows.grid)
            for rule in rules:
                result = _judged(result, rule, Seen(result, fields, windows.grid, windows.length, segments))
        done[take.id] = result
    return list(done.values())


def _judged(result: Result, rule: WindowRule, seen: Seen) -> Result:
    with error_note(f"dancedata: while the rule {rule.name} judged clip {result.take.name}"):
        rejects = {k: [*rule.judge(seen, k, result.starts)] for k in result.stay}
    unknown = {r.window for of in rejects.values() for r in of if r.window is not None} - {*result.starts}
    if unknown:
        raise UsageError(f"the rule {rule.name} names windows that do not exist", where=f"clip {result.take.name}",
                         found=listed(map(str, sorted(unknown)), 5), allowed="first frames, as judge is given them",
                         fix="correct the plug-in")  # fmt: skip
    result = result.without({k: [r for r in of if r.window is None] for k, of in rejects.items()})
    dancers = result.take.dancers
    of_windows = {k: {r.window: r for r in rejects[k] if r.window is not None} for k in result.stay}
    together = set.union if rule.of_group == "any" else set.intersection
    gone = together(*map(set, of_windows.values())) if of_windows else set()
    if not gone:
        return result
    lost = [
        _of_dancer(of_windows, k, start, [dancer.id for dancer in dancers]) for k in result.stay for start in gone
    ]
    starts = tuple(start for start in result.starts if start not in gone)
    if starts:
        return replace(result, starts=starts, rejects=(*result.rejects, *lost))
    is_one = len(gone) == 1 and any(step.is_part for step in result.take.steps)  # a slice, which is told once
    files = {dancer.id: str(dancer.ref.motion_path) for dancer in dancers}
    of_clips = {reject.clip: _of_all(reject, files[reject.clip], gone) for reject in reversed(lost)}
    return result.left_out([*(() if is_one else lost), *(of_clips[dancers[k].id] for k in result.stay)])


def _of_dancer(of_windows: dict[int, dict[int, Reject]], dancer: int, start: int, ids: Sequence[str]) -> Reject:
    """Return the reject of a dancer's window: that of a partner where he has none of his own."""
    if start in of_windows[dancer]:
        return replace(of_windows[dancer][start], clip=ids[dancer])
    partner = next(k for k, of in of_windows.items() if start in of)
    reject = of_windows[partner][start]
    return replace(reject, clip=ids[dancer], detail=f"of partner {ids[partner]}: {reject.detail}")


def _of_all(reject: Reject, file: str, gone: set[int]) -> Reject:
    """Return the reject of a dancer who loses all windows, made from the reject of one of them."""
    none = f"none of the {len(gone)} windows of clip {reject.clip} is left: " if len(gone) > 1 else ""
    return replace(reject, window=None, file=file, detail=f"{none}{reject.detail}")
