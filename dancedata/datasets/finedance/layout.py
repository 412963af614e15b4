"""Where motion, music and labels of a FineDance copy are; lists folders and reads no file."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.clip import Reject
from dancedata.core.errors import SourceError
from dancedata.core.text import listed, quoted
from dancedata.datasets._near_music import NearMusic
from dancedata.datasets.files import (
    AUDIO_SUFFIXES,
    Files,
    audio_files,
    describe,
    extra_file,
    file_problem,
    files_by_stem,
    find_root,
    has_archive,
    list_folder,
    relative,
)
from dancedata.datasets.finedance.facts import facts
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import parse_json

KEY = "style2"
#: Labels have about a hundred bytes; larger files are not read.
MAX_BYTES = 1 << 20
#: Characters of a genre in messages.
SHOWN = 40


@dataclass(frozen=True)
class Label:
    """The content of a label.

    Attributes
    ----------
    genre
        Canonical name of the genre, "" if the label has none.
    reason, problem
        The problem, as a code ("missing_label", "broken_label", "unknown_genre") and in words.
    """

    genre: str = ""
    reason: str = ""
    problem: str = ""


def read_label(path: Path | None, clip: str) -> Label:
    """Read ``label_json/NNN.json``: ``style2`` is the genre; ``style1`` (coarse) and the song's name are not used.

    Parameters
    ----------
    path
        The file; None if it does not exist.
    clip
        Id, for messages.
    """
    name = f"label_json/{clip}.json"
    if path is None:
        return Label(reason="missing_label", problem=f"there is no {name}")
    try:
        content = parse_json(read_regular(path, MAX_BYTES).decode("utf-8-sig"))
    except (OSError, ValueError) as error:
        return _broken(name, str(error))
    if not isinstance(content, dict):
        return _broken(name, f"a {type(content).__name__}, not an object with {KEY}")
    style = content.get(KEY)
    if style is None or style == "":
        found = listed(content, show=quoted) or "none"
        return Label(reason="missing_label", problem=f"{name} has no {KEY}; keys found: {found}")
    genre = facts().genre(style) if isinstance(style, str) else ""
    if genre:
        return Label(genre)
    allowed = ", ".join(facts().genre_ids)
    return Label(reason="unknown_genre", problem=f"{name}: {KEY} is {quoted(style, SHOWN)}, not one of {allowed}")


def _broken(name: str, problem: str) -> Label:
    return Label(reason="broken_label", problem=f"{name} cannot be read: {problem}")


MOTION, MUSIC, LABELS = "motion", "music_wav", "label_json"
LOOKED_FOR = "motion/001.npy and so on, in the source folder or in one folder below it (finedance/, ...)"

# An explicit range: \d would accept digits of other scripts.
_ID = re.compile(r"[0-9]{3}")
_MIRRORED = re.compile(r"M[0-9]{3}")


@dataclass(frozen=True)
class Folders:
    """The source, and the folder in it (or itself) that holds ``motion/``."""

    source: Path
    root: Path
    notes: tuple[str, ...]


def find_folders(source: Path) -> Folders:
    """Find the folder that holds ``motion/``: the source or one folder directly below it.

    Raises
    ------
    SourceError
        If the folder does not exist, or there are several candidates; names the expected and the existing files.
    """
    root, others = find_root(
        "finedance",
        "FineDance",
        source,
        MOTION,
        looked_for=LOOKED_FOR,
        is_known=lambda name: name.lower() == "finedance",
        advice=_advice,
    )
    return Folders(source, root, _not_read(root, [f"{entry.name}/ (also contains motion/)" for entry in others]))


def _not_read(root: Path, others: list[str]) -> tuple[str, ...]:
    """Return the note about folders that are not part of the layout."""
    folders = [entry.name for entry in list_folder(root) if entry.is_dir()]
    others += [f"{name}/" for name in folders if name not in (MOTION, MUSIC, LABELS)]
    why = " Music features are computed from the audio." if "music_npy" in folders else ""
    return (f"Not read: {listed(others)}.{why}",) if others else ()


def _advice(source: Path) -> str:
    """Return the fix for the most likely mistake, for a folder without ``motion/``."""
    entries = list_folder(source)
    if any(entry.suffix.lower() == ".npy" for entry in entries):
        return "this looks like the motion folder itself: set --source to its parent folder"
    if any(entry.name in ("mofea319", "motion_fea319") for entry in entries):
        return "features computed from FineDance cannot be a source: use motion/ as published"
    if (source / "motions").is_dir():
        return "motions/ (with s) is the layout of AIST++: build that dataset, or set --source to another folder"
    if has_archive(source):
        return "unpack the archive first"
    return "set --source to the folder that contains motion/"


def list_motions(folders: Folders) -> Files:
    """List ``motion/NNN.npy``; every other entry is an ``extra_file``.

    Raises
    ------
    SourceError
        If there are none.
    """
    files = _one_each(folders, MOTION, ".npy")
    if not files.files:
        raise SourceError(
            "finedance: the motion folder contains no FineDance sequence",
            where=str(folders.root / MOTION),
            found=describe(folders.root / MOTION),
            allowed="files named as 001.npy",
            fix="check that the archive was unpacked completely",
        )
    return files


def list_labels(folders: Folders) -> Files:
    """List ``label_json/NNN.json``; every other entry is an ``extra_file``."""
    return _one_each(folders, LABELS, ".json")


def list_music(folders: Folders) -> Files:
    """List ``music_wav/NNN.wav``; of several files with one id the preferred format is used."""
    folder = folders.root / MUSIC
    candidates: list[Path] = []
    rejects: list[Reject] = []
    for path in list_folder(folder) if folder.is_dir() else []:
        problem = file_problem(path, AUDIO_SUFFIXES) or _id_problem(path.stem, ".wav")
        if problem:
            rejects.append(extra_file(path, folders.source, problem))
        else:
            candidates.append(path)
    return audio_files(candidates, folders.source, rejects)


def music_fix(folders: Folders, music: Files) -> Callable[[str], str]:
    """Return a function from an id to the fix for its missing music, "" if no file has a similar name."""
    near = NearMusic(
        folders.source,
        (folders.root / MUSIC, folders.root, folders.source),
        set(music.files.values()),
        lambda stem: _ID.fullmatch(stem) is not None,
    )
    return lambda clip: near.fix(relative(folders.root / MUSIC / clip, folders.source))


def _one_each(folders: Folders, name: str, suffix: str) -> Files:
    return files_by_stem(folders.root / name, folders.source, suffix, lambda stem: _id_problem(stem, suffix))


def _id_problem(stem: str, suffix: str) -> str:
    """Return why a file name is not an id of FineDance; "" if it is one."""
    if _MIRRORED.fullmatch(stem):
        return "a mirrored copy, as made by Lodge; augment.mirror computes it from the original"
    return "" if _ID.fullmatch(stem) else f"not named by an id of three digits (001{suffix})"
