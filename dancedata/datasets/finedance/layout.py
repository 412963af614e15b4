"""Motion, music and labels of a FineDance copy: the lists of its folders, and its label files."""

import re
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.text import listed, quoted
from dancedata.datasets.files import Files, files_by_stem, list_audio
from dancedata.datasets.finedance.facts import facts
from dancedata.datasets.layout import Folders, Layout
from dancedata.files.listing import list_folder
from dancedata.files.strict_json import read_json

KEY = "style2"
#: Labels have about a hundred bytes; larger files are not read.
MAX_BYTES = 1 << 20
#: Characters of a genre in messages.
SHOWN = 40


@dataclass(frozen=True)
class Label:
    """The content of a label.

    `genre`: Canonical name of the genre, "" if the label has none.
    `reason`, `problem`: The problem, as a code ("missing_label", "broken_label", "unknown_genre") and in words.
    """

    genre: str = ""
    reason: str = ""
    problem: str = ""


def read_label(path: Path | None, clip: str) -> Label:
    """Read ``label_json/NNN.json``: ``style2`` is the genre; ``style1`` (coarse) and the song's name are not used.

    `path`: The file; None if it does not exist.
    `clip`: Id, for messages.
    """
    name = f"label_json/{clip}.json"
    if path is None:
        return Label(reason="missing_label", problem=f"there is no {name}")
    try:
        content = read_json(path, MAX_BYTES)
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

# Explicit ranges: \d would accept digits of other scripts.
_ID = re.compile(r"[0-9]{3}")
_MIRRORED = re.compile(r"M[0-9]{3}")


def _id_problem(stem: str, suffix: str) -> str:
    """Return why a file name is not an id of FineDance; "" if it is one."""
    if _MIRRORED.fullmatch(stem):
        return "a mirrored copy, as made by Lodge; augment.mirror computes it from the original"
    return "" if _ID.fullmatch(stem) else f"not named by an id of three digits (001{suffix})"


_FEATURES = "features computed from FineDance cannot be a source: use motion/ as published"
LAYOUT = Layout(
    dataset="finedance",
    title="FineDance",
    motions=MOTION,
    suffix=".npy",
    name_problem=lambda stem: _id_problem(stem, ".npy"),
    is_known=lambda name: name.lower() == "finedance",
    looked_for="motion/001.npy and so on, in the source folder or in one folder below it (finedance/, ...)",
    named="files named as 001.npy",
    mistakes={
        "mofea319": _FEATURES,
        "motion_fea319": _FEATURES,
        "motions": "motions/ (with s) is the layout of AIST++: build that dataset, or set --source to another folder",
    },
)


def not_read_notes(folders: Folders) -> list[str]:
    """Return the note about folders that are not part of the layout."""
    beside = [entry.name for entry in list_folder(folders.root) if entry.is_dir()]
    names = [f"{folder.name}/ (also contains motion/)" for folder in folders.others]
    names += [f"{name}/" for name in beside if name not in (MOTION, MUSIC, LABELS)]
    why = " Music features are computed from the audio." if "music_npy" in beside else ""
    return [f"Not read: {listed(names)}.{why}"] if names else []


def list_labels(folders: Folders) -> Files:
    """List ``label_json/NNN.json``; every other entry is an ``extra_file``."""
    return files_by_stem(folders.root / LABELS, folders.source, ".json", lambda stem: _id_problem(stem, ".json"))


def list_music(folders: Folders, music_dir: Path | None = None) -> Files:
    """List ``music_wav/NNN.wav``, those of `music_dir` first; of several files with one id the preferred format."""

    def problem(stem: str) -> str:
        return _id_problem(stem, ".wav")

    return list_audio([folders.root / MUSIC], folders.source, problem, music_dir=music_dir)
