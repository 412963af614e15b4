"""What a scan of a FineDance copy tells its user, in sentences."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.text import listed
from dancedata.datasets._source import counted, relative
from dancedata.datasets.finedance.facts import SPLITS, facts
from dancedata.datasets.finedance.layout import LABELS, MOTION, MUSIC, Files, Folders
from dancedata.datasets.finedance.lengths import MAX_DIFFERENCE

__all__ = ["clip_notes", "genre_notes", "layout_notes", "length_notes", "list_notes", "trim_notes"]


def layout_notes(folders: Folders, motions: Files, music: Files, labels: Files) -> list[str]:
    """Which layout it is, by what it was recognised, and how much of it is there."""
    at = relative(folders.root / MOTION, folders.source)
    parts = []
    for name, files in ((MUSIC, music), (LABELS, labels)):
        there = counted(len(files.files), "file") if (folders.root / name).is_dir() else "not there"
        parts.append(f"{name}/ ({there})")
    text = f"Layout: FineDance, by {at}/001.npy and so on; {' and '.join(parts)}."
    n = len(motions.files)
    known = sum(clip in motions.files for clip in facts().ids)
    count = f"Motion: {counted(n, 'file')} found; FineDance has {len(facts().ids):,} sequences"
    count += f", {len(facts().ids) - known:,} of which have no file here." if known < len(facts().ids) else "."
    if n > known:
        count += f" {n - known:,} more have ids that it does not have, and are in no split (unassigned)."
    return [text, *folders.notes, *music.notes, count]


def list_notes(protocol: str, here: Collection[str], kept: Collection[str]) -> list[str]:
    """Which split and ignore lists apply, which ids stand in two lists, and who wins."""
    lists, ignored = facts().protocols[protocol], facts().ignored(protocol)
    sizes = f"{len(lists.val):,} in val, {len(lists.test):,} in test, all others in train"
    notes = [f"Splits: {protocol}: {sizes}, less what is ignored."]
    if not lists.val:
        notes.append(f"Splits: {protocol} has no val; Lodge and FineDance test at the end only.")
    applied = [f"{name} ({i.source})" for name, i in facts().ignore_lists.items() if protocol in i.applies_to]
    there = f"{len(ignored):,} ids, {len(ignored & set(here)):,} of them among the motion files found"
    notes.append(f"Ignore list: {', '.join(applied)}: {there}.")
    both = sorted(clip for clip in ignored if facts().listed(protocol, clip))
    if both:
        names = ", ".join(f"{clip} ({facts().listed(protocol, clip)})" for clip in both)
        stay = sorted(set(both) & set(kept))
        outcome = f"{listed(stay)} kept as asked for" if stay else "the ignore list wins, as in Lodge and FineDance"
        rest = "; for the others the ignore list wins" if stay and len(stay) < len(both) else ""
        notes.append(f"In two lists: {names} and ignored; {outcome}{rest}. `keep` keeps ids by name.")
    if kept:
        notes.append(f"Ignore list: {listed(sorted(kept), 12)} not ignored, as asked for.")
    for name, other in facts().ignore_lists.items():
        stay = sorted(clip for clip in other.ids if protocol not in other.applies_to and clip in here)
        if stay:
            where = ", ".join(f"{clip} ({facts().listed(protocol, clip) or 'train'})" for clip in stay)
            notes.append(f"Ignore list: {where} stays; left out by {other.source} (list {name}).")
    return notes


def trim_notes(clips: Sequence[ClipRef], trim: bool) -> list[str]:
    """Which clips have a beginning that should be cut."""
    here = {clip.id: facts().trims[clip.id].frames for clip in clips if clip.id in facts().trims}
    if not here:
        return []
    cuts = listed((f"{clip} ({frames:,} frames)" for clip, frames in sorted(here.items())), 12)
    if not trim:
        return [f"Trims: not taken over, as asked for; Lodge cuts the beginning of {cuts}."]
    return [
        f"Trims: Lodge cuts the beginning of {cuts}. The frames are kept; trim_start says where the dance begins."
    ]


def genre_notes(clips: Sequence[ClipRef]) -> list[str]:
    """How many genres there are, and what is wrong with labels of clips that are kept all the same."""
    n = len({clip.genre for clip in clips if clip.genre})
    notes = [f"Genres: {n:,} of {len(facts().genre_ids):,}, by style2 of the labels under Lodge's names."]
    kept = [f"{clip.id} ({'; '.join(clip.notes)})" for clip in clips if not clip.genre]
    if kept:
        notes.append(f"Genres: {counted(len(kept), 'clip')} kept without, as asked for: {listed(kept, 3)}.")
    return notes


def length_notes(differing: Mapping[str, str]) -> list[str]:
    """Clips whose motion and music are not of one length."""
    if not differing:
        return []
    which = listed((f"{clip} ({lengths})" for clip, lengths in differing.items()), 12)
    return [
        f"Lengths: motion and music differ by more than {MAX_DIFFERENCE} frames in "
        f"{counted(len(differing), 'clip')}: {which}. The shorter counts: windows without music are left out "
        "(no_audio)."
    ]


def clip_notes(clips: Sequence[ClipRef], left_out: Sequence[Reject]) -> list[str]:
    """Clips by split, how many were left out and why, how many have no music."""
    counts = ", ".join(f"{sum(clip.split == name for clip in clips):,} {name}" for name in SPLITS)
    reasons = sorted({reject.reason for reject in left_out})
    why = ", ".join(f"{sum(r.reason == reason for r in left_out):,} {reason}" for reason in reasons)
    notes = [f"Clips: {counts}; left out: {why or 'none'}."]
    silent = [clip.id for clip in clips if clip.audio_path is None]
    if silent:
        notes.append(
            f"Music: {counted(len(silent), 'clip')} without a file in {MUSIC}/ ({listed(silent)}); only a recipe "
            "without audio features keeps them."
        )
    return notes
