"""Finds audio files that may be the missing music of a clip under a slightly different name."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePath
from shlex import quote

from dancedata.core.errors import SourceError
from dancedata.datasets.files import AUDIO_SUFFIXES, list_folder, relative

#: Other formats of audio files, which are not looked for.
_OTHER = (".m4b", ".mka", ".mov", ".oga", ".webm", ".wma")
#: Least similarity of the letters of two names with equal numbers: mBR0 and mBR5 are different songs.
_ALIKE = 0.8
#: A shorter name within another one is not evidence.
_MIN_PART = 3
#: Most unused files that are compared, most files that are searched for misspelt names, and most missing names that
#: are looked up: the cost is their product, and a message shows only a few.
_MAX_FILES, _MAX_MISSPELT, _MAX_NAMES = 1_000, 100, 2_000
_PARTS = re.compile(r"[^\W\d_]+|[0-9]+")


class NearMusic:
    """Audio files of a source that no clip uses; listed on first use.

    Parameters
    ----------
    folders
        Folders that may hold music, and their parents; folders directly below them are searched as well.
    used
        Audio files of clips.
    is_other
        Returns whether a stem is a valid name in this dataset, and so not a misspelling.
    """

    def __init__(
        self, source: Path, folders: Sequence[Path], used: Collection[Path], is_other: Callable[[str], bool]
    ) -> None:
        self.source, self.folders, self.used, self.is_other = source, folders, used, is_other
        self._names_left = _MAX_NAMES

    def fix(self, *expected: str) -> str:
        """Return the fix for missing music as a line of a script, "" if no file has a similar name.

        Parameters
        ----------
        expected
            Paths below the source, without suffixes, where it is expected.
        """
        if self._names_left <= 0:
            return ""
        self._names_left -= len(expected)
        misspelt = len(self._files) <= _MAX_MISSPELT
        names = {target: Name.of(PurePath(target).name) for target in expected}
        matches = [
            (path.suffix.lower() not in AUDIO_SUFFIXES, -have.likeness(name), path, target)
            for target, name in names.items()
            for path, have, other in self._files
            if have.text == name.text or (not other and have.near(name, misspelt))
        ]
        if not matches:
            return ""
        # Of several, one in a readable format, then the most similar one.
        *_, path, target = min(matches)
        suffix, do = path.suffix.lower(), "mv -n"
        if suffix not in AUDIO_SUFFIXES:
            suffix, do = AUDIO_SUFFIXES[0], "ffmpeg -n -i"
        return f"{do} {quote(relative(path, self.source))} {quote(target + suffix)}"

    @cached_property
    def _files(self) -> list[tuple[Path, Name, bool]]:
        places = list(dict.fromkeys(self.folders))
        below = [entry for place in places for entry in _entries(place) if entry.is_dir() and not entry.is_symlink()]
        files: list[Path] = []
        for place in dict.fromkeys([*places, *below]):
            unused = (path for path in _entries(place) if path not in self.used)
            files += [path for path in unused if path.suffix.lower() in (*AUDIO_SUFFIXES, *_OTHER)]
            if len(files) > _MAX_FILES:
                break
        existing = (path for path in files[:_MAX_FILES] if path.is_file())
        return [(path, Name.of(path.stem), self.is_other(path.stem)) for path in existing]


def _entries(folder: Path) -> list[Path]:
    try:
        return list_folder(folder)
    except SourceError:
        return []  # unreadable folders are not searched


@dataclass(frozen=True)
class Name:
    """A file name, split into letters and numbers; "001" is "1"."""

    text: str
    parts: tuple[str, ...]
    numbers: tuple[str, ...]
    letters: str
    #: All parts in a row, to search one name in another.
    row: str

    @classmethod
    def of(cls, text: str) -> Name:
        words = _PARTS.findall(text.lower())
        parts = tuple(part.lstrip("0") or "0" if part.isdigit() else part for part in words)
        numbers = tuple(part for part in parts if part.isdigit())
        letters = "".join(part for part in parts if not part.isdigit())
        return cls(text, parts, numbers, letters, f" {' '.join(parts)} ")

    def near(self, other: Name, misspelt: bool) -> bool:
        """Return whether the other name may be this one, written differently or, if `misspelt`, misspelt."""
        if self.parts == other.parts:
            return bool(self.parts)
        if self._has(other) or other._has(self):
            return True
        return misspelt and self.numbers == other.numbers and self.likeness(other) >= _ALIKE

    def _has(self, part: Name) -> bool:
        # "mBR0 (1)" and "mBR0_48k" contain "mBR0".
        return len(part.text) >= _MIN_PART and part.row in self.row

    def likeness(self, other: Name) -> float:
        """Return the similarity of the letters, 0 to 1."""
        if not self.letters or not other.letters:
            return 0.0
        return difflib.SequenceMatcher(None, self.letters, other.letters, autojunk=False).ratio()
