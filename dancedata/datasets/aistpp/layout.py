"""Where motion and audio files of an AIST++ copy are; lists folders and reads no file."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

from dancedata.core.clip import Reject
from dancedata.core.errors import SourceError
from dancedata.core.text import listed
from dancedata.datasets._near_music import NearMusic
from dancedata.datasets.aistpp.facts import is_music_id, parse_name
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

MOTIONS = "motions"
MUSIC_FOLDERS = ("wavs", "music", "audio", "musics")
#: Folder names of the copies of EDGE and of the project page.
_KNOWN = ("edge_aistpp", "aist_plusplus_final")
LOOKED_FOR = "motions/*.pkl, in the source folder or in one folder below it (edge_aistpp/, aist_plusplus_final/, ...)"


@dataclass(frozen=True)
class Folders:
    """The source, and the folder in it (or itself) that holds ``motions/``."""

    source: Path
    root: Path
    notes: tuple[str, ...]

    @property
    def motions(self) -> Path:
        """The motion folder."""
        return self.root / MOTIONS

    @property
    def places(self) -> tuple[Path, ...]:
        """Folders that may hold lists and music folders, in order of preference."""
        return (self.root,) if self.root == self.source else (self.root, self.source)


@dataclass(frozen=True)
class MusicFiles(Files):
    """Audio files by their stem (sequence name or music id), and the folders that hold any."""

    folders: tuple[Path, ...] = ()


def find_folders(source: Path) -> Folders:
    """Find the folder that holds ``motions/``: the source or one folder directly below it.

    Raises
    ------
    SourceError
        If the folder does not exist, or there are several candidates; names the expected and the existing files.
    """
    root, others = find_root(
        "aist++", "AIST++", source, MOTIONS, looked_for=LOOKED_FOR, is_known=_KNOWN.__contains__, advice=_advice
    )
    names = listed(f"{entry.name}/" for entry in others)
    return Folders(source, root, (f"Not read: {names}, which also contain motions/.",) if others else ())


def _advice(source: Path) -> str:
    """Return the fix for the most likely mistake, for a folder without ``motions/``."""
    if any(entry.suffix.lower() == ".pkl" for entry in list_folder(source)):
        return "this looks like the motions folder itself: set --source to its parent folder"
    if (source / "motion").is_dir():
        return "motion/ (without s) is the layout of FineDance: build that dataset, or set --source to another folder"
    if has_archive(source):
        return "unpack the archive first"
    return "set --source to the folder that contains motions/"


def list_motions(folders: Folders) -> Files:
    """List the pickles named as AIST++ sequences; every other entry is an ``extra_file``.

    Raises
    ------
    SourceError
        If there are none.
    """
    files = files_by_stem(folders.motions, folders.source, ".pkl", _sequence_problem)
    if not files.files:
        raise SourceError(
            "aist++: the motion folder contains no AIST++ sequence",
            where=str(folders.motions),
            found=describe(folders.motions),
            allowed="pickles named as gBR_sBM_cAll_d04_mBR2_ch08.pkl",
            fix="check that the archive was unpacked completely",
        )
    return files


def _sequence_problem(stem: str) -> str:
    return "" if parse_name(stem) else "not named as an AIST++ sequence (gBR_sBM_cAll_d04_mBR2_ch08)"


def list_music(folders: Folders) -> MusicFiles:
    """List the audio files, one for each sequence or one for each song, in any of the usual folders."""
    rejects: list[Reject] = []
    by_folder = {folder: list(_named_music(folder, folders, rejects)) for folder in _music_folders(folders)}
    candidates = [path for paths in by_folder.values() for path in paths]
    files = audio_files(candidates, folders.source, rejects)
    used = tuple(folder for folder, paths in by_folder.items() if paths)
    return MusicFiles(files.files, files.rejects, files.notes, used)


class UsedMusic(NamedTuple):
    """Stems of the audio files that sequences use: files of a sequence, and files of a song."""

    recordings: frozenset[str]
    songs: frozenset[str]

    @classmethod
    def of(cls, motions: Files, music: MusicFiles) -> Self:
        """Match audio files with sequences; sequences that are left out of the dataset count as well."""
        recordings = frozenset(name for name in motions.files if name in music.files)
        parsed = (parse_name(name) for name in motions.files if name not in recordings)
        songs = (parts.music for parts in parsed if parts is not None and parts.music in music.files)
        return cls(recordings, frozenset(songs))

    @property
    def layout(self) -> str:
        """Name of the layout: "official", "edge" or "mixed"."""
        return "mixed" if self.recordings and self.songs else "edge" if self.recordings else "official"


def unused_music(folders: Folders, motions: Files, music: MusicFiles, used: UsedMusic) -> list[Reject]:
    """Return a reject for every audio file that no sequence of the source uses."""
    danced = {parts.music for name in motions.files if (parts := parse_name(name)) is not None}
    rejects = []
    for stem, path in music.files.items():
        if stem in used.recordings or stem in used.songs:
            continue
        if not is_music_id(stem):
            detail = f"there is no motions/{stem}.pkl"
        elif stem in danced:
            detail = "every sequence danced to it has its own audio file"
        else:
            detail = "no motion in the source is danced to it"
        rejects.append(Reject("unused_music", file=relative(path, folders.source), detail=detail))
    return rejects


def music_expected(folders: Folders, music: MusicFiles) -> str:
    """Return the folder below the source where missing music is expected: the first with audio files, else wavs/."""
    folder = music.folders[0] if music.folders else folders.root / MUSIC_FOLDERS[0]
    name = relative(folder, folders.source)
    return "" if name == "." else f"{name}/"


def near_music(folders: Folders, music: MusicFiles) -> NearMusic:
    """Return the search for misnamed or misplaced audio files of a sequence."""
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
    """Yield the audio files of a folder with an AIST++ name; append the other entries to `rejects`."""
    top = folder in folders.places  # files of any kind may lie next to motions/
    for path in list_folder(folder):
        if top and path.suffix.lower() not in AUDIO_SUFFIXES:
            continue
        problem = file_problem(path, AUDIO_SUFFIXES)
        if not problem and not is_music_id(path.stem) and parse_name(path.stem) is None:
            problem = "named neither as an AIST++ sequence nor as a song (mBR2)"
        if problem:
            rejects.append(extra_file(path, folders.source, problem))
        else:
            yield path
