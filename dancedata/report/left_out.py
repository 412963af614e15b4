"""What was left out, what was flagged, and which clips to look at first."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

from dancedata.report.measure import Measured
from dancedata.store import Store

#: Reasons for looking at a clip, in the order in which their lists take turns, and the value above which they hold.
_WHY = {"flags": 0.0, "sliding": 0.05, "still": 0.3}


def left_out(rejects: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return number, names and first detail for each reason, those with most clips first."""
    by_reason: dict[str, list[Mapping[str, Any]]] = {}
    for reject in rejects:
        by_reason.setdefault(str(reject["reason"]), []).append(reject)
    ordered = sorted(by_reason, key=lambda reason: (-len(by_reason[reason]), reason))
    return {reason: _reason(by_reason[reason]) for reason in ordered}


def _reason(rejects: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    names = list(dict.fromkeys(str(r.get("clip") or r.get("file", "")) for r in rejects))
    details = [str(r["detail"]) for r in rejects if r.get("detail")]
    return {"n": len(rejects), "names": names, "detail": details[0] if details else ""}


def flags(store: Store) -> dict[str, Any]:
    """Return the numbers of quality flags by kind and by joint."""
    kinds, joints = Counter[str](), Counter[str]()
    for flag in store.quality:
        kinds[str(flag.get("kind", "unknown"))] += 1
        joints[str(flag.get("joint", "whole clip"))] += 1
    return {"by_kind": dict(sorted(kinds.items())), "by_joint": dict(sorted(joints.items(), key=_most_first))}


def _most_first(item: tuple[str, int]) -> tuple[int, str]:
    return -item[1], item[0]


def ranking(measured: Measured) -> list[dict[str, Any]]:
    """Return the clips to look at first.

    Three lists take turns: flags per second (above 0), share of the frames of feet in contact that slide (above 5 %),
    share of frames that stand still (above 30 %); the largest come first. A clip comes once, where it comes first.
    """
    lists = [_ordered(measured, why) for why in _WHY]
    rows: dict[str, dict[str, Any]] = {}
    for turn in zip_longest(*lists):
        for why, entry in zip(_WHY, turn, strict=True):
            if entry is not None:
                value, clip = entry
                rows.setdefault(clip, {"clip": clip, "why": why, "value": value})
    return list(rows.values())


def _ordered(measured: Measured, why: str) -> list[tuple[float, str]]:
    values = []
    for clip in measured.store.clips:
        if clip.source:
            continue
        numbers = measured.clips[clip.id]
        of_frames = clip.n_flags / float(measured.store.grid.seconds(clip.n_frames))
        value = of_frames if why == "flags" else getattr(numbers, why)
        if value is not None and value > _WHY[why]:
            values.append((float(value), clip.id))
    return sorted(values, key=lambda entry: (-entry[0], entry[1]))


def spread(document: Mapping[str, Any], n: int) -> list[str]:
    """Return up to `n` clips to show: half of them the first of the ranking, the others spread over the genres."""
    first = [row["clip"] for row in document["ranking"][: (n + 1) // 2]]
    by_genre: dict[str, list[str]] = {}
    for row in document["clips"]:
        if row["clip"] not in first:
            by_genre.setdefault(row["genre"], []).append(row["clip"])
    turns = zip_longest(*(by_genre[genre] for genre in sorted(by_genre)))
    others = [clip for turn in turns for clip in turn if clip is not None]
    return [*first, *others][:n]
