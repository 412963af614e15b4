"""Entries of folders: listed, by name and by suffix."""

import glob
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.audio_signal import AUDIO_SUFFIXES
from dancedata.core.errors import DataError, SourceError

#: What a folder to build from has: folders of motion, or a manifest.
MOTION_FOLDERS, MANIFESTS = ("motions", "motion"), ("manifest.csv", "manifest.jsonl")


@dataclass(frozen=True)
class FileEntry:
    """Name, size and hash of a file that a description lists."""

    file: str
    size: int
    sha256: str


def list_folder(folder: Path) -> list[Path]:
    """Return the entries of a folder by name, without hidden ones (``.DS_Store``) and ``__MACOSX``."""
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise SourceError("the folder cannot be read", where=str(folder), found=error.strerror or str(error),
                          fix="check the path and its permissions") from error  # fmt: skip
    return [entry for entry in entries if not entry.name.startswith(".") and entry.name != "__MACOSX"]


def stem_of(path: Path) -> str:
    """Return the name without its last suffix, in Unicode's form NFC: archives of macOS have names in NFD."""
    return unicodedata.normalize("NFC", path.stem)


def named_files(paths: Sequence[Path], suffixes: Sequence[str]) -> list[Path]:
    """Return the files that paths name: themselves, all of a folder with one of these suffixes, or of a pattern."""
    files: list[Path] = []
    for path in paths:
        pattern = glob.has_magic(str(path)) and not path.exists()
        if path.exists() and not path.is_dir():
            files.append(path)
            continue
        if not path.is_dir() and not pattern:
            raise DataError("there is no such file or folder", reason="nothing_matched", where=path,
                            fix="check the path")  # fmt: skip
        entries = [Path(name) for name in glob.glob(str(path))] if pattern else list_folder(path)
        mine = sorted(p for p in entries if p.suffix.lower() in suffixes and p.is_file())
        if not mine:
            problem = "the pattern names no file to read" if pattern else "the folder has no file to read"
            raise DataError(problem, reason="nothing_matched", where=path, allowed=f"files {', '.join(suffixes)}")
        files += mine
    return files


def group_by_stem(folders: Iterable[Path], suffixes: Sequence[str]) -> list[tuple[str, list[Path]]]:
    """Return the files of folders with these suffixes by their names without suffix, sorted by name."""
    by_stem: dict[str, list[Path]] = {}
    for folder in folders:
        for path in list_folder(folder):
            if path.suffix.lower() in suffixes and path.is_file():
                by_stem.setdefault(stem_of(path), []).append(path)
    return sorted(by_stem.items())


def best_audio(paths: Iterable[Path]) -> list[Path]:
    """Sort audio files with equal stems, the preferred one first; of equal suffixes in the given order."""
    return sorted(paths, key=lambda path: AUDIO_SUFFIXES.index(path.suffix.lower()))
