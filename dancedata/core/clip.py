"""Clips, windows, and what a dataset reader says of a source folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dancedata.core.motion import Motion
from dancedata.core.text import shown

#: Characters that are kept of what is said of a file: of a name, of a path, and in words.
_MAX_NAME, _MAX_PATH, _MAX_DETAIL = 300, 4400, 3000
_LIMITS = {
    **dict.fromkeys(("reason", "clip", "music"), _MAX_NAME),
    "file": _MAX_PATH,
    **dict.fromkeys(("detail", "fix"), _MAX_DETAIL),
}


@dataclass(frozen=True)
class ClipRef:
    """A clip as it was found on disk, not loaded.

    Attributes
    ----------
    split
        "train", "val", "test", or "all" where the dataset is not split.
    tempo_bpm
        Tempo as the dataset states it, beats a minute; None where it does not.
    lists
        Lists of the dataset (split files, say) that name the clip.
    declared
        What the source says of how this file is to be read, apart from the dataset's parameters: (name, value),
        such as ("fps", "120") from a manifest. It is for `load`, and part of the cache key.
    music_fix
        Where there is no `audio_path`: what to do about it, such as which file to rename; "" if nothing is known.
    """

    id: str
    motion_path: Path
    audio_path: Path | None
    split: str
    music: str = ""
    tempo_bpm: float | None = None
    genre: str = ""
    dancer: str = ""
    lists: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    declared: tuple[tuple[str, str], ...] = ()
    music_fix: str = ""


@dataclass(frozen=True, eq=False)
class Clip:
    """A clip in canonical form; see `ClipRef` for the attributes and `Motion` for units and axes."""

    id: str
    motion: Motion
    music: str = ""
    tempo_bpm: float | None = None
    genre: str = ""
    dancer: str = ""
    split: str = ""
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, ref: ClipRef, motion: Motion) -> Clip:
        """Join what was found on disk and what was loaded."""
        return cls(ref.id, motion, ref.music, ref.tempo_bpm, ref.genre, ref.dancer, ref.split, ref.notes)


@dataclass(frozen=True)
class Window:
    """A piece of a clip: `length` frames from frame `start`, at the store's frame rate."""

    clip: str
    start: int
    length: int


@dataclass(frozen=True)
class Reject:
    """Something that was left out of a build, and why.

    Its texts come from file names and files of others. They are cut, and what does not print is written as backslash
    sequences: they can be printed and stored, whatever they were.

    Attributes
    ----------
    reason
        Code to count by: "ignored", "missing_music", "nan", ...
    window
        First frame of the window, where only a window was left out.
    numbers
        What was measured.
    music
        The song that is missing, where one is: clips are many, songs are few.
    fix
        What to do about it, where that is known.
    """

    reason: str
    clip: str = ""
    file: str = ""
    window: int | None = None
    detail: str = ""
    numbers: Mapping[str, float | int] = field(default_factory=dict)
    music: str = ""
    fix: str = ""

    def __post_init__(self) -> None:
        """Make the texts fit to be printed and stored."""
        for name, limit in _LIMITS.items():
            object.__setattr__(self, name, shown(getattr(self, name), limit))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data, without what is empty."""
        row: dict[str, Any] = {"reason": self.reason}
        for name in ("clip", "file", "window", "detail", "music", "fix"):
            value = getattr(self, name)
            if value not in ("", None):
                row[name] = value
        if self.numbers:
            row["numbers"] = dict(self.numbers)
        return row

    @classmethod
    def from_json(cls, row: Mapping[str, Any]) -> Reject:
        """Read what `to_json` gave; keys that this version does not have are passed over."""
        texts = {name: str(row.get(name, "")) for name in ("clip", "file", "detail", "music", "fix")}
        return cls(str(row.get("reason", "")), window=row.get("window"), numbers=row.get("numbers", {}), **texts)


@dataclass(frozen=True)
class Scan:
    """What a dataset reader found under a source folder.

    Attributes
    ----------
    layout
        Which of the dataset's layouts it is.
    clips
        Sorted by id.
    rejects
        What was found but left out, and what was missing, by name.
    notes
        Sentences for the user: what was recognised, what was assumed. File names in them are made fit to be printed
        and stored, as in a `Reject`.
    """

    layout: str
    clips: tuple[ClipRef, ...]
    rejects: tuple[Reject, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make the notes fit to be printed and stored."""
        object.__setattr__(self, "notes", tuple(shown(note, _MAX_DETAIL) for note in self.notes))

    def __repr__(self) -> str:
        """Show how much was found; `clips`, `rejects` and `notes` say what."""
        counts = f"{len(self.clips)} clips, {len(self.rejects)} rejects, {len(self.notes)} notes"
        return f"Scan(layout={self.layout!r}, {counts})"
