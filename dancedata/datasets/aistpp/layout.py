"""Places of the motion and audio files of an AIST++ copy, from the lists of its folders; no file is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

from dancedata.core.clip import Reject
from dancedata.datasets._near_music import NearMusic
from dancedata.datasets.aistpp.facts import is_music_id, parse_name
from dancedata.datasets.files import Files, audio_files, list_audio, relative
from dancedata.datasets.published import Folders, Layout

LAYOUT = Layout(
    dataset="aist++",
    title="AIST++",
    motions="motions",
    suffix=".pkl",
    name_problem=lambda stem: (
        "" if parse_name(stem) else "not named as an AIST++ sequence (gBR_sBM_cAll_d04_mBR2_ch08)"
    ),
    # The copies of EDGE and of the project page.
    is_known=("edge_aistpp", "aist_plusplus_final").__contains__,
    looked_for="motions/*.pkl, in the source folder or in one folder below it "
    "(edge_aistpp/, aist_plusplus_final/, ...)",
    named="pickles named as gBR_sBM_cAll_d04_mBR2_ch08.pkl",
    mistakes={
        "motion": "motion/ (without s) is the layout of FineDance: build that dataset, "
        "or set --source to another folder"
    },
)
MUSIC_FOLDERS = ("wavs", "music", "audio", "musics")


@dataclass(frozen=True)
class MusicFiles(Files):
    """Audio files by their stem (sequence name or music id), and the folders that hold any."""

    folders: tuple[Path, ...] = ()


def list_music(folders: Folders) -> MusicFiles:
    """List the audio files, one for each sequence or one for each song, in any of the usual folders."""
    rejects: list[Reject] = []
    candidates: list[Path] = []
    used = []
    for folder in _music_folders(folders):
        files, others = list_audio(folder, folders.source, _music_problem, mixed=folder in folders.places)
        rejects += others
        candidates += files
        used += [folder] if files else []
    music = audio_files(candidates, folders.source, rejects)
    return MusicFiles(music.files, music.rejects, music.notes, tuple(used))


def _music_problem(stem: str) -> str:
    named = is_music_id(stem) or parse_name(stem) is not None
    return "" if named else "named neither as an AIST++ sequence nor as a song (mBR2)"


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
        lambda stem: not _music_problem(stem),
    )


def _music_folders(folders: Folders) -> list[Path]:
    named = [place / name for place in folders.places for name in MUSIC_FOLDERS]
    return [folder for folder in (*named, *folders.places) if folder.is_dir()]
