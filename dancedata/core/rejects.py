"""Rejects of clips and files: of errors, and as text by reason."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.text import counted, listed, printable

_T = TypeVar("_T")

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
#: Names that a line shows; reasons that a list shows.
_NAMED, _REASONS = 3, 8
#: Missing music comes first; what was left out by choice comes after what is broken, what was never there last.
_FIRST, _LAST = ("missing_music",), ("unassigned", "ignored", "unused_music", "extra_file", "missing_motion")


def reject_of(error: DataError, clip: str = "", file: Path | None = None) -> Reject:
    """Return the reject with the text of an error."""
    return Reject(reason=error.reason, clip=clip, file=str(file) if file else "", detail=str(error))


def reject_on_error(call: Callable[[], _T], file: Path, clip: str = "") -> _T | Reject:
    """Return a call's result, or the reject of its DataError."""
    try:
        return call()
    except DataError as error:
        return reject_of(error, clip, file)


def require_same(path: Path, sha256: str, hash_file: Callable[[Path], str]) -> None:
    """Raise DataError if a file is no longer the one that was hashed."""
    if hash_file(path) != sha256:
        raise changed(path)


def changed(where: object) -> DataError:
    """Return the error for a file that has changed since it was identified."""
    fix = "run the build again once the source no longer changes"
    return DataError("the file changed while the build was running", reason="changed", where=where, fix=fix)


def missing_music(ref: ClipRef) -> Reject:
    """Return the reject of a clip without music."""
    detail = f"no music for clip {ref.id}; a recipe without audio features (audio: {{}}) needs none"
    return Reject("missing_music", clip=ref.id, detail=detail, music=ref.music)


def relative_to(reject: Reject, source: Path) -> Reject:
    """Name files relative to the source: its place affects no byte of a dataset."""
    prefix = printable(f"{source}{os.sep}")
    return replace(reject, file=reject.file.removeprefix(prefix), detail=reject.detail.replace(prefix, ""))


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
