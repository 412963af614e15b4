"""Hashes of the source of each clip, kept with the dataset, so that changes can be described file by file."""

from __future__ import annotations

import os
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from dancedata.building.sources import Sources
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.text import counted, listed, shown
from dancedata.store import Store

#: Digits of a hash that are kept: another file has the same ones once in 2.8e14 times.
DIGITS = 12
#: Of more clips that are left out no record is kept: dataset.json has to stay small enough to be read.
MAX_CLIPS = 200_000
#: Attributes of a clip that are compared, in addition to the hashes of its files.
_ABOUT = ("split", "music", "tempo_bpm", "genre", "dancer", "lists")
_SHOWN, _MESSAGE = 5, 600


@dataclass(frozen=True)
class SourceRecord:
    """A source as a build identified it, before motion was read.

    `clips`: Beginnings of the hashes of motion, music and metadata by clip; None where a dataset does not have them.
    `left_out`: Files and clips that were left out by then.
    `content`: Hashes of files that the dataset's parameters name.
    `about`: Metadata of clips, if recorded.
    `files`: Motion and music file of clips, relative to the source, if recorded.
    """

    clips: Mapping[str, str] | None
    left_out: Sequence[Reject] = ()
    content: Mapping[str, str] = field(default_factory=dict)
    about: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    files: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @classmethod
    def of_source(cls, sources: Sources, source: Path) -> SourceRecord:
        """Return the record of identified sources."""
        refs = [clip.ref for clip in sources.clips]
        return cls(
            clips={clip.ref.id: clip.made_of for clip in sources.clips},
            left_out=sources.rejects,
            content=sources.named_files,
            about={ref.id: {name: getattr(ref, name) for name in _ABOUT} for ref in refs},
            files={ref.id: _files(ref, source) for ref in refs},
        )

    @classmethod
    def of_store(cls, store: Store) -> SourceRecord:
        """Return the record of a built dataset."""
        left_out = store.info.get("source", {}).get("clips", {})
        clips = {**left_out, **{clip.original: clip.made_of for clip in store if clip.made_of}}
        content = store.info.get("source", {}).get("content")
        return cls(
            clips=clips if clips and all(len(value) == 3 * DIGITS for value in clips.values()) else None,
            left_out=[Reject.from_json(row) for row in store.rejects],
            content=content if isinstance(content, Mapping) else {},
            about={c.original: {name: getattr(c, name) for name in _ABOUT} for c in store if not c.source},
        )

    def to_json(self, stored: Container[str]) -> dict[str, str]:
        """Return the hashes of clips that are not stored, for dataset.json; nothing for more than MAX_CLIPS."""
        clips = {clip: value for clip, value in sorted((self.clips or {}).items()) if clip not in stored}
        return clips if len(clips) <= MAX_CLIPS else {}


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
    return [*differences, *([SourceDifference("other content", tuple(content))] if content else [])]


def _files(ref: ClipRef, source: Path) -> tuple[str, str]:
    prefix = f"{source}{os.sep}"
    paths = (ref.motion_path, ref.audio_path)
    return str(paths[0]).removeprefix(prefix), "" if paths[1] is None else str(paths[1]).removeprefix(prefix)


def _changed_files(old: SourceRecord, new: SourceRecord, common: Sequence[str]) -> list[SourceDifference]:
    """Return the changed files, or their clips if files are not recorded."""
    differences = []
    for place, what in enumerate(("motion", "music")):
        clips = [clip for clip in common if _part(old, clip, place) != _part(new, clip, place)]
        files = dict.fromkeys(new.files[clip][place] or clip if clip in new.files else clip for clip in clips)
        if clips:
            differences.append(SourceDifference(f"other {what} of {counted(len(clips), 'clip')}", tuple(files)))
    return differences


def _changed_about(
    old: SourceRecord, new: SourceRecord, common: Sequence[str], then: str, now: str
) -> list[SourceDifference]:
    changed = [clip for clip in common if _part(old, clip, 2) != _part(new, clip, 2)]
    by_key: dict[str, list[str]] = {}
    for clip in changed:
        before, after = old.about.get(clip, {}), new.about.get(clip, {})
        keys = [key for key in _ABOUT if key in before and key in after and before[key] != after[key]]
        for key in keys or ["what is declared"]:
            by_key.setdefault(key, []).append(clip)
    differences = []
    for key, clips in by_key.items():
        first = clips[0]
        values = f", as {old.about[first][key]!r} {then}, {new.about[first][key]!r} {now}" if key in _ABOUT else ""
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
