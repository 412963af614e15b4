"""Every number of a report, as plain JSON data: the page is drawn from this document, so both agree."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dancedata.report.left_out import flags, left_out, ranking
from dancedata.report.measure import PROMINENT, SLIDE_M_S, STILL_M_S, ClipNumbers, Measured
from dancedata.report.scales import Scales, music_gaps
from dancedata.report.tally import Histogram, Tally, five_numbers
from dancedata.store import ClipView, Store
from dancedata.store.songs import AlikeSongs, alike_songs, songs_of, sound_field

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def movement(measured: Measured, scales: Scales) -> dict[str, Any]:
    """Return the section of the document."""
    reader = measured.reader
    contact = {
        name: (int(on) / int(frames) if frames else None)
        for name, (on, frames) in zip(measured.feet, measured.contact.tolist(), strict=True)
    }
    return {
        "field": reader.motion.name if reader.motion is not None else None,
        "joints": len(measured.joints),
        "speed_m_s": Histogram.of_tally(measured.speed, scales.speed).to_json(),
        "joint_speed_m_s": {name: _quantiles(tally) for name, tally in measured.joint_speed.items()},
        "still": {"below_m_s": STILL_M_S, **_over_clips(measured, lambda n: n.still)},
        "root_extent_m": _of_clips(measured, scales.root_extent_m, lambda n: n.root_extent_m),
        "floor_m": _of_clips(measured, scales.floor_m, lambda n: n.floor_m),
        "lowest_m": _over_clips(measured, lambda n: n.low_m),
        "highest_m": _over_clips(measured, lambda n: n.high_m),
        "turns": _of_clips(measured, scales.turns, lambda n: n.turns),
        "contact": contact,
        "sliding_m_s": {
            **Histogram.of_tally(measured.sliding, scales.sliding).to_json(),
            "above_m_s": SLIDE_M_S,
            "share_above": measured.sliding.share_above(SLIDE_M_S),
        },
        "paths_m": {
            clip: [list(p) for p in numbers.path] for clip, numbers in measured.clips.items() if numbers.path
        },
    }


def music(measured: Measured, scales: Scales) -> dict[str, Any]:
    """Return the section of the document: key motions beside beats, and beside beats moved by half a period."""
    reader = measured.reader
    numbers = measured.clips.values()
    tempos = [
        {"clip": c.id, "stated": c.tempo_bpm, "found": tempo}
        for c in measured.store.clips
        if not c.source and c.tempo_bpm is not None and (tempo := measured.clips[c.id].tempo_found) is not None
    ]
    return {
        "beats_from": reader.music.name if reader.music is not None else None,
        "key_motions_from": reader.keymotion.name if reader.keymotion is not None else None,
        "prominence_share": PROMINENT,
        "key_motions": sum(n.key_motions for n in numbers),
        "offset_ms": Histogram.of_tally(measured.offset_ms, scales.offset_ms).to_json(),
        "shifted_ms": Histogram.of_tally(measured.shifted_ms, scales.offset_ms).to_json(),
        "mean_distance_ms": _weighted(measured, lambda n: n.key_beat_ms),
        "mean_distance_shifted_ms": _weighted(measured, lambda n: n.key_shifted_ms),
        "bas": _mean(measured, lambda n: n.bas),
        "bas_chance": _mean(measured, lambda n: n.bas_chance),
        "tempo_bpm": tempos,
    }


def _quantiles(tally: Tally) -> dict[str, float | None]:
    return {f"p{round(100 * q)}": tally.quantile(q) for q in _QUANTILES}


def _values(measured: Measured, value: Callable[[ClipNumbers], float | None]) -> list[float]:
    return [v for v in map(value, measured.clips.values()) if v is not None]


def _over_clips(measured: Measured, value: Callable[[ClipNumbers], float | None]) -> dict[str, float | None]:
    return five_numbers(_values(measured, value))


def _of_clips(
    measured: Measured, edges: tuple[float, ...], value: Callable[[ClipNumbers], float | None]
) -> dict[str, Any]:
    return Histogram.of_values({"all": _values(measured, value)}, edges).to_json()


def _mean(measured: Measured, value: Callable[[ClipNumbers], float | None]) -> float | None:
    values = _values(measured, value)
    return float(np.mean(values)) if values else None


def _weighted(measured: Measured, value: Callable[[ClipNumbers], float | None]) -> float | None:
    """Return the mean over key motions of a number that is a mean over those of a clip."""
    pairs = [(v, n.key_motions) for n in measured.clips.values() if (v := value(n)) is not None]
    weight = sum(k for _, k in pairs)
    return sum(v * k for v, k in pairs) / weight if weight else None


def splits(store: Store) -> dict[str, Any]:
    """Return the section of the document: for each two splits how much both have, and the names of it.

    A song or a clip that train shares with another split is a leak; val and test may share songs, as in AIST++.
    Songs are one by their name, by their samples, or by their sound.
    """
    origin = {c.id: c.source or c.id for c in store.clips}
    songs = songs_of(store.clips, store.meta)
    alike = None if sound_field(store) is None else alike_songs(store, songs)
    return {
        "compared_by_sound": alike is not None,
        "songs": _shared(store, lambda c: songs.get(c.id, ""), alike or ()),
        "dancers": _shared(store, lambda c: c.dancer),
        "clips": _shared(store, lambda c: origin[c.id]),
    }


def _shared(store: Store, key: Callable[[ClipView], str], alike: Sequence[AlikeSongs] = ()) -> dict[str, Any]:
    names = {split: {key(c) for c in store.clips if c.split == split and key(c)} for split in store.splits}
    both = {(a, b): sorted(names[a] & names[b]) for a in store.splits for b in store.splits}
    for pair in alike:
        for a, b in both:
            if a != b and any(a in one and b in other for one, other in (pair.splits, pair.splits[::-1])):
                both[a, b].append(f"{pair.songs[0]} (sounds as {pair.songs[1]}, likeness {pair.likeness:.2f})")
    counts = {a: {b: len(both[a, b]) for b in store.splits} for a in store.splits}
    later = [(a, b) for i, a in enumerate(store.splits) for b in store.splits[i + 1 :]]
    return {"counts": counts, "names": {f"{a} and {b}": both[a, b] for a, b in later if both[a, b]}}


#: Smaller ranges are those of a column that does not change.
_CONSTANT = 1e-6
_STRIP = ("min", "p5", "p25", "p50", "p75", "p95", "max")


def fields(store: Store) -> dict[str, Any]:
    """Return the section of the document, from stats.json: numbers over the rows that train windows cover."""
    stats: Mapping[str, Any] = store.stats["fields"]
    return {name: _field(store, name, stats.get(name)) for name in store.fields}


def _field(store: Store, name: str, stats: Mapping[str, Any] | None) -> dict[str, Any]:
    field = store.field(name)
    entry = {
        "kind": field.kind,
        "width": field.columns.width,
        "rate": str(field.rate),
        "dtype": field.dtype,
        "axes": store.meta.get("axes", {}).get(name),
        "groups": [{"name": g.name, "width": g.width, "unit": g.unit} for g in field.columns.groups],
    }
    if stats is None:
        return {**entry, "rows": 0, "constant": [], "columns": []}
    strips = [_strip(stats, j) for j in range(field.columns.width)]
    pairs = list(zip(field.columns.labels, strips, strict=True))
    labelled = [{"label": label, **strip} for label, strip in pairs]
    constant = [label for label, strip in pairs if strip["max"] - strip["min"] < _CONSTANT]
    return {**entry, "rows": stats["n"], "constant": constant, "columns": labelled}


def _strip(stats: Mapping[str, Any], column: int) -> dict[str, float]:
    quantiles = stats["quantiles"]
    values: Sequence[Sequence[float]] = (
        stats["min"], *(quantiles[q] for q in ("0.05", "0.25", "0.5", "0.75", "0.95")), stats["max"]
    )  # fmt: skip
    return {name: float(values_of_column[column]) for name, values_of_column in zip(_STRIP, values, strict=True)}


#: Stands for a genre, dancer or song that the dataset does not name.
UNKNOWN = "unknown"


def total_windows(measured: Measured) -> int:
    """Return the number of windows of all splits."""
    return sum(measured.windows.values())


def contents(measured: Measured, scales: Scales) -> dict[str, Any]:
    """Return the section of the document."""
    store = measured.store
    originals = [c for c in store.clips if not c.source]
    songs = songs_of(store.clips, store.meta)
    tempos = {s: [c.tempo_bpm for c in originals if c.split == s and c.tempo_bpm is not None] for s in store.splits}
    lengths = {s: [float(store.grid.seconds(c.n_frames)) for c in originals if c.split == s] for s in store.splits}
    genres = _windows_by(measured, lambda c: c.genre)
    return {
        "splits": list(store.splits),
        "by_split": {split: dict(store.meta["counts"].get(split, {})) for split in store.splits},
        "windows_by_split": _windows_by(measured, lambda c: c.split),
        "windows_by_genre": genres,
        "windows_by_dancer": _windows_by(measured, lambda c: c.dancer),
        "windows_by_song": _windows_by(measured, lambda c: songs.get(c.id, "")),
        "alike": [list(names) for names in _alike(genres)],
        "length_s": Histogram.of_values(lengths, scales.length_s).to_json(),
        "tempo_bpm": Histogram.of_values(tempos, scales.tempo_bpm).to_json(),
        "source_rates": dict(sorted(Counter(c.source_rate or UNKNOWN for c in originals).items())),
        "music_minus_motion_s": _gaps(measured, scales),
    }


def _gaps(measured: Measured, scales: Scales) -> dict[str, Any]:
    gaps = music_gaps(measured)
    shorter = sorted(clip for clip, gap in gaps.items() if gap < 0)
    numbers = Histogram.of_values({"all": list(gaps.values())}, scales.music_minus_motion_s).to_json()
    return {**numbers, "shorter": shorter}


def _windows_by(measured: Measured, key: Callable[[ClipView], str]) -> dict[str, dict[str, int]]:
    """Count the windows by a name of their clip, then by split; copies count, as a trainer draws them too."""
    counts: dict[str, Counter[str]] = {}
    for clip in measured.store.clips:
        counts.setdefault(key(clip) or UNKNOWN, Counter())[clip.split] += measured.windows.get(clip.id, 0)
    splits = measured.store.splits
    ordered = sorted(counts, key=lambda name: (name == UNKNOWN, name not in splits, _place(name, splits), name))
    return {name: {split: counts[name][split] for split in splits} for name in ordered}


def _place(name: str, splits: tuple[str, ...]) -> int:
    return splits.index(name) if name in splits else 0


def _alike(names: Iterable[str]) -> list[tuple[str, ...]]:
    """Return names that differ only in case, spaces or punctuation: "Jazz" and "jazz"."""
    by_letters: dict[str, list[str]] = {}
    for name in names:
        by_letters.setdefault("".join(filter(str.isalnum, name.casefold())), []).append(name)
    return [tuple(sorted(similar)) for similar in by_letters.values() if len(similar) > 1]


#: Raised whenever a key of the document is removed or means something else.
SCHEMA = 1

Document = Mapping[str, Any]


def document(measured: Measured, scales: Scales) -> Document:
    """Return every number of a report of one dataset.

    Parameters
    ----------
    scales
        Borders of the bins of histograms; those of two datasets that are compared are the same.
    """
    store = measured.store
    return {
        "about": _about(store),
        "totals": _totals(measured),
        "contents": contents(measured, scales),
        "movement": movement(measured, scales),
        "music": music(measured, scales),
        "splits": splits(store),
        "fields": fields(store),
        "left_out": left_out(store.rejects),
        "flags": flags(store),
        "ranking": ranking(measured),
        "clips": _clips(measured),
    }


def _about(store: Store) -> dict[str, Any]:
    keys = ("name", "dataset", "scope", "fps", "windows", "licence", "citation", "dancedata", "recipe_sha256")
    record = {key: store.meta.get(key) for key in keys}
    description = store.meta.get("recipe", {}).get("description", "")
    notes = list(store.meta.get("source", {}).get("notes", []))
    skeleton = {"name": store.skeleton.name, "joints": store.skeleton.n_joints}
    return {**record, "description": description, "notes": notes, "skeleton": skeleton, "weights": store.weights}


def _totals(measured: Measured) -> dict[str, Any]:
    clips = measured.store.clips
    originals = [c for c in clips if not c.source]
    return {
        "clips": len(originals),
        "copies": len(clips) - len(originals),
        "windows": total_windows(measured),
        "minutes": float(measured.store.grid.seconds(sum(c.n_frames for c in originals)) / 60),
        "songs": len(set(songs_of(clips, measured.store.meta).values())),
        "dancers": len({c.dancer for c in clips if c.dancer}),
        "genres": len({c.genre for c in clips if c.genre}),
        "left_out": len(measured.store.rejects),
        "flags": len(measured.store.quality),
        "flagged_clips": sum(c.n_flags > 0 for c in originals),
    }


_CLIP_NUMBERS: Sequence[str] = (
    "seconds", "speed", "speed_p95", "still", "root_extent_m", "root_path_m", "floor_m", "low_m", "high_m", "turns",
    "sliding", "key_motions", "key_beat_ms", "key_shifted_ms", "bas", "bas_chance", "tempo_found", "music_s",
)  # fmt: skip


def _clips(measured: Measured) -> list[dict[str, Any]]:
    """Return a row for each clip that is not a copy: what the dataset says, and what was measured."""
    rows = []
    for clip in measured.store.clips:
        if clip.source:
            continue
        numbers = measured.clips[clip.id]
        entry = {
            "clip": clip.id, "split": clip.split, "genre": clip.genre, "song": clip.music, "dancer": clip.dancer,
            "frames": clip.n_frames, "windows": measured.windows.get(clip.id, 0), "flags": clip.n_flags,
            "tempo_stated": clip.tempo_bpm, "source_rate": clip.source_rate, "trim_start": clip.trim_start,
        }  # fmt: skip
        rows.append(entry | {name: getattr(numbers, name) for name in _CLIP_NUMBERS})
    return rows
