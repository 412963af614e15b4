"""The notes of a scan of an AIST++ copy."""

from __future__ import annotations

from collections.abc import Sequence

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.text import counted, listed
from dancedata.datasets.aistpp.facts import facts
from dancedata.datasets.aistpp.layout import MUSIC_FOLDERS, Folders, MusicFiles, music_in_use
from dancedata.datasets.aistpp.splits import Ignored, Splits
from dancedata.datasets.files import ALL, SPLITS, Files, clips_note, relative

__all__ = ["clip_notes", "count_notes", "ignored_notes", "layout_notes"]


def layout_notes(folders: Folders, motions: Files, music: MusicFiles) -> list[str]:
    """Return the layout and the files it was recognised by."""
    at = relative(folders.motions, folders.source)
    own, songs = music_in_use(motions, music)
    where = listed(_folder(relative(folder, folders.source)) for folder in music.folders)
    files, of_songs = counted(len(own), "file"), counted(len(songs), "song")
    if not own and not songs:
        looked = ", ".join(f"{name}/" for name in MUSIC_FOLDERS)
        text = (
            f"Layout: official AIST++, by {at}/*.pkl; but no sequence has music. "
            f"Searched {looked} and the folder itself for files named as a sequence or a song (mBR2.wav). "
            f"The music is a separate download: {facts().get_music}."
        )
    elif not songs:
        text = f"Layout: EDGE's, by {at}/*.pkl and one audio file per sequence in {where} ({files})."
    elif not own:
        text = f"Layout: official AIST++, by {at}/*.pkl and one audio file per song in {where} ({of_songs})."
    else:
        text = (
            f"Layout: mixed, by {at}/*.pkl and audio files per sequence and per song in {where}. {files} of a "
            f"sequence, which is preferred; {of_songs} for the other sequences."
        )
    return [text, *folders.notes, *music.notes]


def _folder(name: str) -> str:
    return "the source folder" if name == "." else f"{name}/"


def count_notes(folders: Folders, motions: Files, missing: int) -> list[str]:
    """Return the number of motion files against the sequences of AIST++."""
    n = len(motions.files)
    if (folders.root / "synthetic.json").is_file():
        return [f"Motion: {n:,} files of a synthetic corpus."]
    copies = facts().copies
    others = [f"{count:,}" for count in copies if count != facts().sequences]
    text = f"Motion: {counted(n, 'file')} found; AIST++ has {facts().sequences:,} sequences"
    if n in copies:
        text += f". A copy with {n:,} files is known: {copies[n]}."
    else:
        text += f", and copies with {', '.join(others)} files are in circulation."
    if missing:
        text += f" {missing:,} of the listed sequences have no file (missing_motion)."
    return [text]


def ignored_notes(motions: Files, ignored: Ignored) -> list[str]:
    """Return the ignore list in use, and how many files it concerns."""
    here = len(ignored.names & set(motions.files))
    parts = list(ignored.notes)
    if ignored.where:
        parts.append(f"{counted(len(ignored.names), 'name')}, {here:,} of them among the motion files found")
    return [f"Ignore list: {'; '.join(parts)}."]


def clip_notes(clips: Sequence[ClipRef], left_out: Sequence[Reject], splits: Splits) -> list[str]:
    """Return the numbers of clips by split and left out, unknown tempos, and clips without music."""
    names = (ALL,) if splits.name == ALL else SPLITS
    notes = [clips_note(clips, left_out, names)]
    unknown = sorted({clip.music for clip in clips if clip.tempo_bpm is None})
    if unknown:
        notes.append(f"Tempo: no rule for {listed(unknown)}; it must be estimated from the audio.")
    silent = sum(clip.audio_path is None for clip in clips)
    if silent:
        notes.append(f"Music: {counted(silent, 'clip')} kept without music, as requested.")
    return notes
