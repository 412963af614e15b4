"""The windows of takes: within all fields, from lengths alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dancedata.building.plugins import Field, Reach
from dancedata.building.result import Result
from dancedata.building.take import Take
from dancedata.core.clip import Reject
from dancedata.core.grid import WindowSpec


def cut_windows(takes: Sequence[Take], fields: Sequence[Field], windows: WindowSpec) -> list[Result]:
    """Return the windows that all fields of takes cover, from lengths alone; parents come before their copies."""
    results: dict[tuple[str, str], Result] = {}
    for take in takes:
        of_parent = None if take.parent is None else results[take.parent.id].starts
        if of_parent is not None and (not of_parent or take.steps[-1].keeps_time):
            stay = tuple(range(len(take.dancers))) if of_parent else ()
            results[take.id] = Result(take, of_parent, stay)
        else:
            results[take.id] = _cut(take, fields, windows)
    return list(results.values())


def _cut(take: Take, fields: Sequence[Field], windows: WindowSpec) -> Result:
    grid, n_frames = windows.grid, take.time.frames_on(windows.grid)
    covered = {k: [f.reach(take, k, grid) for f in fields] for k in range(len(take.dancers))}
    result = Result(take, stay=tuple(covered))
    result = result.without({k: [r for r in of if isinstance(r, Reject)] for k, of in covered.items()})
    reaches = [(k, r) for k in result.stay for r in covered[k] if isinstance(r, Reach)]
    starts = [*windows.starts(windows.count(n_frames))]
    outside = {start: _beyond(reaches, start, start + windows.length) for start in starts}
    beyond = {start: of for start, of in outside.items() if of is not None}
    kept = tuple(start for start in starts if start not in beyond)
    if not kept:
        whose, reach = next(iter(beyond.values()), (0, _of_motion(take)))
        return result.left_out([_without_windows(take, k, whose, reach, windows) for k in result.stay])
    rejects = [_of_window(take, k, reaches, start, windows) for start in beyond for k in result.stay]
    stay = result.stay
    return replace(result, starts=kept if stay else (), rejects=(*result.rejects, *rejects))


def _beyond(reaches: Sequence[tuple[int, Reach]], start: int, stop: int) -> tuple[int, Reach] | None:
    """Return the first reach that does not cover a window, and whose it is."""
    return next(((k, r) for k, r in reaches if start < r.first or stop > r.end), None)


def _of_window(
    take: Take, dancer: int, reaches: Sequence[tuple[int, Reach]], start: int, windows: WindowSpec
) -> Reject:
    """Return the reject of a dancer's window that his rows, or else a partner's, do not cover."""
    his_first = sorted(reaches, key=lambda reach: reach[0] != dancer)
    of, reach = _beyond(his_first, start, start + windows.length) or his_first[0]
    partner = "" if of == dancer else f" (of partner {take.dancers[of].id})"
    detail = f"window {windows.number(start)} {reach.beyond}{partner}"
    return Reject(reach.window, take.dancers[dancer].id, "", start, detail, reach.numbers)


def _without_windows(take: Take, dancer: int, of: int, reach: Reach, windows: WindowSpec) -> Reject:
    member = take.dancers[dancer]
    of_motion = _of_motion(take)
    short, numbers = reach.short or of_motion.short, reach.numbers or of_motion.numbers
    partner = "" if of == dancer or not reach.short else f" (of partner {take.dancers[of].id})"
    detail = f"clip {member.id}: {short}{partner}; a window is {windows.length_s:g} s"
    return Reject(reach.clip, member.id, reach.file or str(member.ref.motion_path), detail=detail, numbers=numbers)


def _of_motion(take: Take) -> Reach:
    """Return the reach of motion that is shorter than a window."""
    time = take.time
    short = f"the clip is shorter than a window: {time.n_frames} frames at {time.grid} per second"
    short += f" ({float(time.seconds):.2f} s)"
    return Reach(0, 0, short=short, numbers={"motion_s": round(float(time.seconds), 3)})
