"""Differences between recipes, and between sources, clip by clip: why a dataset is not the one that is asked for."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from dancedata.building.source_record import ABOUT, DIGITS, SourceRecord
from dancedata.core.errors import StoreError
from dancedata.core.hashing import document_differences, hashed_keys, recipe_hash
from dancedata.core.text import counted, listed, shown
from dancedata.recipes.recipe import Recipe
from dancedata.store import open_store

_SHOWN, _MESSAGE = 5, 600


def require_same(out: Path, recipe: Recipe, source_sha256: str, record: SourceRecord) -> None:
    """Raise StoreError with the differences if `out` was built from another recipe or source."""
    with open_store(out) as store:
        stored = store.info.get("recipe", {})
        if recipe_hash(stored) != recipe.sha256:
            differences = [
                f"{shown(key)}: {shown(json.dumps(a))} there, {shown(json.dumps(b))} now"
                for key, a, b in document_differences(hashed_keys(stored), hashed_keys(recipe.document))
            ]
            raise StoreError("this folder holds a dataset built from a different recipe", where=out,
                             found=_differences_text(differences),
                             fix="choose another --out, or --overwrite to replace it")  # fmt: skip
        if store.info.get("source", {}).get("sha256") != source_sha256:
            of_sources = source_differences(SourceRecord.of_store(store), record, "there", "now")
            raise StoreError("the dataset there was made from another source", where=out,
                             found=_differences_text(of_sources),
                             fix="choose another --out, or --overwrite to rebuild (unchanged units come from the "
                             "cache)")  # fmt: skip


def _differences_text(differences: Sequence[object]) -> str:
    lines = "\n".join(f"  - {difference}" for difference in differences) or "  - (another version of dancedata)"
    return f"these differences:\n{lines}\n"


class SourceDifference(NamedTuple):
    """A difference between two sources, with its files or clips."""

    message: str
    names: tuple[str, ...]

    def __str__(self) -> str:
        names = f": {listed(self.names, _SHOWN)}" if self.names else ""
        return shown(self.message, _MESSAGE) + names


def source_differences(
    old: SourceRecord, new: SourceRecord, then: str, now: str, *, about: bool = True
) -> list[SourceDifference]:
    """Return the differences between two sources, called `then` and `now`; with `about`, those of metadata too."""
    if old.clips is None or new.clips is None:
        return [SourceDifference("which files differ is not recorded in the dataset", ())]
    common = [clip for clip in old.clips if clip in new.clips]
    differences = _changed_files(old, new, common)
    differences += _changed_about(old, new, common, then, now) if about else []
    differences += _moved(old, new, then, now)
    differences += _spare_files(old, new, then, now)
    content = sorted(key for key in {*old.content, *new.content} if old.content.get(key) != new.content.get(key))
    return [*differences, *([SourceDifference("different content", tuple(content))] if content else [])]


def _changed_files(old: SourceRecord, new: SourceRecord, common: Sequence[str]) -> list[SourceDifference]:
    """Return the changed files, or their clips if files are not recorded."""
    differences = []
    for place, what in enumerate(("motion", "music")):
        clips = [clip for clip in common if _part(old, clip, place) != _part(new, clip, place)]
        files = dict.fromkeys(new.files[clip][place] or clip if clip in new.files else clip for clip in clips)
        if clips:
            differences.append(SourceDifference(f"different {what} in {counted(len(clips), 'clip')}", tuple(files)))
    return differences


def _changed_about(
    old: SourceRecord, new: SourceRecord, common: Sequence[str], then: str, now: str
) -> list[SourceDifference]:
    changed = [clip for clip in common if _part(old, clip, 2) != _part(new, clip, 2)]
    by_key: dict[str, list[str]] = {}
    for clip in changed:
        before, after = old.about.get(clip, {}), new.about.get(clip, {})
        keys = [key for key in ABOUT if key in before and key in after and before[key] != after[key]]
        for key in keys or ["what is declared"]:
            by_key.setdefault(key, []).append(clip)
    differences = []
    for key, clips in by_key.items():
        first = clips[0]
        values = f", e.g. {old.about[first][key]!r} {then}, {new.about[first][key]!r} {now}" if key in ABOUT else ""
        differences.append(SourceDifference(f"{key} of {counted(len(clips), 'clip')}{values}", tuple(clips)))
    return differences


def _moved(old: SourceRecord, new: SourceRecord, then: str, now: str) -> list[SourceDifference]:
    """Return clips that were built from one source, and left out of the other or not in it."""
    states = _states(old), _states(new)
    groups: dict[tuple[str, str], list[str]] = {}
    for clip in sorted({*states[0], *states[1]}):
        pair = states[0].get(clip, "absent"), states[1].get(clip, "absent")
        if pair[0] != pair[1]:
            groups.setdefault(pair, []).append(clip)
    return [
        SourceDifference(f"{counted(len(clips), 'clip')} {pair[0]} {then}, {pair[1]} {now}", tuple(clips))
        for pair, clips in sorted(groups.items())
    ]


def _states(record: SourceRecord) -> dict[str, str]:
    left_out = {r.clip: f"left out ({r.reason})" for r in record.left_out if r.clip and r.window is None}
    return left_out | dict.fromkeys(record.clips or {}, "used")


def _spare_files(old: SourceRecord, new: SourceRecord, then: str, now: str) -> list[SourceDifference]:
    """Return files of no clip, such as unused music, that only one of the sources has."""
    # By name: their folders affect nothing.
    spare = [{(r.reason, Path(r.file).name) for r in record.left_out if not r.clip} for record in (old, new)]
    differences = []
    for side, other, when in ((spare[0], spare[1], then), (spare[1], spare[0], now)):
        for reason in sorted({reason for reason, _ in side - other}):
            names = sorted(name for r, name in side - other if r == reason)
            differences.append(SourceDifference(f"{reason}, only {when}", tuple(names)))
    return differences


def _part(record: SourceRecord, clip: str, place: int) -> str:
    return (record.clips or {})[clip][place * DIGITS : (place + 1) * DIGITS]
