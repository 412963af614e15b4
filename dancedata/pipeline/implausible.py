"""Clips whose unit is probably wrong: the lines of a summary, and the errors of strict builds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from dancedata.core.clip import Reject
from dancedata.core.errors import DataError
from dancedata.core.quality import IMPLAUSIBLE, PLAUSIBLE_BODY_M, PLAUSIBLE_ROOT
from dancedata.core.text import counted

_NAMED = 3


def implausible_problems(quality: Iterable[Mapping[str, Any]]) -> list[Reject]:
    """Return one problem for each row of quality.jsonl that concerns a unit; `reason` is the row's kind."""
    rows = [row for row in quality if row.get("kind") in IMPLAUSIBLE and isinstance(row.get("value"), int | float)]
    return [Reject(str(row["kind"]), clip=str(row.get("clip", "")), detail=_found(row)) for row in rows]


def _found(row: Mapping[str, Any]) -> str:
    value = float(row["value"])
    if row["kind"] == "implausible_body":
        low, high = PLAUSIBLE_BODY_M
        return f"a skeleton of {value:.3g} m, where {low:g} to {high:g} m is plausible; its unit is probably wrong"
    low, high = PLAUSIBLE_ROOT
    return (
        f"the root rises and falls {value:.3g} times as far as the pose asks for, where {low:g} to {high:g} is "
        "plausible; the unit of its translation is probably wrong"
    )


def describe_implausible(quality: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a summary: how many clips, and the first of them."""
    problems = implausible_problems(quality)
    if not problems:
        return []
    clips = counted(len({p.clip for p in problems}), "clip")
    lines = [f"  implausible: {clips}; correct the unit that was declared:"]
    lines += [f"    {p.clip}: {p.reason}: {p.detail}" for p in problems[:_NAMED]]
    more = len(problems) - _NAMED
    return [*lines, f"    ... {more} more"] if more > 0 else lines


def stop_if_implausible(strict: bool, quality: Sequence[Mapping[str, Any]]) -> None:
    """Raise DataError for the first clip with an implausible unit, if the build is strict."""
    problems = implausible_problems(quality)
    if strict and problems:
        first, clips = problems[0], counted(len({p.clip for p in problems}), "clip")
        raise DataError(
            f"{clips} with an implausible unit in a strict build, the first: {first.detail}",
            reason=first.reason,
            where=first.clip,
            fix="correct the unit that was declared, or build without --strict to keep the clip, with a flag",
        )
