"""What a dataset holds: windows by split, genre, dancer and song, lengths, tempo and rates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from dancedata.report.measure import Measured
from dancedata.report.scales import Scales, music_gaps
from dancedata.report.tally import Histogram
from dancedata.store import ClipView
from dancedata.store.songs import songs_of

__all__ = ["UNKNOWN", "contents", "total_windows"]

#: Stands for a genre, dancer or song that the dataset does not name.
UNKNOWN = "unknown"


def total_windows(found: Measured) -> int:
    """Return the number of windows of all splits."""
    return sum(found.windows.values())


def contents(found: Measured, scales: Scales) -> dict[str, Any]:
    """Return the section of the document."""
    store = found.store
    originals = [c for c in store.clips if not c.source]
    songs = songs_of(store.clips, store.meta)
    tempos = {s: [c.tempo_bpm for c in originals if c.split == s and c.tempo_bpm is not None] for s in store.splits}
    lengths = {s: [float(store.grid.seconds(c.n_frames)) for c in originals if c.split == s] for s in store.splits}
    genres = _windows_by(found, lambda c: c.genre)
    return {
        "splits": list(store.splits),
        "by_split": {split: dict(store.meta["counts"].get(split, {})) for split in store.splits},
        "windows_by_split": _windows_by(found, lambda c: c.split),
        "windows_by_genre": genres,
        "windows_by_dancer": _windows_by(found, lambda c: c.dancer),
        "windows_by_song": _windows_by(found, lambda c: songs.get(c.id, "")),
        "alike": [list(names) for names in _alike(genres)],
        "length_s": Histogram.of_values(lengths, scales.length_s).to_json(),
        "tempo_bpm": Histogram.of_values(tempos, scales.tempo_bpm).to_json(),
        "source_rates": dict(sorted(Counter(c.source_rate or UNKNOWN for c in originals).items())),
        "music_minus_motion_s": _gaps(found, scales),
    }


def _gaps(found: Measured, scales: Scales) -> dict[str, Any]:
    gaps = music_gaps(found)
    shorter = sorted(clip for clip, gap in gaps.items() if gap < 0)
    numbers = Histogram.of_values({"all": list(gaps.values())}, scales.music_minus_motion_s).to_json()
    return {**numbers, "shorter": shorter}


def _windows_by(found: Measured, key: Callable[[ClipView], str]) -> dict[str, dict[str, int]]:
    """Count the windows by a name of their clip, then by split; copies count, as a trainer draws them too."""
    counts: dict[str, Counter[str]] = {}
    for clip in found.store.clips:
        counts.setdefault(key(clip) or UNKNOWN, Counter())[clip.split] += found.windows.get(clip.id, 0)
    splits = found.store.splits
    ordered = sorted(counts, key=lambda name: (name == UNKNOWN, name not in splits, _place(name, splits), name))
    return {name: {split: counts[name][split] for split in splits} for name in ordered}


def _place(name: str, splits: tuple[str, ...]) -> int:
    return splits.index(name) if name in splits else 0


def _alike(names: Iterable[str]) -> list[tuple[str, ...]]:
    """Return names that differ only in case, spaces or punctuation: "Jazz" and "jazz"."""
    by_letters: dict[str, list[str]] = {}
    for name in names:
        by_letters.setdefault("".join(filter(str.isalnum, name.casefold())), []).append(name)
    return [tuple(sorted(own)) for own in by_letters.values() if len(own) > 1]
