"""Hashes of the source of each clip, kept with the dataset, so that changes can be described (`differences`)."""

from __future__ import annotations

import os
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dancedata.building.sources import Sources
from dancedata.core.clip import ClipRef, Reject
from dancedata.store import Store

#: Digits of a hash that are kept: another file has the same digits once in 2.8e14 cases.
DIGITS = 12
#: No record is kept of more clips left out than this: dataset.json has to stay small enough to be read.
MAX_CLIPS = 200_000
#: Attributes of a clip that are compared, in addition to the hashes of its files.
ABOUT = ("split", "music", "tempo_bpm", "genre", "dancer", "lists")


@dataclass(frozen=True)
class SourceRecord:
    """A source as a build identified it, before motion was read."""

    clips: Mapping[str, str] | None  # beginnings of hashes by clip; None where unknown
    left_out: Sequence[Reject] = ()
    content: Mapping[str, str] = field(default_factory=dict)  # hashes of files that parameters name
    about: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # metadata of clips
    files: Mapping[str, tuple[str, str]] = field(default_factory=dict)  # motion and music, relative to the source

    @classmethod
    def of_source(cls, sources: Sources, source: Path) -> SourceRecord:
        """Return the record of identified sources."""
        refs = [clip.ref for clip in sources.clips]
        return cls(
            clips={clip.ref.id: clip.made_of for clip in sources.clips},
            left_out=sources.rejects,
            content=sources.named_files,
            about={ref.id: {name: getattr(ref, name) for name in ABOUT} for ref in refs},
            files={ref.id: _files(ref, source) for ref in refs},
        )

    @classmethod
    def of_store(cls, store: Store) -> SourceRecord:
        """Return the record of a built dataset."""
        unstored = store.info.get("source", {}).get("clips", {})
        clips = {**unstored, **{clip.original: clip.made_of for clip in store if clip.made_of}}
        content = store.info.get("source", {}).get("content")
        return cls(
            clips=clips if clips and all(len(value) == 3 * DIGITS for value in clips.values()) else None,
            left_out=[Reject.from_json(row) for row in store.rejects],
            content=content if isinstance(content, Mapping) else {},
            about={c.original: {name: getattr(c, name) for name in ABOUT} for c in store if not c.source},
        )

    def to_json(self, stored: Container[str]) -> dict[str, str]:
        """Return the hashes of clips that are not stored, for dataset.json; nothing for more than MAX_CLIPS."""
        clips = {clip: value for clip, value in sorted((self.clips or {}).items()) if clip not in stored}
        return clips if len(clips) <= MAX_CLIPS else {}


def _files(ref: ClipRef, source: Path) -> tuple[str, str]:
    motion, music = (str(path or "").removeprefix(f"{source}{os.sep}") for path in (ref.motion_path, ref.audio_path))
    return motion, music
