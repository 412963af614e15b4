"""Folders without a manifest: motion and music that belong together have the same name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dancedata.core.clip import Reject
from dancedata.core.errors import SourceError
from dancedata.core.text import listed
from dancedata.datasets._near_music import MUSIC, NearMusic
from dancedata.datasets._source import counted, describe, list_folder, relative
from dancedata.datasets.folder.load import SUFFIXES

__all__ = ["MUSIC", "Matched", "match_names"]

MOTION_FOLDERS = ("motions", "motion")
MUSIC_FOLDERS = ("music", "wavs", "audio", "musics")
LOOKED_FOR = (
    "manifest.csv or manifest.jsonl; or motions/NAME.npz (.npy, .pkl, .bvh) with music/NAME.wav (.flac, .mp3, .ogg); "
    "or NAME.npz beside NAME.wav"
)


@dataclass(frozen=True)
class Matched:
    """What was found: motion and music by name.

    Attributes
    ----------
    music_folder
        Folder below the source in which missing music would be found: "music/", or "" for the source itself.
    near
        Music that no motion uses, which may be a missing one.
    """

    layout: str
    motions: dict[str, Path]
    music: dict[str, Path]
    rejects: tuple[Reject, ...]
    notes: tuple[str, ...]
    music_folder: str
    near: NearMusic


def match_names(source: Path) -> Matched:
    """List motion and music by their names.

    Raises
    ------
    SourceError
        If there is no motion where it is looked for.
    """
    folders = [source / name for name in MOTION_FOLDERS if (source / name).is_dir()]
    apart = bool(folders)
    motion_folder = folders[0] if apart else source
    music_folders = [source / n for n in MUSIC_FOLDERS if (source / n).is_dir()] if apart else [source]
    rejects: list[Reject] = []
    motions = _by_name(source, [motion_folder], SUFFIXES, rejects)
    music = _by_name(source, music_folders, MUSIC, rejects)
    if not motions and not any(r.reason == "ambiguous_name" for r in rejects):
        raise SourceError(
            "folder: no motion found",
            where=str(source),
            found=describe(motion_folder),
            allowed=LOOKED_FOR,
            fix="give --source the folder with the files, or write a manifest (docs/own-data.md)",
        )
    rejects += _rest(source, {motion_folder, *music_folders}, motions, music)
    both = sorted(set(motions) & set(music))
    places = (
        f"{relative(motion_folder, source)}/ and {listed([f'{p.name}/' for p in music_folders]) or 'no music folder'}"
    )
    notes = [
        f"No manifest: motion and music were matched by file name, {places if apart else 'side by side'}; "
        f"{counted(len(both), 'pair')}, {len(motions) - len(both)} motions without music."
    ]
    layout = "names" if apart else "names, side by side"
    expected = (f"{music_folders[0].name}/" if music_folders else f"{MUSIC_FOLDERS[0]}/") if apart else ""
    near = NearMusic(source, (*music_folders, source), {music[name] for name in both}, motions.__contains__)
    return Matched(layout, motions, music, tuple(rejects), tuple(notes), expected, near)


def _by_name(source: Path, folders: list[Path], suffixes: tuple[str, ...], rejects: list[Reject]) -> dict[str, Path]:
    """Files by stem; of equal names the better kind of music is taken, of motion none."""
    found: dict[str, list[Path]] = {}
    for folder in folders:
        for path in list_folder(folder):
            if path.suffix.lower() in suffixes and path.is_file():
                found.setdefault(path.stem, []).append(path)
    chosen = {}
    for stem, paths in sorted(found.items()):
        best, *others = sorted(paths, key=lambda path: suffixes.index(path.suffix.lower()))
        if others and suffixes == SUFFIXES:
            names = ", ".join(path.name for path in paths)
            detail = f"{names}: nothing says which is meant; rename or take away, or write a manifest"
            rejects.append(Reject("ambiguous_name", clip=stem, file=relative(best, source), detail=detail))
            continue
        chosen[stem] = best
        rejects += [
            Reject("extra_file", file=relative(path, source), detail=f"{relative(best, source)} is read for {stem}")
            for path in others
        ]
    return chosen


def _rest(source: Path, folders: set[Path], motions: dict[str, Path], music: dict[str, Path]) -> list[Reject]:
    """Return what lies there and is not read, by name."""
    known = {*MUSIC, *SUFFIXES}
    rejects = [
        Reject("unused_music", file=relative(path, source), detail="no motion of that name")
        for stem, path in music.items()
        if stem not in motions
    ]
    for folder in sorted({source, *folders}):
        for path in list_folder(folder):
            if path.is_dir():
                detail = "" if path in folders else "a folder, which is not searched"
            elif not path.is_file():
                detail = "not a file: a link that leads nowhere, or a device"
            else:
                here = folder in folders and path.suffix.lower() in known
                detail = "" if here else "neither motion nor music"
            if detail:
                rejects.append(Reject("extra_file", file=relative(path, source), detail=detail))
    return rejects
