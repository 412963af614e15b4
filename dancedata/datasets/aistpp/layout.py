"""Where the parts of an AIST++ copy lie: motion folder, music files. Lists only, reads nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.clip import Reject
from dancedata.core.errors import SourceError
from dancedata.core.text import listed
from dancedata.datasets._near_music import MUSIC, NearMusic
from dancedata.datasets._source import describe, list_folder, relative, require_folder
from dancedata.datasets.aistpp.facts import is_music_id, parse_name

__all__ = [
    "MUSIC_FOLDERS",
    "Folders",
    "MotionFiles",
    "MusicFiles",
    "find_folders",
    "layout_name",
    "list_motions",
    "list_music",
    "music_expected",
    "music_in_use",
    "near_music",
    "unused_music",
]

MOTIONS = "motions"
MUSIC_FOLDERS = ("wavs", "music", "audio", "musics")
EXTENSIONS = MUSIC
SUBFOLDERS = (
    "edge_aistpp",
    "aist_plusplus_final",
)  # names under which EDGE and the project page ship the data
LOOKED_FOR = "motions/*.pkl, in the source folder or in one folder below it (edge_aistpp/, aist_plusplus_final/, ...)"


@dataclass(frozen=True)
class Folders:
    """The source, the folder in it that holds ``motions/``, and where else to look, in order."""

    source: Path
    root: Path
    motions: Path
    notes: tuple[str, ...]

    @property
    def places(self) -> tuple[Path, ...]:
        """Folders in which lists and music folders may lie."""
        return (self.root,) if self.root == self.source else (self.root, self.source)


@dataclass(frozen=True)
class MotionFiles:
    """Motion pickles by sequence name, and what else lies in their folder."""

    files: dict[str, Path]
    rejects: tuple[Reject, ...]


@dataclass(frozen=True)
class MusicFiles:
    """Music files by their stem (sequence name or music id), the folders they came from, and the rest."""

    files: dict[str, Path]
    folders: tuple[Path, ...]
    rejects: tuple[Reject, ...]
    notes: tuple[str, ...]


def find_folders(source: Path) -> Folders:
    """Find the folder that holds ``motions/``: the source or one folder in it.

    Raises
    ------
    SourceError
        If there is none, or several that could be meant. Says what was looked for and what is there.
    """
    require_folder("aist++", source, LOOKED_FOR)
    if (source / MOTIONS).is_dir():
        return Folders(source, source, source / MOTIONS, ())
    below = [entry for entry in list_folder(source) if (entry / MOTIONS).is_dir()]
    known = [entry for entry in below if entry.name in SUBFOLDERS]
    chosen = below if len(below) == 1 else known
    if len(chosen) == 1:
        others = [f"{entry.name}/" for entry in below if entry != chosen[0]]
        notes = (f"Not read: {listed(others)}, which hold motions/ too.",) if others else ()
        return Folders(source, chosen[0], chosen[0] / MOTIONS, notes)
    if below:
        raise SourceError(
            "aist++: several folders could be the data set",
            where=str(source),
            found=listed(f"{entry.name}/motions/" for entry in below),
            fix="give --source the one that is meant",
        )
    raise SourceError(
        "aist++: no AIST++ motion found",
        where=str(source),
        found=describe(source),
        allowed=LOOKED_FOR,
        fix=_advice(source),
    )


def _advice(source: Path) -> str:
    """Say what probably happened, for a folder without ``motions/``."""
    entries = list_folder(source)
    if any(entry.suffix.lower() == ".pkl" for entry in entries):
        return "this looks like the motions folder itself: give --source the folder above it"
    if (source / "motion").is_dir():
        return "motion/ (without s) is the layout of FineDance: build that data set, or give another --source"
    if any(entry.suffix.lower() in (".zip", ".tgz", ".gz", ".tar") for entry in entries):
        return "unpack the archive first"
    return "give --source the folder that holds motions/"


def list_motions(folders: Folders) -> MotionFiles:
    """List the pickles that are named as AIST++ sequences; everything else there is an ``extra_file``.

    Raises
    ------
    SourceError
        If there is not one.
    """
    files: dict[str, Path] = {}
    rejects = []
    for path in list_folder(folders.motions):
        problem = _unfit(path, (".pkl",), "pickle (.pkl)")
        if not problem and parse_name(path.stem) is None:
            problem = "not named as an AIST++ sequence (gBR_sBM_cAll_d04_mBR2_ch08)"
        if not problem and path.stem in files:
            problem = f"the same sequence as {files[path.stem].name}, which is read"
        if problem:
            rejects.append(_extra(path, folders.source, problem))
        else:
            files[path.stem] = path
    if not files:
        raise SourceError(
            "aist++: the motion folder holds no AIST++ sequence",
            where=str(folders.motions),
            found=describe(folders.motions),
            allowed="pickles named as gBR_sBM_cAll_d04_mBR2_ch08.pkl",
            fix="check that the archive was unpacked whole",
        )
    return MotionFiles(files, tuple(rejects))


def list_music(folders: Folders) -> MusicFiles:
    """List the music: one file a sequence or one file a song, in any of the usual folders."""
    candidates: dict[str, list[Path]] = {}
    used: list[Path] = []
    rejects: list[Reject] = []
    for folder in _music_folders(folders):
        found = list(_named_music(folder, folders, rejects))
        used += [folder] if found else []
        for path in found:
            candidates.setdefault(path.stem, []).append(path)
    files = {}
    doubled = []
    for stem, paths in sorted(candidates.items()):
        # sorted() is stable: among files of one kind the first folder wins.
        best, *others = sorted(paths, key=lambda path: EXTENSIONS.index(path.suffix.lower()))
        files[stem] = best
        chosen = relative(best, folders.source)
        for other in others:
            rejects.append(
                Reject("unused_music", file=relative(other, folders.source), detail=f"{chosen} is used instead")
            )
        doubled += [chosen] if others else []
    notes = []
    if doubled:
        notes.append(
            f"Music: {len(doubled):,} ids have several files; wav is preferred to flac, flac to mp3 and ogg. "
            f"Used: {listed(doubled, 3)}."
        )
    return MusicFiles(files, tuple(used), tuple(rejects), tuple(notes))


def music_in_use(motions: MotionFiles, music: MusicFiles) -> tuple[set[str], set[str]]:
    """Stems of the music files in use: those of sequences, those of songs.

    A sequence that is left out of the data set uses its music all the same.
    """
    own = {name for name in motions.files if name in music.files}
    parsed = (parse_name(name) for name in motions.files if name not in own)
    return own, {parts.music for parts in parsed if parts is not None and parts.music in music.files}


def layout_name(motions: MotionFiles, music: MusicFiles) -> str:
    """Name of the layout: "official", "edge" or "mixed"."""
    own, songs = music_in_use(motions, music)
    return "mixed" if own and songs else "edge" if own else "official"


def unused_music(folders: Folders, motions: MotionFiles, music: MusicFiles) -> list[Reject]:
    """Music that no sequence here uses."""
    own, songs = music_in_use(motions, music)
    danced = {parts.music for name in motions.files if (parts := parse_name(name)) is not None}
    rejects = []
    for stem, path in music.files.items():
        if stem in own or stem in songs:
            continue
        if not is_music_id(stem):
            detail = f"there is no motions/{stem}.pkl"
        elif stem in danced:
            detail = "every sequence danced to it has a file of its own"
        else:
            detail = "no motion found is danced to it"
        rejects.append(Reject("unused_music", file=relative(path, folders.source), detail=detail))
    return rejects


def music_expected(folders: Folders, music: MusicFiles) -> str:
    """Folder below the source in which missing music would be found: one that holds music, else wavs/."""
    folder = music.folders[0] if music.folders else folders.root / MUSIC_FOLDERS[0]
    name = relative(folder, folders.source)
    return "" if name == "." else f"{name}/"


def near_music(folders: Folders, music: MusicFiles) -> NearMusic:
    """Files that may be the music of a sequence and are not named so, or lie elsewhere."""
    return NearMusic(
        folders.source,
        (*folders.places, *_music_folders(folders)),
        set(music.files.values()),
        lambda stem: is_music_id(stem) or parse_name(stem) is not None,
    )


def _music_folders(folders: Folders) -> list[Path]:
    named = [place / name for place in folders.places for name in MUSIC_FOLDERS]
    return [folder for folder in (*named, *folders.places) if folder.is_dir()]


def _named_music(folder: Path, folders: Folders, rejects: list[Reject]) -> Iterator[Path]:
    """Music files of a folder that carry an AIST++ name; what does not belong there goes to `rejects`."""
    top = folder in folders.places  # next to motions/, much may lie that is no music
    for path in list_folder(folder):
        if top and path.suffix.lower() not in EXTENSIONS:
            continue
        problem = _unfit(path, EXTENSIONS, f"music file ({', '.join(EXTENSIONS)})")
        if not problem and not is_music_id(path.stem) and parse_name(path.stem) is None:
            problem = "named neither as an AIST++ sequence nor as a song (mBR2)"
        if problem:
            rejects.append(_extra(path, folders.source, problem))
        else:
            yield path


def _unfit(path: Path, extensions: tuple[str, ...], kind: str) -> str:
    """Why an entry cannot be such a file, judged without its name; "" if it can."""
    if path.is_dir():
        return "a folder; folders in here are not read"
    if not path.is_file():
        return "not a file: a link that leads nowhere, or a device"
    return "" if path.suffix.lower() in extensions else f"not a {kind}"


def _extra(path: Path, source: Path, problem: str) -> Reject:
    name = relative(path, source) + ("/" if path.is_dir() else "")
    return Reject("extra_file", file=name, detail=problem)
