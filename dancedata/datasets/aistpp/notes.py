"""What a scan of an AIST++ copy tells its user, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.text import listed
from dancedata.datasets._source import counted, relative
from dancedata.datasets.aistpp.facts import facts
from dancedata.datasets.aistpp.layout import MUSIC_FOLDERS, Folders, MotionFiles, MusicFiles, music_in_use
from dancedata.datasets.aistpp.splits import ALL, SPLITS, Ignored, Splits

__all__ = ["clip_notes", "count_notes", "ignored_notes", "layout_notes"]


def layout_notes(folders: Folders, motions: MotionFiles, music: MusicFiles) -> list[str]:
    """Which layout it is, and by what it was recognised."""
    at = relative(folders.motions, folders.source)
    own, songs = music_in_use(motions, music)
    where = listed(_folder(relative(folder, folders.source)) for folder in music.folders)
    files, of_songs = counted(len(own), "file"), counted(len(songs), "song")
    if not own and not songs:
        looked = ", ".join(f"{name}/" for name in MUSIC_FOLDERS)
        text = (
            f"Layout: official AIST++, by {at}/*.pkl; but there is no music for any of the sequences. "
            f"Looked in {looked} and the folder itself for files named as a sequence or a song (mBR2.wav). "
            f"The music comes apart from the motion; get it from {facts().get_music}."
        )
    elif not songs:
        text = f"Layout: EDGE's, by {at}/*.pkl and one music file a sequence in {where} ({files})."
    elif not own:
        text = f"Layout: official AIST++, by {at}/*.pkl and one music file a song in {where} ({of_songs})."
    else:
        text = (
            f"Layout: mixed, by {at}/*.pkl and in {where} music both by sequence and by song. {files} of a "
            f"sequence, which is preferred; {of_songs} for the other sequences."
        )
    return [text, *folders.notes, *music.notes]


def _folder(name: str) -> str:
    return "the source folder" if name == "." else f"{name}/"


def count_notes(folders: Folders, motions: MotionFiles, missing: int) -> list[str]:
    """Say what was found against what AIST++ has."""
    n = len(motions.files)
    if (folders.root / "synthetic.json").is_file():
        return [f"Motion: {n:,} files of a synthetic corpus."]
    copies = facts().copies
    others = [f"{count:,}" for count in copies if count != facts().sequences]
    text = f"Motion: {counted(n, 'file')} found; AIST++ has {facts().sequences:,} sequences"
    if n in copies:
        text += f". A copy of {n:,} is known: {copies[n]}."
    else:
        text += f", and copies with {', '.join(others)} files are in circulation."
    if missing:
        text += f" {missing:,} of the listed sequences have no file (missing_motion)."
    return [text]


def ignored_notes(motions: MotionFiles, ignored: Ignored) -> list[str]:
    """Which ignore list applies, and to how many files."""
    here = len(ignored.names & set(motions.files))
    parts = list(ignored.notes)
    if ignored.where:
        parts.append(f"{counted(len(ignored.names), 'name')}, {here:,} of them among the motion files found")
    return [f"Ignore list: {'; '.join(parts)}."]


def clip_notes(clips: Sequence[ClipRef], left_out: Sequence[Reject], splits: Splits) -> list[str]:
    """Clips by split, how many were left out and why, and what is not known of them."""
    names = (ALL,) if splits.name == ALL else SPLITS
    counts = ", ".join(f"{sum(clip.split == name for clip in clips):,} {name}" for name in names)
    reasons = sorted({reject.reason for reject in left_out})
    why = ", ".join(f"{sum(r.reason == reason for r in left_out):,} {reason}" for reason in reasons)
    notes = [f"Clips: {counts}; left out: {why or 'none'}."]
    unknown = sorted({clip.music for clip in clips if clip.tempo_bpm is None})
    if unknown:
        notes.append(f"Tempo: no rule for {listed(unknown)}; it has to be estimated from the music.")
    silent = sum(clip.audio_path is None for clip in clips)
    if silent:
        notes.append(f"Music: {counted(silent, 'clip')} kept without music, as asked for.")
    return notes
