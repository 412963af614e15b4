"""What was left out and why, in a few lines: what matters first, songs rather than the clips that need them."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from dancedata.core.clip import Reject, Scan
from dancedata.core.errors import DataError, StoreError
from dancedata.core.plugins import Dataset
from dancedata.core.text import counted, listed, shown
from dancedata.pipeline.rejects import BY_CHOICE

#: Names that a line shows; reasons that a list shows.
_NAMED, _REASONS = 3, 8
#: Left out by choice comes after what is broken; what was never there comes last.
_FIRST, _LAST = ("missing_music",), ("unassigned", "ignored", "unused_music", "extra_file", "missing_motion")


def left_out_lines(rejects: Sequence[Reject], *, details: bool = False) -> list[str]:
    """Return a line for each reason, with lines of two spaces more below it.

    What is broken is shown with what exactly was found, of the first file or clip.

    Parameters
    ----------
    details
        Show that also of what is left out by choice.
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
    """Return the error of a source of which no clip can be stored: why, what the reader found, what to do."""
    text = _report("no clip is left to build from", rejects, scan)
    # Only the recipe has what is declared for files of any layout.
    reader = "--recipe RECIPE, with this recipe" if dataset.explicit_only else f"--dataset {dataset.name}"
    fix = f"see every file: dancedata check {shlex.quote(shown(source))} {reader}"
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
    number = counted(len(rejects), "window") if reason == "short_field" else str(len(rejects))
    line = f"{reason}: {number} ({listed(names, _NAMED)})"
    if details and rejects[0].detail:
        line += f": {rejects[0].detail}"
    fixes = dict.fromkeys(r.fix for r in rejects if r.fix)
    return [line, *(f"  {fix}" for fix in list(fixes)[:_NAMED])]


def _songs(songs: Counter[str], rejects: Sequence[Reject]) -> list[str]:
    """Say which songs are missing, those that most clips need first; a song that may be there before them."""
    fixes = {r.music: r.fix for r in rejects if r.fix}
    ordered = sorted(songs, key=lambda song: (song not in fixes, -songs[song], song))
    lines = []
    for song in ordered[:_NAMED]:
        fix = f"; {fixes[song]}" if song in fixes else ""
        lines.append(f"  song {song} is missing: {counted(songs[song], 'clip')}{fix}")
    rest = ordered[_NAMED:]
    if rest:
        clips = counted(sum(songs[song] for song in rest), "clip")
        lines.append(f"  {counted(len(rest), 'song')} more: {clips} ({listed(rest, _NAMED)})")
    nameless = [r.clip for r in rejects if not r.music]
    if nameless:
        lines.append(f"  no song is named: {counted(len(nameless), 'clip')} ({listed(nameless, _NAMED)})")
    return lines
