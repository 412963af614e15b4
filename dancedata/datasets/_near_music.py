"""Music that is missing where it is looked for, and a file that may be it under a slightly different name."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePath

from dancedata.core.errors import SourceError
from dancedata.datasets._source import list_folder, relative

__all__ = ["MUSIC", "NearMusic"]

MUSIC = (".wav", ".flac", ".mp3", ".ogg")  # in order of preference: lossless first
#: What else music comes in; it is not read.
_OTHER = (".aac", ".aif", ".aiff", ".m4a", ".m4b", ".mp4", ".opus", ".webm", ".wma")
#: Letters of two names that have the same numbers in them: mBR0 and mBR5 are two songs, not one misspelt.
_ALIKE = 0.8
#: A shorter name within another one says nothing.
_MIN_PART = 3
#: Unused files that are looked at, files among which misspelt names are looked for, and missing names that are
#: looked up: each is compared with each, and a message shows a few.
_MAX_FILES, _MAX_MISSPELT, _MAX_NAMES = 1_000, 100, 2_000
_PARTS = re.compile(r"[^\W\d_]+|[0-9]+")


class NearMusic:
    """Music files of a source that no clip uses; listed when first asked for.

    Parameters
    ----------
    folders
        Where music is looked for, and what holds those folders; folders directly below are searched as well.
    used
        Files that clips use.
    is_other
        Tells whether a stem is the proper name of something, which it cannot be as a misspelling.
    """

    def __init__(
        self, source: Path, folders: Sequence[Path], used: Collection[Path], is_other: Callable[[str], bool]
    ) -> None:
        self.source, self.folders, self.used, self.is_other = source, folders, used, is_other
        self._names_left = _MAX_NAMES

    def fix(self, *expected: str) -> str:
        """Return what to do about missing music, "" if no file has nearly its name.

        Parameters
        ----------
        expected
            Paths below the source, without suffixes, where it would be found.
        """
        if self._names_left <= 0:
            return ""
        self._names_left -= len(expected)
        misspelt = len(self._files) <= _MAX_MISSPELT
        wanted = {target: _Name.of(PurePath(target).name) for target in expected}
        found = [
            (path.suffix.lower() not in MUSIC, -have.likeness(name), path, target)
            for target, name in wanted.items()
            for path, have, other in self._files
            if have.text == name.text or (not other and have.near(name, misspelt))
        ]
        if not found:
            return ""
        # Of several the one that can be read, then the most similar.
        *_, path, target = min(found)
        suffix, do = path.suffix.lower(), "rename"
        if suffix not in MUSIC:
            suffix, do = MUSIC[0], "convert"
        return f"{do} {relative(path, self.source)} to {target}{suffix}"

    @cached_property
    def _files(self) -> list[tuple[Path, _Name, bool]]:
        places = list(dict.fromkeys(self.folders))
        below = [entry for place in places for entry in _entries(place) if entry.is_dir() and not entry.is_symlink()]
        files: list[Path] = []
        for place in dict.fromkeys([*places, *below]):
            files += [p for p in _entries(place) if p.suffix.lower() in (*MUSIC, *_OTHER) and p not in self.used]
            if len(files) > _MAX_FILES:
                break
        there = (path for path in files[:_MAX_FILES] if path.is_file())
        return [(path, _Name.of(path.stem), self.is_other(path.stem)) for path in there]


def _entries(folder: Path) -> list[Path]:
    try:
        return list_folder(folder)
    except SourceError:
        return []  # what cannot be read is not where music is looked for


@dataclass(frozen=True)
class _Name:
    """A name, its letters and its numbers; "001" is "1"."""

    text: str
    parts: tuple[str, ...]
    numbers: tuple[str, ...]
    letters: str
    #: All parts in a row, to find one name in another.
    row: str

    @classmethod
    def of(cls, text: str) -> _Name:
        found = _PARTS.findall(text.lower())
        parts = tuple(part.lstrip("0") or "0" if part.isdigit() else part for part in found)
        numbers = tuple(part for part in parts if part.isdigit())
        letters = "".join(part for part in parts if not part.isdigit())
        return cls(text, parts, numbers, letters, f" {' '.join(parts)} ")

    def near(self, other: _Name, misspelt: bool) -> bool:
        """Tell whether the other name may be this one, written differently, or misspelt if that is looked for."""
        if self.parts == other.parts:
            return bool(self.parts)
        if self._has(other) or other._has(self):
            return True
        return misspelt and self.numbers == other.numbers and self.likeness(other) >= _ALIKE

    def _has(self, part: _Name) -> bool:
        # "mBR0 (1)" and "mBR0_48k" have "mBR0" in them.
        return len(part.text) >= _MIN_PART and part.row in self.row

    def likeness(self, other: _Name) -> float:
        """Compare the letters; 1 is equal."""
        if not self.letters or not other.letters:
            return 0.0
        return difflib.SequenceMatcher(None, self.letters, other.letters, autojunk=False).ratio()
