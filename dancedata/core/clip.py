"""Clips, windows, rejects, and the result of a dataset reader's scan."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

from dancedata.core.errors import StoreError
from dancedata.core.segments import Segment
from dancedata.core.text import counted, quoted, shown

T = TypeVar("T")

#: The order in which splits are listed; others follow by name.
SPLIT_ORDER = ("train", "val", "test")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*\Z")
#: A value of a free column.
ColumnValue = str | int | float | bool | tuple[str, ...] | tuple[int, ...] | tuple[float, ...]
#: `ClipRef.audio_start_by` where a build finds the offset.
FOUND = "auto"
#: Most characters of the texts of a reject: of names, of paths, and of sentences.
_MAX_NAME, _MAX_PATH, _MAX_DETAIL = 300, 4400, 3000
_LIMITS = {
    **dict.fromkeys(("reason", "clip", "music"), _MAX_NAME),
    "file": _MAX_PATH,
    **dict.fromkeys(("detail", "fix"), _MAX_DETAIL),
}


@dataclass(frozen=True)
class ClipRef:
    """A clip on disk, not loaded.

    Attributes
    ----------
    split
        "train", "val", "test", or "all" where the dataset is not split.
    tempo_bpm
        Tempo from the dataset in beats per minute; None if unknown.
    lists
        Lists of the dataset (such as split files) that contain the clip.
    notes
        Remarks of the scan on this clip, which its own notes sum up.
    declared
        Declarations of the source about this file: (name, value), such as ("fps", "120") from a manifest. They are
        input of `load`, and part of the cache key.
    body
        Name of the body that the motion is on, where files differ and the scan can tell; "" if unknown.
    group
        Name of the sequence whose dancers move in one world; "" for a single dancer.
    member
        Number of the dancer in the group's source, from 0; -1 for a single dancer.
    group_size
        Dancers of the group in its source, where the scan lists fewer; 0: those that it lists.
    role
        Part of the dancer in the group, such as "leader" or "follower"; "" if there is none.
    keys
        What a rule of splits can keep together: (name, value), such as ("video", "-Ab_cdEf123").
    columns
        Further facts for the table of clips: (name, value), where all values of a name have one type.
    audio_start
        Second of the audio file at frame 0, exact; negative where the music begins later.
    audio_start_by
        "" where it is stated; `FOUND` where it is the stated part of what a build finds; then how it was found.
    source_start, source_end
        Part of the motion file that is the clip, seconds; None: from the beginning, to the end.
    licence, citation
        Terms of this clip, where clips of the source have different ones; "" for those of the dataset.
    segments
        Spans and instants of the clip that the source states.
    feature_paths
        File of each audio field whose rows come from files: (field, path). A build fills it in from the recipe.
    revision
        Raised for clips that their reader reads in another way than an earlier version did; part of the cache key.
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
    body: str = ""
    group: str = ""
    member: int = -1
    group_size: int = 0
    role: str = ""
    keys: tuple[tuple[str, str], ...] = ()
    columns: tuple[tuple[str, ColumnValue], ...] = ()
    audio_start: Fraction = Fraction(0)
    audio_start_by: str = ""
    source_start: Fraction | None = None
    source_end: Fraction | None = None
    licence: str = ""
    citation: str = ""
    segments: tuple[Segment, ...] = field(default=(), compare=False, repr=False)
    feature_paths: tuple[tuple[str, Path], ...] = ()
    revision: int = 0


def member_id(group: str, member: int) -> str:
    """Return the id of a group's dancer where the source names none: ``<group>_p<member>``."""
    return f"{group}_p{member}"


@dataclass(frozen=True)
class Window:
    """A piece of a clip: `length` frames from frame `start`, at the store's frame rate."""

    clip: str
    start: int
    length: int


@dataclass(frozen=True)
class Reject:
    """Something that was left out of a build, and the reason.

    Its texts come from file names and untrusted files. They are truncated, and characters that do not print become
    backslash sequences, so that they can be printed and stored.

    Attributes
    ----------
    reason
        Code: "ignored", "missing_music", "nan", ...
    window
        First frame of the window, if only a window was left out.
    numbers
        Measured values.
    music
        The missing song, if one is missing; several clips can share it.
    fix
        Remedy, if known.
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
        for name, limit in _LIMITS.items():
            object.__setattr__(self, name, shown(getattr(self, name), limit))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data, without empty entries."""
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
        """Read the result of `to_json`; unknown keys are ignored."""
        texts = {name: str(row.get(name, "")) for name in ("clip", "file", "detail", "music", "fix")}
        return cls(str(row.get("reason", "")), window=row.get("window"), numbers=row.get("numbers", {}), **texts)


@dataclass(frozen=True)
class Scan:
    """The result of a dataset reader's scan of a source folder.

    Attributes
    ----------
    layout
        Name of the recognised layout.
    clips
        Sorted by id.
    rejects
        Files that were found but left out, and missing ones, by name.
    notes
        Sentences for the user: what was recognised and assumed. They are safe to print and store, as in a `Reject`.
    genre_ids
        Number of each genre, where this source states them, and not its dataset.
    """

    layout: str
    clips: tuple[ClipRef, ...]
    rejects: tuple[Reject, ...] = ()
    notes: tuple[str, ...] = ()
    genre_ids: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "notes", tuple(shown(note, _MAX_DETAIL) for note in self.notes))

    def __repr__(self) -> str:
        counts = f"{len(self.clips)} clips, {len(self.rejects)} rejects, {len(self.notes)} notes"
        return f"Scan(layout={self.layout!r}, {counts})"


def is_name(name: object) -> bool:
    """Return whether a text can be part of a file name and of an HDF5 path."""
    return isinstance(name, str) and _NAME.match(name) is not None


def check_name(name: str, what: str) -> None:
    """Raise StoreError unless `is_name`."""
    if not is_name(name):
        raise StoreError(f"not a valid name for a {what}", found=quoted(name),
                         allowed="ASCII letters, digits and _ . + -, beginning with a letter or digit")  # fmt: skip


def slice_name(clip: str, index: int) -> str:
    """Return the name of a window in EDGE's files, and the id of a slice."""
    return f"{clip}_slice{index}"


def union_find(groups: Iterable[Iterable[T]]) -> list[set[T]]:
    """Join groups that share a member; scipy's DisjointSet takes half a second to import."""
    joined: dict[T, set[T]] = {}
    for group in groups:
        members = set(group)
        members.update(*(joined[member] for member in members & joined.keys()))
        joined |= dict.fromkeys(members, members)
    return list({id(members): members for members in joined.values()}.values())


@dataclass(frozen=True)
class FreeColumn:
    """One free column, over the clips that are not copies."""

    name: str  # with the prefix, "x/level"
    type: str
    clips: int  # with a value
    of: int  # all clips
    least: float | None  # of numbers, also of those in lists
    middle: float | None  # their median
    most: float | None
    values: dict[str, int]  # of others: number of clips by the most frequent
    distinct: int  # number of different values, or entries of lists

    def __str__(self) -> str:
        held = f"{self.name}: {self.type}, {self.clips:,} of {counted(self.of, 'clip')}"
        if self.least is not None:
            return f"{held}, {self.least:g} to {self.most:g}, median {self.middle:g}"
        listed = ", ".join(f"{shown(value, 60)}: {n:,}" for value, n in self.values.items())
        more = f", {self.distinct - len(self.values):,} more" if self.distinct > len(self.values) else ""
        return f"{held}{': ' * bool(listed)}{listed}{more}"
