"""Where the parts of a FineDance copy lie: motion, music, labels. Lists only, reads nothing."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.clip import Reject
from dancedata.core.errors import SourceError
from dancedata.core.text import listed
from dancedata.datasets._near_music import MUSIC as MUSIC_FILES
from dancedata.datasets._near_music import NearMusic
from dancedata.datasets._source import describe, list_folder, relative, require_folder

__all__ = [
    "LABELS",
    "MOTION",
    "MUSIC",
    "Files",
    "Folders",
    "find_folders",
    "list_labels",
    "list_motions",
    "list_music",
    "music_fix",
]

MOTION, MUSIC, LABELS = "motion", "music_wav", "label_json"
EXTENSIONS = MUSIC_FILES
LOOKED_FOR = "motion/001.npy and so on, in the source folder or in one folder below it (finedance/, ...)"

# An explicit range: \d would accept digits of other scripts.
_ID = re.compile(r"[0-9]{3}")
_MIRRORED = re.compile(r"M[0-9]{3}")


@dataclass(frozen=True)
class Folders:
    """The source, the folder in it that holds ``motion/``, and what else lies there."""

    source: Path
    root: Path
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Files:
    """Files of one kind by id, and what else lies in their folder."""

    files: dict[str, Path]
    rejects: tuple[Reject, ...]
    notes: tuple[str, ...] = ()


def find_folders(source: Path) -> Folders:
    """Find the folder that holds ``motion/``: the source or one folder in it.

    Raises
    ------
    SourceError
        If there is none, or several that could be meant. Says what was looked for and what is there.
    """
    require_folder("finedance", source, LOOKED_FOR)
    if (source / MOTION).is_dir():
        return Folders(source, source, _not_read(source, []))
    below = [entry for entry in list_folder(source) if (entry / MOTION).is_dir()]
    known = [entry for entry in below if entry.name.lower() == "finedance"]
    chosen = below if len(below) == 1 else known
    if len(chosen) == 1:
        others = [f"{entry.name}/ (motion/ too)" for entry in below if entry != chosen[0]]
        return Folders(source, chosen[0], _not_read(chosen[0], others))
    if below:
        raise SourceError(
            "finedance: several folders could be the data set",
            where=str(source),
            found=listed(f"{entry.name}/{MOTION}/" for entry in below),
            fix="give --source the one that is meant",
        )
    raise SourceError(
        "finedance: no FineDance motion found",
        where=str(source),
        found=describe(source),
        allowed=LOOKED_FOR,
        fix=_advice(source),
    )


def _not_read(root: Path, others: list[str]) -> tuple[str, ...]:
    """Say which folders beside those of the layout are not looked at."""
    folders = [entry.name for entry in list_folder(root) if entry.is_dir()]
    others += [f"{name}/" for name in folders if name not in (MOTION, MUSIC, LABELS)]
    why = " Music features are computed from the music." if "music_npy" in folders else ""
    return (f"Not read: {listed(others)}.{why}",) if others else ()


def _advice(source: Path) -> str:
    """Say what probably happened, for a folder without ``motion/``."""
    entries = list_folder(source)
    if any(entry.suffix.lower() == ".npy" for entry in entries):
        return "this looks like the motion folder itself: give --source the folder above it"
    if any(entry.name in ("mofea319", "motion_fea319") for entry in entries):
        return "features made from FineDance are no source: get motion/ as it was published"
    if (source / "motions").is_dir():
        return "motions/ (with s) is the layout of AIST++: build that data set, or give another --source"
    if any(entry.suffix.lower() in (".rar", ".zip", ".tgz", ".gz", ".tar", ".7z") for entry in entries):
        return "unpack the archive first"
    return "give --source the folder that holds motion/"


def list_motions(folders: Folders) -> Files:
    """List ``motion/NNN.npy``; everything else there is an ``extra_file``.

    Raises
    ------
    SourceError
        If there is not one.
    """
    files = _one_each(folders, MOTION, ".npy")
    if not files.files:
        raise SourceError(
            "finedance: the motion folder holds no FineDance sequence",
            where=str(folders.root / MOTION),
            found=describe(folders.root / MOTION),
            allowed="files named as 001.npy",
            fix="check that the archive was unpacked whole",
        )
    return files


def list_labels(folders: Folders) -> Files:
    """List ``label_json/NNN.json``; everything else there is an ``extra_file``."""
    return _one_each(folders, LABELS, ".json")


def list_music(folders: Folders) -> Files:
    """List ``music_wav/NNN.wav``; of several files of one id the best kind is taken, the others are unused."""
    candidates: dict[str, list[Path]] = {}
    rejects: list[Reject] = []
    for path in _entries(folders.root / MUSIC):
        problem = _unfit(path, EXTENSIONS)
        if problem:
            rejects.append(_extra(path, folders.source, problem))
        else:
            candidates.setdefault(path.stem, []).append(path)
    files, doubled = {}, []
    for clip, paths in sorted(candidates.items()):
        best, *others = sorted(paths, key=lambda path: EXTENSIONS.index(path.suffix.lower()))
        files[clip] = best
        detail = f"{relative(best, folders.source)} is used instead"
        rejects += [Reject("unused_music", file=relative(path, folders.source), detail=detail) for path in others]
        doubled += [best.name] if others else []
    notes = []
    if doubled:
        text = (
            f"Music: several files of one id; wav is preferred to flac, flac to mp3 and ogg. Used: {listed(doubled)}."
        )
        notes.append(text)
    return Files(files, tuple(rejects), tuple(notes))


def music_fix(folders: Folders, music: Files) -> Callable[[str], str]:
    """Return a function that says what to do about the missing music of an id, "" if no file may be it."""
    used = set(music.files.values())
    near = NearMusic(
        folders.source, (folders.root / MUSIC, folders.root, folders.source), used, lambda s: bool(_ID.fullmatch(s))
    )
    return lambda clip: near.fix(relative(folders.root / MUSIC / clip, folders.source))


def _one_each(folders: Folders, name: str, extension: str) -> Files:
    files: dict[str, Path] = {}
    rejects = []
    # The published spelling first, should there be 001.NPY as well.
    for path in sorted(_entries(folders.root / name), key=lambda path: path.suffix != extension):
        problem = _unfit(path, (extension,))
        if not problem and path.stem in files:
            problem = f"the same id as {files[path.stem].name}, which is read"
        if problem:
            rejects.append(_extra(path, folders.source, problem))
        else:
            files[path.stem] = path
    return Files(files, tuple(rejects))


def _entries(folder: Path) -> list[Path]:
    return list_folder(folder) if folder.is_dir() else []


def _unfit(path: Path, extensions: tuple[str, ...]) -> str:
    """Why an entry cannot be such a file; "" if it can."""
    if path.is_dir():
        return "a folder; folders in here are not read"
    if not path.is_file():
        return "not a file: a link that leads nowhere, or a device"
    if path.suffix.lower() not in extensions:
        return f"not a {' or '.join(extensions)} file"
    if _MIRRORED.fullmatch(path.stem):
        return "a mirrored copy, as Lodge makes them; mirroring is an option here, so the original is enough"
    return "" if _ID.fullmatch(path.stem) else f"not named by an id of three digits (001{extensions[0]})"


def _extra(path: Path, source: Path, problem: str) -> Reject:
    name = relative(path, source) + ("/" if path.is_dir() else "")
    return Reject("extra_file", file=name, detail=problem)
