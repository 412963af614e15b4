"""What was left out, as text: a line for each reason, with clips, songs and fixes."""

from collections import Counter
from collections.abc import Sequence

from dancedata.core.clip import Reject
from dancedata.core.rejects import BY_CHOICE
from dancedata.core.text import counted, listed

#: Names that a line shows; reasons that a list shows.
_NAMED, _REASONS = 3, 8
#: Missing music comes first; what was left out by choice comes after what is broken, what was never there last.
_FIRST, _LAST = ("missing_music",), ("unassigned", "ignored", "unused_music", "extra_file", "missing_motion")


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
    n_more = sum(len(by_reason[reason]) for reason in ordered[_REASONS:])
    return [*lines, f"{len(ordered) - _REASONS} more reasons: {n_more}"] if n_more else lines


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
    fewer_clips = ordered[_NAMED:]
    if fewer_clips:
        clips = counted(sum(songs[song] for song in fewer_clips), "clip")
        lines.append(f"  {counted(len(fewer_clips), 'song')} more: {clips} ({listed(fewer_clips, _NAMED)})")
    nameless = [r.clip for r in rejects if not r.music]
    if nameless:
        lines.append(f"  no song is named: {counted(len(nameless), 'clip')} ({listed(nameless, _NAMED)})")
    return lines
