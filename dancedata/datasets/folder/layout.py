"""Motion and audio files of a folder without a manifest; files with equal names belong together."""

from collections.abc import Sequence
from pathlib import Path

from dancedata.core.audio_signal import AUDIO_SUFFIXES, MUSIC_FOLDERS
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import SourceError
from dancedata.core.text import counted, listed
from dancedata.datasets._words import words_of
from dancedata.datasets.files import Files, describe, extra_file, file_problem, relative, with_music_dir
from dancedata.files.listing import MOTION_FOLDERS, best_audio, group_by_stem, list_folder
from dancedata.formats.values import MOTION_SUFFIXES

LOOKED_FOR = (
    "manifest.csv or manifest.jsonl; or motions/NAME.npz (.npy, .pkl, .bvh) with music/NAME.wav (.flac, .mp3, .ogg); "
    "or NAME.npz next to NAME.wav"
)


def match_names(source: Path, music_dir: Path | None = None) -> tuple[str, dict[str, Path], Files]:
    """Return the layout, motion by name, and music (`music_dir` first) with all rejects; SourceError: no motion."""
    folders = [source / name for name in MOTION_FOLDERS if (source / name).is_dir()]
    apart = bool(folders)
    motion_folder = folders[0] if apart else source
    music_folders = [source / n for n in MUSIC_FOLDERS if (source / n).is_dir()] if apart else [source]
    rejects: list[Reject] = []
    motions = _motions(source, motion_folder, rejects)
    own = Files(_music(source, music_folders, rejects), ())
    files = with_music_dir(own, music_dir, source, lambda stem: "")
    music, rejects = files.files, [*rejects, *files.rejects]
    if not motions and not any(r.reason == "ambiguous_name" for r in rejects):
        raise SourceError(
            "folder: no motion found",
            where=str(source),
            found=describe(motion_folder),
            allowed=LOOKED_FOR,
            fix="set SOURCE to the folder with the files, or write a manifest: dancedata init proposes one "
            "(docs/guides/own-captures.md)",
        )
    rejects += _rest(source, {motion_folder, *music_folders}, motions, music)
    both = sorted(set(motions) & set(music))
    places = (
        f"{relative(motion_folder, source)}/ and {listed([f'{p.name}/' for p in music_folders]) or 'no music folder'}"
    )
    note = (
        f"No manifest: motion and music were matched by file name, {places if apart else 'side by side'}; "
        f"{counted(len(both), 'pair')}, {counted(len(motions) - len(both), 'motion')} without music."
    )
    layout = "names" if apart else "names, side by side"
    return layout, motions, Files(music, tuple(rejects), (note, *files.notes))


def points_note(clips: Sequence[ClipRef]) -> list[str]:
    """Return the note on ids with points, which name a file's kind in tar files."""
    pointed = [clip.id for clip in clips if "." in clip.id]
    return [f"Points in {counted(len(pointed), 'id')}, which the export webdataset refuses: {listed(pointed)}."][
        : len(pointed)
    ]


def _motions(source: Path, folder: Path, rejects: list[Reject]) -> dict[str, Path]:
    """Return motion files by stem; several with one stem are ambiguous, and none of them is read."""
    chosen = {}
    for stem, paths in group_by_stem([folder], MOTION_SUFFIXES):
        if len(paths) == 1:
            chosen[stem] = paths[0]
            continue
        paths.sort(key=lambda path: MOTION_SUFFIXES.index(path.suffix.lower()))
        names = ", ".join(path.name for path in paths)
        detail = f"{names} have the same name; rename or remove all but one, or write a manifest"
        rejects.append(Reject("ambiguous_name", clip=stem, file=relative(paths[0], source), detail=detail))
    return chosen


def _music(source: Path, folders: list[Path], rejects: list[Reject]) -> dict[str, Path]:
    """Return audio files by stem; of several with one stem the preferred format is used."""
    chosen = {}
    for stem, paths in group_by_stem(folders, AUDIO_SUFFIXES):
        chosen[stem], *others = best_audio(paths)
        problem = f"{relative(chosen[stem], source)} is read for {stem}"
        rejects += [extra_file(path, source, problem) for path in others]
    return chosen


def _rest(source: Path, folders: set[Path], motions: dict[str, Path], music: dict[str, Path]) -> list[Reject]:
    rejects = [
        Reject("unused_music", file=relative(path, source), detail="no motion with that name")
        for stem, path in music.items()
        if stem not in motions
    ]
    read = {*folders, *words_of(source)}
    for folder in sorted({source, *folders}):
        suffixes = (*MOTION_SUFFIXES, *AUDIO_SUFFIXES) if folder in folders else ()
        for path in list_folder(folder):
            problem = "" if path in read else file_problem(path, suffixes, "neither motion nor music")
            if problem:
                rejects.append(Reject("extra_file", file=relative(path, source), detail=problem))
    return rejects
