"""Clips whose unit, sides or up axis are probably wrong: the lines of a summary, and the errors of strict builds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from dancedata.core.clip import Reject
from dancedata.core.errors import DataError
from dancedata.core.quality import IMPLAUSIBLE, OF_CLIPS, PLAUSIBLE_BODY_M, PLAUSIBLE_ROOT
from dancedata.core.text import counted

_NAMED = 3
_UNIT = ("an implausible unit", "correct the unit that was declared")
_SIDES = ("left and right in question", "correct the names of its joints, joint_map, or what mirrored it")
_UP = ("an implausible up axis", "correct the up axis that was declared")
#: What is said of clips with a flag of a kind, and what to do.
_CURES = {
    "implausible_body": _UNIT,
    "implausible_root": _UNIT,
    "implausible_sides": _SIDES,
    "implausible_legs": _SIDES,
    "implausible_arms": _SIDES,
    "implausible_elbows": _SIDES,
    "implausible_up": _UP,
    "crossed_legs": ("crossed legs", "look at it in the viewer: left and right of the legs may be swapped"),
    "stretched_bone": ("bones that stretch", "export with fixed bone lengths (rotations only) for exact positions"),
}


def implausible_problems(quality: Iterable[Mapping[str, Any]]) -> list[Reject]:
    """Return one problem for each row of quality.jsonl that concerns a whole clip; `reason` is the row's kind."""
    rows = [row for row in quality if row.get("kind") in OF_CLIPS and isinstance(row.get("value"), int | float)]
    return [Reject(str(row["kind"]), clip=str(row.get("clip", "")), detail=_found(row)) for row in rows]


def _found(row: Mapping[str, Any]) -> str:
    value, (low, high), (least, most) = float(row["value"]), PLAUSIBLE_BODY_M, PLAUSIBLE_ROOT
    return {
        "implausible_body": f"a skeleton of {value:.3g} m, where {low:g} to {high:g} m is plausible; its unit is "
        "probably wrong",
        "implausible_root": f"the root rises and falls {value:.3g} times as far as the pose asks for, where "
        f"{least:g} to {most:g} is plausible; the unit of its translation is probably wrong",
        "implausible_sides": f"toes or knees point against the front of hips and shoulders (cosine {value:.2f}); "
        "left and right are swapped, or the motion is mirrored",
        "implausible_legs": f"toes or knees point against the front of the hips (cosine {value:.2f}), not of the "
        "shoulders; left and right of the legs are swapped",
        "implausible_arms": f"the shoulders' left is the hips' right (cosine {value:.2f}); left and right of the "
        "arms are swapped",
        "implausible_elbows": f"the elbows bend backwards ({value:.2f}, where 0.4 to 0.9 is usual); left and right "
        "of the arms or of the whole motion are swapped, or it is mirrored",
        "implausible_up": f"the body does not stand along +Y (cosine {value:.2f}), and the floor lies along another "
        "axis; the up axis is probably wrong",
        "crossed_legs": f"the left ankle is {value:.2f} widths of the hips to the left of the right one, where 0.6 "
        "to 4 is usual",
        "stretched_bone": f"position channels stretch bones by up to {100 * value:.1f} cm; the motion's bones are "
        "rigid, with their median length",
    }[row["kind"]]


def describe_implausible(quality: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a summary: how many clips, and the first of them, by what there is to do."""
    groups: dict[tuple[str, str], list[Reject]] = {}
    for problem in implausible_problems(quality):
        groups.setdefault(_CURES[problem.reason], []).append(problem)
    lines = []
    for (what, cure), problems in groups.items():
        clips, more = counted(len({p.clip for p in problems}), "clip"), len(problems) - _NAMED
        lines.append(f"  {'implausible' if what == _UNIT[0] else what}: {clips}; {cure}:")
        lines += [f"    {p.clip}: {p.reason}: {p.detail}" for p in problems[:_NAMED]]
        lines += [f"    ... {more} more"] if more > 0 else []
    return lines


def stop_if_implausible(strict: bool, quality: Sequence[Mapping[str, Any]]) -> None:
    """Raise DataError for the first clip that is implausible, if the build is strict."""
    problems = [p for p in implausible_problems(quality) if p.reason in IMPLAUSIBLE]
    if strict and problems:
        first = problems[0]
        what, cure = _CURES[first.reason]
        clips = counted(len({p.clip for p in problems if _CURES[p.reason][0] == what}), "clip")
        raise DataError(
            f"{clips} with {what} in a strict build, the first: {first.detail}",
            reason=first.reason,
            where=first.clip,
            fix=f"{cure}, or build without --strict to keep the clip, with a flag",
        )
