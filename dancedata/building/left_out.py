"""Rejects: the reasons for which clips and files are left out, as text and as errors."""

import os
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dancedata.core.clip import Reject, Scan
from dancedata.core.errors import DataError, StoreError
from dancedata.core.plugins import Dataset
from dancedata.core.quality import OF_CLIPS
from dancedata.core.text import counted, listed, printable, shown
from dancedata.store import Store

#: Reasons for which a clip is left out by choice; they do not stop a strict build.
BY_CHOICE = {
    "ignored",
    "unassigned",
    "missing_motion",
    "unused_music",
    "extra_file",
    "no_audio",
    "still",
    "filtered",
    "curated",
    "short_field",
    "no_field",
    "unmirrored_words",
    "unused_segments",
}

#: Reasons that `check` reports as notes; all others are errors.
NOTED = {*BY_CHOICE, *OF_CLIPS}


def relative_to(reject: Reject, source: Path) -> Reject:
    """Name files relative to the source: its place affects no byte of a dataset."""
    prefix = printable(f"{source}{os.sep}")
    return replace(reject, file=reject.file.removeprefix(prefix), detail=reject.detail.replace(prefix, ""))


#: Names that a line shows; reasons that a list shows.
_NAMED, _REASONS = 3, 8
#: Missing music comes first; what was left out by choice comes after what is broken, what was never there last.
_FIRST, _LAST = ("missing_music",), ("unassigned", "ignored", "unused_music", "extra_file", "missing_motion")


def reasons(store: Store) -> dict[str, int]:
    """Return how many were left out for each reason."""
    return dict(sorted(Counter(row["reason"] for row in store.rejects).items()))


def left_out_lines(rejects: Sequence[Reject], *, details: bool = False) -> list[str]:
    """Return a line for each reason, and further lines below it, indented by two spaces.

    A reason shows the detail of its first file or clip; one that is left out by choice only with `details`.
    """
    by_reason: dict[str, list[Reject]] = {}
    for reject in rejects:
        by_reason.setdefault(reject.reason, []).append(reject)
    ordered = sorted(by_reason, key=lambda reason: _rank(reason, len(by_reason[reason])))
    lines = []
    for reason in ordered[:_REASONS]:
        lines += _reason(reason, by_reason[reason], details or reason not in BY_CHOICE)
    rest = sum(len(by_reason[reason]) for reason in ordered[_REASONS:])
    return [*lines, f"{len(ordered) - _REASONS} more reasons: {rest}"] if rest else lines


def nothing_left(source: Path, dataset: Dataset, scan: Scan, rejects: Sequence[Reject]) -> StoreError:
    """Return the error of a source of which no clip can be stored: reasons, notes of the reader, fix."""
    text = _report("no clip is left to build from", rejects, scan)
    # For files of any layout, only the recipe has the declarations.
    reader = f" --recipe {dataset.name}"
    if dataset.explicit_only:
        reader = "" if (source / "recipe.yaml").is_file() else " --recipe RECIPE, with the recipe of this build"
    fix = f"see every file: dancedata check {shlex.quote(shown(source))}{reader}"
    without_music = {clip.id for clip in scan.clips if clip.audio_path is None}
    if any(r.reason == "missing_music" and r.clip in without_music for r in rejects):
        fix = f"audio features need music; to build motion alone: --set 'audio={{}}'. {fix[0].upper()}{fix[1:]}"
    return StoreError(text, where=source, fix=fix)


def stop_if_strict(strict: bool, rejects: Sequence[Reject], scan: Scan) -> None:
    """Raise DataError for the broken clips, if the build is strict."""
    broken = [r for r in rejects if r.reason not in BY_CHOICE]
    if strict and broken:
        text = _report(f"{counted(len(broken), 'broken clip')} in a strict build", broken, scan)
        fix = "repair or remove the broken files, or build without --strict to leave their clips out"
        raise DataError(text, reason=broken[0].reason, fix=fix)


def _report(problem: str, rejects: Sequence[Reject], scan: Scan) -> str:
    left_out = left_out_lines(rejects, details=True)
    lines = [f"  {line}" if line.startswith(" ") else f"  - {line}" for line in left_out]
    notes = [f"  - {note}" for note in scan.notes]
    return "\n".join([problem, *lines, "what was found in the source", *notes]) + "\n"


def _rank(reason: str, n: int) -> tuple[int, int, str]:
    if reason in _FIRST:
        return 0, 0, reason
    if reason in _LAST:
        return 3, _LAST.index(reason), reason
    return (2 if reason in BY_CHOICE else 1), -n, reason


def _reason(reason: str, rejects: Sequence[Reject], details: bool) -> list[str]:
    songs = Counter(r.music for r in rejects if r.music)
    if songs:
        return [f"{reason}: {counted(len(rejects), 'clip')}", *_songs(songs, rejects)]
    names = list(dict.fromkeys(r.clip or r.file for r in rejects))
    # A clip may lose windows and stay.
    number = str(len(rejects))
    if reason in ("short_field", "curated"):
        windows = len(rejects) if reason == "short_field" else sum(reject.window is not None for reject in rejects)
        parts = ((len(rejects) - windows, "clip"), (windows, "window"))
        number = " and ".join(counted(n, noun) for n, noun in parts if n)
    line = f"{reason}: {number} ({listed(names, _NAMED)})"
    if details and rejects[0].detail:
        line += f": {rejects[0].detail}"
    fixes = dict.fromkeys(r.fix for r in rejects if r.fix)
    return [line, *(f"  {fix}" for fix in list(fixes)[:_NAMED])]


def _songs(songs: Counter[str], rejects: Sequence[Reject]) -> list[str]:
    """List the missing songs: first those that most clips need."""
    ordered = sorted(songs, key=lambda song: (-songs[song], song))
    lines = [f"  song {song} is missing: {counted(songs[song], 'clip')}" for song in ordered[:_NAMED]]
    rest = ordered[_NAMED:]
    if rest:
        clips = counted(sum(songs[song] for song in rest), "clip")
        lines.append(f"  {counted(len(rest), 'song')} more: {clips} ({listed(rest, _NAMED)})")
    nameless = [r.clip for r in rejects if not r.music]
    if nameless:
        lines.append(f"  no song is named: {counted(len(nameless), 'clip')} ({listed(nameless, _NAMED)})")
    return lines
