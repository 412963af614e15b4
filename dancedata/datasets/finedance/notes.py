"""The notes of a scan of a FineDance copy."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.text import counted, listed
from dancedata.datasets.files import Files, clips_note, relative
from dancedata.datasets.finedance.facts import facts
from dancedata.datasets.finedance.layout import LABELS, MOTION, MUSIC, Folders
from dancedata.datasets.finedance.lengths import MAX_DIFFERENCE

__all__ = ["clip_notes", "genre_notes", "layout_notes", "length_notes", "list_notes", "trim_notes"]


def layout_notes(folders: Folders, motions: Files, music: Files, labels: Files) -> list[str]:
    """Return the layout, the files it was recognised by, and their numbers."""
    at = relative(folders.root / MOTION, folders.source)
    parts = []
    for name, files in ((MUSIC, music), (LABELS, labels)):
        number = counted(len(files.files), "file") if (folders.root / name).is_dir() else "missing"
        parts.append(f"{name}/ ({number})")
    text = f"Layout: FineDance, by {at}/001.npy and so on; {' and '.join(parts)}."
    n = len(motions.files)
    known = sum(clip in motions.files for clip in facts().ids)
    count = f"Motion: {counted(n, 'file')} found; FineDance has {len(facts().ids):,} sequences"
    count += f", {len(facts().ids) - known:,} of which have no file here." if known < len(facts().ids) else "."
    if n > known:
        count += f" {n - known:,} more have unknown ids, and are in no split (unassigned)."
    return [text, *folders.notes, *music.notes, count]


def list_notes(protocol: str, here: Collection[str], kept: Collection[str]) -> list[str]:
    """Return the split and ignore lists in use, ids on two lists, and which list decides."""
    lists, ignored = facts().protocols[protocol], facts().ignored(protocol)
    sizes = f"{len(lists.val):,} in val, {len(lists.test):,} in test, all others in train"
    notes = [f"Splits: {protocol}: {sizes}, except ignored ids."]
    if not lists.val:
        notes.append(f"Splits: {protocol} has no val; Lodge and FineDance evaluate only after training.")
    applied = [f"{name} ({i.source})" for name, i in facts().ignore_lists.items() if protocol in i.applies_to]
    number = f"{len(ignored):,} ids, {len(ignored & set(here)):,} of them among the motion files found"
    notes.append(f"Ignore list: {', '.join(applied)}: {number}.")
    both = sorted(clip for clip in ignored if facts().listed(protocol, clip))
    if both:
        names = ", ".join(f"{clip} ({facts().listed(protocol, clip)})" for clip in both)
        stay = sorted(set(both) & set(kept))
        outcome = (
            f"{listed(stay)} kept, as requested"
            if stay
            else "the ignore list takes precedence, as in Lodge and FineDance"
        )
        rest = "; for the others the ignore list takes precedence" if stay and len(stay) < len(both) else ""
        notes.append(f"In two lists: {names} and ignored; {outcome}{rest}. `keep` lists ids to keep.")
    if kept:
        notes.append(f"Ignore list: {listed(sorted(kept), 12)} not ignored, as requested.")
    for name, other in facts().ignore_lists.items():
        stay = sorted(clip for clip in other.ids if protocol not in other.applies_to and clip in here)
        if stay:
            where = ", ".join(f"{clip} ({facts().listed(protocol, clip) or 'train'})" for clip in stay)
            notes.append(f"Ignore list: {where} not ignored here; {other.source} leaves them out (list {name}).")
    return notes


def trim_notes(clips: Sequence[ClipRef], trim: bool) -> list[str]:
    """Return the clips with a beginning that should be trimmed."""
    here = {clip.id: facts().trims[clip.id].frames for clip in clips if clip.id in facts().trims}
    if not here:
        return []
    cuts = listed((f"{clip} ({frames:,} frames)" for clip, frames in sorted(here.items())), 12)
    if not trim:
        return [f"Trims: not applied, as requested; Lodge trims the beginning of {cuts}."]
    return [f"Trims: Lodge trims the beginning of {cuts}. The frames are kept; trim_start is the first of the dance."]


def genre_notes(clips: Sequence[ClipRef]) -> list[str]:
    """Return the number of genres, and clips that are kept despite a problem with their label."""
    n = len({clip.genre for clip in clips if clip.genre})
    notes = [f"Genres: {n:,} of {len(facts().genre_ids):,}, from style2 of the labels, with Lodge's names."]
    kept = [f"{clip.id} ({'; '.join(clip.notes)})" for clip in clips if not clip.genre]
    if kept:
        notes.append(f"Genres: {counted(len(kept), 'clip')} kept without a genre, as requested: {listed(kept, 3)}.")
    return notes


def length_notes(differing: Mapping[str, str]) -> list[str]:
    """Return the clips whose motion and music differ in length."""
    if not differing:
        return []
    which = listed((f"{clip} ({lengths})" for clip, lengths in differing.items()), 12)
    return [
        f"Lengths: motion and music differ by more than {MAX_DIFFERENCE} frames in "
        f"{counted(len(differing), 'clip')}: {which}. The shorter one counts: windows without music are left "
        "out (no_audio)."
    ]


def clip_notes(clips: Sequence[ClipRef], left_out: Sequence[Reject]) -> list[str]:
    """Return the numbers of clips by split, left out, and without music."""
    notes = [clips_note(clips, left_out)]
    silent = [clip.id for clip in clips if clip.audio_path is None]
    if silent:
        notes.append(
            f"Music: {counted(len(silent), 'clip')} without a file in {MUSIC}/ ({listed(silent)}); only a recipe "
            "without audio features keeps them."
        )
    return notes
